// Audits of contact models and gradients of scenes, as the programs report them.
#include "saltus/audit/audit.h"

#include <pybind11/stl.h>

#include <tuple>

#include "arrays.h"
#include "base/parallel_for.h"
#include "callable_box.h"
#include "computation.h"
#include "convert.h"
#include "output/figure.h"
#include "programs/audit.h"
#include "programs/json_output.h"
#include "saltus/control/control_rows.h"

namespace saltus::python {
namespace {

// The loss and its gradient by everything, under the scene's own control or another one.
py::dict Gradient(const Scene& scene, const py::object& contact_name, const std::string& precision,
                  const py::object& control) {
  const Contact contact = ReadContact(contact_name);
  CheckTakes(contact, scene);
  std::vector<double> given;
  if (!control.is_none()) {
    const int steps = scene.steps / FindContactModel(contact)->grid_steps;
    const Array rows = ReadArray(control, "control", {steps, scene.num_controlled(), ControlColumns(scene)});
    CheckRows(scene, "control", View(rows));
    given = ControlOfRows(scene, View(rows));
  }
  const Precision arithmetic = ReadPrecision(precision);
  ModelGradient gradient;
  Computation computation;
  computation.RunOrThrow([&] {
    gradient = ComputeGradient(
        contact, scene, arithmetic, computation.stop(), control.is_none() ? nullptr : &given, /*with_grazes=*/true);
  });
  if (!gradient.ok()) throw std::runtime_error(contact.name() + ": " + gradient.reason);
  WarnOfUnresolved(gradient.unresolved_steps, gradient.num_steps);
  if (!gradient.ambiguous.empty()) {
    computation.RunOrThrow([&] {
      const std::vector<double> rows = control.is_none() ? InitialControl(scene, scene.steps) : given;
      const ExactRun exact = SimulateExactly(scene, InitialState(scene), rows, {}, computation.stop());
      gradient.ambiguous = exact.ambiguous;
      gradient.spread = exact.spread;
    });
  }
  Json item = {{"contact", gradient.contact},
               {"loss", gradient.loss},
               {"gradient", GradientToJson(scene, gradient.gradient)},
               {"events", EventsToJson(gradient.events)}};
  if (!gradient.one_sided.empty()) item["one_sided"] = OneSidedToJson(scene, gradient.one_sided);
  AddTies(gradient.ambiguous, gradient.spread, &item);
  item["remarks"] = RemarksToJson(RemarksOn(scene, gradient));
  return ToPython(item);
}

// A simulator or a contact model written in Python: its name, what answers questions (callable_box.h), what its
// gradients are of ("final state", "loss", or "" without any), and whether it has single steps.
using OwnSimulator = std::tuple<std::string, py::object, std::string, bool>;

// An audit, and what has stopped it: an exception or None. One that was stopped has the models that were begun.
py::tuple AuditScene(const Scene& scene, const std::vector<std::string>& contacts, const std::vector<OwnSimulator>& own,
                     const std::string& precision, bool width_sweep, const py::object& surrogate, int threads,
                     double audit_seconds, double seconds) {
  Request request;
  request.scene = scene;
  request.precision = ReadPrecision(precision);
  for (const std::string& name : contacts) request.contacts.push_back(ReadContact(py::str(name)).name());
  Computation computation(seconds);
  AuditOptions options;
  options.width_sweep = width_sweep;
  options.surrogate = ReadSurrogate(surrogate);
  if (options.surrogate && width_sweep) {
    throw py::value_error("width_sweep: is of the models' own gradients, expected no surrogate with it");
  }
  if (!(audit_seconds >= 0)) throw py::value_error("audit_seconds: expected seconds, or 0 for no limit");
  options.stop = computation.stop();
  const int workers = ReadThreads(threads);
  if (contacts.size() == 1) options.threads = workers;
  std::vector<std::shared_ptr<BlackBox>> boxes;
  for (const auto& [name, answerer, gradient_of, step] : own) {
    CallableOffer offer{.gradient = !gradient_of.empty(), .step = step};
    if (gradient_of == "loss") offer.loss = scene.objective;
    boxes.push_back(MakeCallableBox(name, answerer, offer));
  }
  AuditReport report;
  report.models.resize(contacts.size());
  const auto audit = [&] {
    report.reference = ComputeExactGradient(scene, options.stop);
    ParallelFor(workers, static_cast<int>(contacts.size()), [&](int /*thread*/, int i) {
      report.models[i] = AuditModel(request.contacts[i], scene, request.precision, report.reference, options);
    });
    // One after the other, in this thread, which has Python's exceptions.
    for (const std::shared_ptr<BlackBox>& box : boxes) {
      report.models.push_back(AuditBlackBox(box, scene, report.reference, options, {audit_seconds}));
    }
  };
  try {
    computation.RunOrThrow(audit);
  } catch (const py::error_already_set& error) {
    std::erase_if(report.models, [](const ModelAudit& model) { return model.gradient.contact.empty(); });
    return py::make_tuple(ToPython(AuditToJson(request, report)), error.value());
  }
  Json document = AuditToJson(request, report);
  if (document.contains("interrupted")) {
    document["reason"] = computation.ReasonTimedOut();
    return py::make_tuple(ToPython(document), py::none());
  }
  const ModelGradient& first = report.models[0].gradient;
  if (contacts.size() + own.size() == 1 && !first.ok() && IsNotApplicable(first, scene)) {
    throw py::value_error("contact " + first.contact + ": " + first.reason);
  }
  return py::make_tuple(ToPython(document), py::none());
}

// Colour, line and marker of a contact model in every figure, in matplotlib's names.
py::dict StyleOfModel(const std::string& contact) {
  static constexpr const char* kLines[] = {"solid", "dashed", "dotted", "dashdot"};
  static constexpr const char* kMarkers[] = {"", "o", "s", "^", "v", "D", "o", "s", "x"};
  const ModelStyle& style = StyleOf(contact);
  const bool open = style.marker == Marker::kOpenCircle || style.marker == Marker::kOpenSquare;
  return py::dict(py::arg("color") = std::string(style.colour),
                  py::arg("linestyle") = kLines[static_cast<int>(style.dash)],
                  py::arg("marker") = kMarkers[static_cast<int>(style.marker)],
                  py::arg("fillstyle") = open ? "none" : "full");
}

}  // namespace

void BindAudit(py::module_* module) {
  module->def("gradient", &Gradient, py::arg("scene"), py::arg("contact"), py::arg("precision"), py::arg("control"));
  module->def("audit",
              &AuditScene,
              py::arg("scene"),
              py::arg("contacts"),
              py::arg("own"),
              py::kw_only(),
              py::arg("precision"),
              py::arg("width_sweep"),
              py::arg("surrogate"),
              py::arg("threads"),
              py::arg("audit_seconds"),
              py::arg("seconds"));
  module->def("contact_models", [] { return SummariesOf(AllContactModels()); });
  module->def("style", &StyleOfModel, py::arg("contact"));
}

}  // namespace saltus::python
