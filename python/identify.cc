// Parameters of scenes from recordings of their motion, as the program saltus_identify reports them.
#include "saltus/identify/identify.h"

#include <pybind11/stl.h>

#include <cmath>

#include "arrays.h"
#include "computation.h"
#include "convert.h"
#include "programs/identification.h"
#include "saltus/identify/hybrid_fit.h"

namespace saltus::python {
namespace {

// Names or indices of bodies as text or whole numbers, all else as doubles.
NpyArray ReadColumn(const std::string& key, const py::handle& value, const std::string& name) {
  const bool bodies = key == "body";
  const std::string expected = bodies ? "names or indices of bodies" : "real numbers";
  py::array any = py::array::ensure(value);
  if (!any) throw py::type_error(name + ": found no array, expected " + expected);
  if (bodies && any.dtype().kind() == 'O') any = any.attr("astype")("str");  // a column of pandas
  NpyArray column;
  column.shape.assign(any.shape(), any.shape() + any.ndim());
  const char kind = any.dtype().kind();
  if (bodies && kind == 'U') {
    column.data = any.attr("ravel")().attr("tolist")().cast<std::vector<std::string>>();
  } else if (bodies && (kind == 'i' || kind == 'u')) {
    column.data = any.attr("ravel")().attr("tolist")().cast<std::vector<std::int64_t>>();
  } else if (!bodies && (kind == 'f' || kind == 'i' || kind == 'u')) {
    column.data = ToVector(ReadNumbers(any, name, {any.shape(), any.shape() + any.ndim()}));
  } else {
    throw py::type_error(name + ": found dtype " + std::string(py::str(any.dtype())) + ", expected " + expected);
  }
  return column;
}

// The path of a file, or a dict of arrays.
Recording ReadRecording(const py::handle& given, const std::string& name, const Scene& scene) {
  std::variant<Recording, RecordingError> read;
  if (py::isinstance<py::str>(given)) {
    read = LoadAnyRecording(given.cast<std::string>(), scene);
  } else {
    NpzArrays columns;
    for (const auto& [key_handle, value] : given.cast<py::dict>()) {
      const std::string key = py::str(key_handle);
      columns[key] = ReadColumn(key, value, name + "['" + key + "']");
    }
    read = RecordingFromArrays(columns, name, scene);
  }
  if (const auto* error = std::get_if<RecordingError>(&read)) throw py::value_error(error->ToString());
  return std::get<Recording>(std::move(read));
}

// Keywords that fits of scenes and of hybrid systems have in common.
struct CommonKeywords {
  std::string loss;
  double loss_scale, seconds;
  int starts, threads;
};
struct FitKeywords {
  CommonKeywords common;
  std::string law, events;
  double segment;
  bool known_start;
};

IdentifyOptions ReadCommonOptions(const CommonKeywords& keywords) {
  IdentifyOptions options;
  const std::optional<RobustLoss> loss = ParseRobustLoss(keywords.loss);
  if (!loss) throw py::value_error("loss: found '" + keywords.loss + "', expected none, huber or cauchy");
  if (!(keywords.loss_scale > 0) || !std::isfinite(keywords.loss_scale)) {
    throw py::value_error("loss_scale: expected a finite number > 0");
  }
  if (keywords.starts < 1) throw py::value_error("starts: expected a number of at least 1");
  options.loss = *loss;
  options.loss_scale = keywords.loss_scale;
  options.starts = keywords.starts;
  options.threads = ReadThreads(keywords.threads);
  return options;
}

IdentifyOptions ReadFitOptions(const Scene& scene, const FitKeywords& keywords) {
  IdentifyOptions options = ReadCommonOptions(keywords.common);
  if (!(keywords.segment >= 0)) throw py::value_error("segment: expected a time of at least 0 s");
  if (!keywords.law.empty()) {
    auto law = ParseLaw(keywords.law, scene);
    if (const auto* wrong = std::get_if<std::string>(&law)) {
      throw py::value_error("law: found '" + keywords.law + "', " + *wrong);
    }
    options.law = std::get<ImpactLaw>(std::move(law));
  }
  if (!keywords.events.empty()) {
    auto events = ParseEvents(keywords.events, scene);
    if (const auto* wrong = std::get_if<std::string>(&events)) {
      throw py::value_error("events: found '" + keywords.events + "', " + *wrong);
    }
    options.events = std::get<EventFunctions>(std::move(events));
  }
  options.segment = keywords.segment;
  options.initial_states = !keywords.known_start;
  return options;
}

// Runs a fit, `fit`(options), until it is stopped, and returns its report. Throws ValueError if it is not applicable.
template <typename Fit>
IdentifyReport RunFit(IdentifyOptions options, const py::object& status, const std::string& prefix,
                      Computation* computation, const Fit& fit) {
  IdentifyReport report;
  options.stop = computation->stop();
  if (!status.is_none()) {
    options.status = [&](const std::string& text) { computation->WithPython([&] { status(text); }); };
  }
  computation->Run([&] { report = fit(options); });
  if (report.verdict == FitVerdict::kNotApplicable) throw py::value_error(prefix + report.reason);
  if (report.verdict == FitVerdict::kInterrupted && report.reason.empty())
    report.reason = computation->ReasonTimedOut();
  return report;
}

// A fit, the function that writes its page to a folder, and what has stopped it: an exception or None.
py::tuple IdentifyScene(const Scene& scene, const py::list& recordings, const std::string& unknown,
                        const py::object& contact_name, const py::object& status, const FitKeywords& keywords) {
  const Contact contact = ReadContact(contact_name);
  const IdentifyOptions options = ReadFitOptions(scene, keywords);
  const bool learns = options.law || options.events;
  auto unknowns = learns && unknown.empty() ? std::vector<Unknown>() : ParseUnknowns(unknown, scene);
  if (const auto* wrong = std::get_if<std::string>(&unknowns)) throw py::value_error("unknown: " + *wrong);
  Identified identified{.recordings = {}, .contacts = {contact.name()}, .reports = {}};
  for (size_t i = 0; i < recordings.size(); ++i) {
    const std::string name = "recordings[" + std::to_string(i) + "]";
    identified.recordings.push_back(ReadRecording(recordings[i], name, scene));
  }
  Computation computation(keywords.common.seconds);
  identified.reports.push_back(
      RunFit(options, status, contact.name() + ": ", &computation, [&](const IdentifyOptions& running) {
        return Identify(contact, scene, identified.recordings, std::get<std::vector<Unknown>>(unknowns), running);
      }));
  const Json document = IdentifiedToJson(scene, identified);
  const py::object result = ToPython(document["fits"][0]);
  const py::cpp_function page([scene, identified = std::move(identified), document](const std::string& folder) {
    Request request;
    request.scene = scene;
    request.output_dir = folder;
    Computation().RunOrThrow([&] { WriteIdentifyReport(request, identified, document); });
  });
  return py::make_tuple(result, page, computation.StoppedBy());
}

// Name, whether it is a component of the initial state, its index, the only experiment that has it or -1, and bounds.
using UnknownTuple = std::tuple<std::string, bool, int, int, double, double>;

// Fits experiments with a system of that kind, and returns what IdentifyScene() returns.
py::tuple IdentifyHybrid(const std::string& kind, const std::vector<HybridExperiment>& experiments,
                         const std::vector<UnknownTuple>& given, const py::object& status,
                         const CommonKeywords& keywords) {
  std::vector<HybridUnknown> unknowns;
  for (const auto& [name, is_initial, index, experiment, min, max] : given) {
    unknowns.push_back({name, is_initial, index, experiment, min, max});
  }
  Identified identified{.recordings = {}, .contacts = {kind}, .reports = {}, .by = "system"};
  Computation computation(keywords.seconds);
  identified.reports.push_back(
      RunFit(ReadCommonOptions(keywords), status, "", &computation, [&](const IdentifyOptions& options) {
        return Identify(experiments, unknowns, options);
      }));
  const Json document = HybridFitToJson(identified);
  const py::object result = ToPython(document["fits"][0]);
  const py::cpp_function page([identified = std::move(identified), document](const std::string& folder) {
    Computation().RunOrThrow([&] { WriteHybridFitPage(identified, document, folder + "/report.html"); });
  });
  return py::make_tuple(result, page, computation.StoppedBy());
}

}  // namespace

void BindIdentify(py::module_* module) {
  module->def(
      "identify",
      [](const Scene& scene,
         const py::list& recordings,
         const std::string& unknown,
         const py::object& contact,
         const std::string& law,
         const std::string& events,
         const std::string& loss,
         double loss_scale,
         double segment,
         double seconds,
         bool known_start,
         int starts,
         int threads,
         const py::object& status) {
        return IdentifyScene(scene,
                             recordings,
                             unknown,
                             contact,
                             status,
                             {{loss, loss_scale, seconds, starts, threads}, law, events, segment, known_start});
      },
      py::arg("scene"),
      py::arg("recordings"),
      py::arg("unknown"),
      py::arg("contact"),
      py::kw_only(),
      py::arg("law"),
      py::arg("events"),
      py::arg("loss"),
      py::arg("loss_scale"),
      py::arg("segment"),
      py::arg("seconds"),
      py::arg("known_start"),
      py::arg("starts"),
      py::arg("threads"),
      py::arg("status"));
  module->def(
      "identify_hybrid",
      [](const std::string& kind,
         const std::vector<HybridExperiment>& experiments,
         const std::vector<UnknownTuple>& unknowns,
         const std::string& loss,
         double loss_scale,
         double seconds,
         int starts,
         int threads,
         const py::object& status) {
        return IdentifyHybrid(kind, experiments, unknowns, status, {loss, loss_scale, seconds, starts, threads});
      },
      py::arg("kind"),
      py::arg("experiments"),
      py::arg("unknowns"),
      py::kw_only(),
      py::arg("loss"),
      py::arg("loss_scale"),
      py::arg("seconds"),
      py::arg("starts"),
      py::arg("threads"),
      py::arg("status"));
}

}  // namespace saltus::python
