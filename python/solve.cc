// Solvers, with a callback, as the programs report them.
#include "programs/solve.h"

#include <pybind11/stl.h>

#include <cmath>

#include "arrays.h"
#include "base/interrupt.h"
#include "base/number_text.h"
#include "computation.h"
#include "convert.h"
#include "saltus/control/control_rows.h"
#include "saltus/global/global_bound.h"
#include "saltus/simulate/exact_run.h"
#include "saltus/solve/solver.h"
#include "saltus/solve/solvers_by_name.h"

namespace saltus::python {
namespace {

struct Keywords {
  int iterations;
  std::optional<double> learning_rate;
  bool rate_per_time;
  std::string sequence;
  py::object guess;  // a control, and the lengths of its intervals; or None
  py::object surrogate;
  int threads;
  double memory_limit;  // MiB
  bool keep_iterates;
  double seconds;
};

void SetSequence(const Scene& scene, const std::string& sequence, SolverOptions* options) {
  options->sequences.search = sequence == "auto";
  if (sequence == "auto" || sequence == "fixed") return;
  const std::string wrong = ParseContactSequence(scene, sequence, &options->sequences.given.emplace());
  if (!wrong.empty()) throw py::value_error("sequence: " + wrong);
}

SolverOptions ReadOptions(const Scene& scene, const Keywords& keywords) {
  SolverOptions options;
  if (keywords.iterations < 0) throw py::value_error("iterations: expected a number of at least 0");
  options.limits.iterations = keywords.iterations;
  options.descent.rate_per_time = keywords.rate_per_time;
  options.descent.learning_rate = keywords.learning_rate.value_or(
      DefaultLearningRate(scene) * (keywords.rate_per_time ? scene.duration / kPublishedSteps : 1));
  if (!(options.descent.learning_rate > 0) || !std::isfinite(options.descent.learning_rate)) {
    throw py::value_error("learning_rate: expected a finite number > 0");
  }
  if (keywords.rate_per_time && scene.optimize != Optimize::kControl) {
    throw py::value_error("rate_per_time: the scene does not optimize a control");
  }
  if (!(keywords.memory_limit > 0 && keywords.memory_limit < 1e9)) {
    throw py::value_error("memory_limit: expected MiB > 0");
  }
  SetSequence(scene, keywords.sequence, &options);
  if (!keywords.guess.is_none() && scene.optimize == Optimize::kControl) {
    const auto [control, durations] = keywords.guess.cast<std::pair<py::object, std::vector<double>>>();
    const py::ssize_t intervals = static_cast<py::ssize_t>(durations.size());
    const Array rows = ReadArray(control, "start", {intervals, scene.num_controlled(), ControlColumns(scene)});
    CheckRows(scene, "start", View(rows));
    options.guess = ControlGuess{ControlOfRows(scene, View(rows)), durations};
  }
  options.surrogate = ReadSurrogate(keywords.surrogate);
  options.threads = ReadThreads(keywords.threads);
  options.limits.memory = static_cast<std::size_t>(keywords.memory_limit * (1 << 20));
  options.keep_iterates = keywords.keep_iterates;
  return options;
}

// Returns the answer of a callback: False ends the run, True and None go on.
bool GoesOn(const py::object& answer) {
  if (answer.is_none()) return true;
  if (PyBool_Check(answer.ptr())) return answer.cast<bool>();
  throw py::type_error("callback: found " + std::string(py::repr(answer)) + ", expected True, False or None");
}

py::dict RunToPython(const Scene& scene, const SolvedRun& run) {
  Request request;
  request.scene = scene;
  py::dict result = ToPython(SolveToJson(request, {{run}, false})["runs"][0]);
  if (!run.report.history.iterates.empty()) result["iterates"] = py::cast(run.report.history.iterates);
  return result;
}

// Returns a function that writes the page and the solution of a run to a folder, as programs do.
py::object PageOfRun(const Scene& scene, const Contact& contact, SolvedRun run, Precision precision) {
  Request request;
  request.scene = scene;
  request.contacts = {contact.name()};
  request.solvers = {run.report.solver};
  request.precision = precision;
  run.report.history.iterates.clear();
  return py::cpp_function([request, solved = SolvedRuns{{std::move(run)}}](const std::string& folder) {
    Request in_folder = request;
    in_folder.output_dir = folder;
    Computation().RunOrThrow([&] {
      WriteSolutions(in_folder, solved);
      WriteSolveReport(in_folder, solved);
    });
  });
}

// A run, the function of its page, and what has stopped it: an exception or None.
py::tuple SolveScene(const Scene& scene, const py::object& contact_name, const std::string& solver,
                     const std::string& precision, const py::object& callback, const py::object& status,
                     const Keywords& keywords) {
  const Contact contact = ReadContact(contact_name);
  SolverOptions options = ReadOptions(scene, keywords);
  Computation computation(keywords.seconds);
  options.monitor.stop = computation.stop();
  if (!callback.is_none()) {
    options.monitor.callback = [&](int iteration, double loss) {
      bool on = true;
      return computation.WithPython([&] { on = GoesOn(callback(iteration, loss)); }) && on;
    };
  }
  if (!status.is_none()) {
    options.monitor.status = [&](const std::string& text) { computation.WithPython([&] { status(text); }); };
  }
  SolvedRun run;
  const Precision arithmetic = ReadPrecision(precision);
  computation.Run([&] {
    const SolveRequest request{scene, contact, arithmetic};
    run = SolvedRun{SolveAndCheck(solver, request, options, InterruptGuard::GraceIsOver, [](const CheckedRun&) {})};
  });
  if (run.report.termination == Termination::kNotApplicable) throw py::value_error(run.report.reason);
  if (run.report.termination == Termination::kInterrupted) computation.AddWhyTimedOut(&run.report.reason);
  py::dict result = RunToPython(scene, run);
  return py::make_tuple(result, PageOfRun(scene, contact, std::move(run), arithmetic), computation.StoppedBy());
}

// Returns sequences by the names of their pairs, with their bounds.
py::list BoundsToPython(const Scene& scene, const std::vector<SequenceBound>& bounds) {
  py::list list;
  for (const SequenceBound& bound : bounds) {
    py::dict item;
    item["sequence"] = ContactSequenceToString(scene, bound.sequence);
    item["repeated"] = std::vector<bool>(bound.repeated.begin(), bound.repeated.end());
    item["open"] = bound.open;
    item["lower_bound"] = bound.lower;
    item["boxes"] = bound.boxes;
    list.append(item);
  }
  return list;
}

// Returns the bound, and the exception that has stopped it, or None.
py::tuple BoundScene(const Scene& scene, double loss, double gap, double seconds, std::size_t boxes) {
  if (const std::optional<SceneError> error = Validate(scene)) throw py::value_error(error->ToString());
  if (const std::string why = UnsupportedByGlobalBound(scene); !why.empty()) throw py::value_error(why);
  if (!std::isfinite(loss)) throw py::value_error("loss: expected a finite number");
  if (!(gap > 0)) throw py::value_error("gap: expected a number > 0");
  if (!(seconds >= 0)) throw py::value_error("seconds: expected a number >= 0");
  Computation computation;
  GlobalBound bound;
  computation.Run([&] {
    bound = BoundGlobally(scene, loss, {.gap = gap, .seconds = seconds, .boxes = boxes, .stop = computation.stop()});
  });
  py::list remarks;
  if (bound.interrupted && computation.StoppedBy().is_none()) {
    remarks.append("ended after " + std::to_string(bound.boxes) +
                   " boxes, before the gap was reached; raise boxes or seconds (0 is no limit)");
  }
  const bool complete = bound.gap() <= gap;
  if (!bound.interrupted && !complete) {
    remarks.append("no part that is left can be divided further: " + ToText(bound.lower) +
                   " is the bound for forces of any shape in time, and a gap of " + ToText(bound.gap(), 2) +
                   " remains; give the loss of a control on more steps");
  }
  // A known motion is in one of the parts that are left.
  if (!bound.interrupted && bound.left.empty()) {
    remarks.append("no control has the given loss: all are above it; give the loss of a motion");
  }
  const ExactRun own = SimulateExactly(scene, InitialState(scene), InitialControl(scene, scene.steps));
  if (own.ok && own.loss < loss) {
    remarks.append("the scene's own control has a smaller loss, " + ToText(own.loss) +
                   "; the bound is best with the loss of a solution");
  }
  py::dict result;
  result["loss"] = bound.upper;
  result["lower_bound"] = bound.lower;
  result["gap"] = bound.gap();
  result["boxes"] = bound.boxes;
  result["complete"] = complete;
  result["remarks"] = remarks;
  result["left"] = BoundsToPython(scene, bound.left);
  result["excluded"] = BoundsToPython(scene, bound.excluded);
  return py::make_tuple(result, computation.StoppedBy());
}

}  // namespace

void BindSolve(py::module_* module) {
  module->def(
      "solve",
      [](const Scene& scene,
         const py::object& contact,
         const std::string& solver,
         const std::string& precision,
         const py::object& callback,
         const py::object& status,
         int iterations,
         std::optional<double>
             learning_rate,
         bool rate_per_time,
         const std::string& sequence,
         const py::object& guess,
         const py::object& surrogate,
         int threads,
         double memory_limit,
         bool keep_iterates,
         double seconds) {
        return SolveScene(scene,
                          contact,
                          solver,
                          precision,
                          callback,
                          status,
                          {iterations,
                           learning_rate,
                           rate_per_time,
                           sequence,
                           guess,
                           surrogate,
                           threads,
                           memory_limit,
                           keep_iterates,
                           seconds});
      },
      py::arg("scene"),
      py::arg("contact"),
      py::arg("solver"),
      py::kw_only(),
      py::arg("precision"),
      py::arg("callback"),
      py::arg("status"),
      py::arg("iterations"),
      py::arg("learning_rate"),
      py::arg("rate_per_time"),
      py::arg("sequence"),
      py::arg("guess"),
      py::arg("surrogate"),
      py::arg("threads"),
      py::arg("memory_limit"),
      py::arg("keep_iterates"),
      py::arg("seconds"));
  module->def("solvers", [] {
    std::vector<SolverEntry> solvers = AllSolvers();
    solvers.insert(solvers.end(), SolversByName().begin(), SolversByName().end());
    return SummariesOf(solvers);
  });
  module->def("bound_globally",
              &BoundScene,
              py::arg("scene"),
              py::arg("loss"),
              py::kw_only(),
              py::arg("gap"),
              py::arg("seconds"),
              py::arg("boxes"));
}

}  // namespace saltus::python
