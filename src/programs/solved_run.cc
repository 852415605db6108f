#include "programs/solved_run.h"

#include <algorithm>
#include <chrono>
#include <cmath>

#include "base/interrupt.h"
#include "programs/solve_output.h"
#include "programs/surrogate_flags.h"
#include "saltus/control/objective.h"
#include "saltus/control/single_shooting.h"
#include "saltus/scene/scene_parameter.h"
#include "saltus/simulate/registry.h"
#include "solve/control_guess.h"

namespace saltus {

double LargestDefect(const SolveReport& report) {
  if (report.defects.empty()) return 0;
  const std::vector<double>& last = report.defects.back();
  return *std::max_element(last.begin(), last.end());
}

SolvedRun SolveAndCheck(const Scene& scene, const std::string& solver, const Contact& contact, Precision precision,
                        const SolverOptions& options, const std::function<void(SolvedRun)>& keep) {
  SolvedRun run;
  run.report = Solve(solver, {scene, contact, precision}, options);
  const SolveReport& report = run.report;
  if (report.losses.empty()) return run;
  keep(run);
  CheckRun(scene, contact, precision, &run);
  return run;
}

bool IsConvergence(const SolveReport& report) {
  return report.termination == Termination::kConverged && report.solver != kNoSolver;
}

Json SolveToJson(const Request& request, const SolvedRuns& solved) {
  Json list = Json::array();
  for (const SolvedRun& run : solved.runs) {
    const SolveReport& report = run.report;
    Json item = {{"contact", report.contact}, {"solver", report.solver}};
    AddBias(report.contact, report.surrogate, &item);
    if (run.simulated) {
      item["loss"] = NumberToJson(report.final_loss);
      if (run.exact.ok) item["exact_loss"] = NumberToJson(run.exact.loss);
    }
    if (!report.losses.empty()) {
      item["initial_loss"] = NumberToJson(report.initial_loss);
      item["final_loss"] = NumberToJson(report.final_loss);
      if (run.exact.ok) item["exact_loss"] = NumberToJson(run.exact.loss);
      item["losses"] = NumbersToJson(report.losses);
      item["iterations"] = report.iterations;
      item["evaluations"] = report.evaluations;
      item["seconds"] = report.seconds;
      if (!report.defects.empty()) item["defect"] = NumberToJson(LargestDefect(report));
      if (report.best) {
        item["best_loss"] = NumberToJson(report.best->loss);
        item["best_iteration"] = report.best->iteration;
      }
    }
    item["termination"] = TerminationToString(report.termination);
    if (IsConvergence(report)) item["converged_under"] = report.contact;
    if (!report.reason.empty()) item["reason"] = report.reason;
    if (run.HasSolution()) {
      item["events"] = EventsToJson(run.exact.events);
      AddTies(run.exact.ambiguous, run.exact.spread, &item);
      item["velocity"] = VectorsToJson(request.scene, report.initial_state, 2);
      if (request.scene.Spins()) {
        item["angular_velocity"] = RotationsToJson(request.scene, report.initial_state, 1);
      }
      item["control"] = ControlToJson(request.scene, report.control);
      if (!report.parameters.empty()) item["parameters"] = DesignToJson(request.scene, report.parameters);
      if (!report.standard_error.empty()) item["standard_error"] = NumbersToJson(report.standard_error);
      if (!report.durations.empty()) item["durations"] = NumbersToJson(report.durations);
      if (report.best && !report.best->initial_state.empty()) {
        item["best_velocity"] = VectorsToJson(request.scene, report.best->initial_state, 2);
        if (request.scene.Spins()) {
          item["best_angular_velocity"] = RotationsToJson(request.scene, report.best->initial_state, 1);
        }
        item["best_control"] = ControlToJson(request.scene, report.best->control);
        if (!report.best->parameters.empty()) {
          item["best_parameters"] = DesignToJson(request.scene, report.best->parameters);
        }
        if (!report.best->durations.empty()) item["best_durations"] = NumbersToJson(report.best->durations);
        if (request.scene.optimize == Optimize::kPosition) {
          item["best_position"] = VectorsToJson(request.scene, report.best->initial_state, 0);
        }
      }
      if (run.certificate) item["certificate"] = CertificateToJson(request.scene, *run.certificate);
      if (report.searched) item["searched"] = SearchedToJson(*report.searched);
      if (!report.optima.empty()) item["optima"] = OptimaToJson(request.scene, report.optima);
      if (request.scene.optimize == Optimize::kPosition)
        item["position"] = VectorsToJson(request.scene, report.initial_state, 0);
      if (run.feedback) item["feedback"] = FeedbackToJson(*run.feedback, request.states);
      AddStates(request, run, &item);
    }
    list.push_back(std::move(item));
  }
  Json document = {{"scene", request.scene.name}, {"steps", request.scene.steps}, {"runs", std::move(list)}};
  if (request.states) {
    AddDrawn(request.scene, &document);
  }
  if (solved.interrupted) document["interrupted"] = true;
  return document;
}

namespace {

// A rollout under a contact model.
struct RolloutOutcome {
  std::optional<double> loss;  // nothing if it is not finite
  std::string reason;          // then
  std::vector<double> end;     // final state, in the shape of an initial state; empty if it has to be found otherwise
};

// By equal steps that last as long as the control.
RolloutOutcome RollOutUnderModel(const Scene& given, const Contact& contact, Precision precision,
                                 const SolveReport& report) {
  Scene scene = given;
  scene.free.clear();
  scene.optimize = scene.num_controlled() > 0 ? Optimize::kControl : Optimize::kNone;
  double price_of_time = 0;
  if (scene.objective.duration) {
    scene.duration = DurationOf({report.control, report.durations}, scene);
    price_of_time = scene.objective.duration->weight * scene.duration;
    scene.objective.duration.reset();
  }
  RolloutOutcome outcome;
  outcome.reason = WhyNotApplicable(contact, scene);
  if (!outcome.reason.empty()) return outcome;
  SingleShooting shooting(MakeSimulator(contact, scene, precision));
  shooting.set_stop(InterruptGuard::GraceIsOver);
  const Simulator& simulator = shooting.simulator();
  std::vector<double> z;
  if (scene.num_controlled() > 0) {
    z = MeanOverSteps({report.control, report.durations}, scene.control_width(), simulator.num_steps());
  }
  double loss = 0;
  if (!shooting.Evaluate(z, &loss, nullptr)) {
    outcome.reason = shooting.stopped() ? kStopped : shooting.WhyFailed();
    return outcome;
  }
  outcome.loss = loss + price_of_time;
  if (!report.durations.empty()) return outcome;
  std::vector<double> end(simulator.state_size());
  simulator.GetState(simulator.num_steps(), end);
  outcome.end = ToInitial(end, scene.num_bodies());
  return outcome;
}

// The same of the exact model, from its motion with time-stepping fallbacks. Nothing if the loss is not a function of
// the final state and of a control with equal steps.
std::optional<RolloutOutcome> OutcomeOf(const ExactRun& exact, const Scene& scene, const SolveReport& report) {
  const Objective& objective = scene.objective;
  const std::size_t numbers = InitialControl(scene, scene.steps).size();
  if (exact.end.empty() || !report.durations.empty() || report.control.size() != numbers) return std::nullopt;
  if (!objective.running.empty() || !objective.via.empty() || objective.duration) return std::nullopt;
  const double loss =
      TerminalLoss(objective, ToState(exact.end, scene.num_bodies()), InitialSize(scene) / scene.num_bodies()) +
      EffortLoss(objective, report.control, scene.dt());
  if (!std::isfinite(loss)) return std::nullopt;
  return RolloutOutcome{loss, "", exact.end};
}

// In the shape of an initial state.
std::vector<double> LastState(const Motion& motion) {
  if (!motion.failure.empty() || motion.times.empty()) return {};
  std::vector<double> last;
  for (const std::vector<double>* all : {&motion.states, &motion.rotations}) {
    const auto row = static_cast<std::ptrdiff_t>(all->size() / motion.times.size());
    last.insert(last.end(), all->end() - row, all->end());
  }
  return last;
}

bool IsExact(const Contact& contact) { return FindContactModel(contact)->event_driven; }

void CheckExactly(const Scene& scene, SolvedRun* run) {
  const SolveReport& report = run->report;
  run->exact =
      SimulateExactly(scene, report.initial_state, report.control, report.durations, InterruptGuard::GraceIsOver);
  run->certificate = report.certificate;
  const bool control = scene.optimize == Optimize::kControl && scene.objective.effort > 0;
  const bool design = !report.parameters.empty();
  if (!run->certificate && (control || design)) {
    run->certificate =
        Certify(scene, report.initial_state, report.control, report.durations, InterruptGuard::GraceIsOver);
  }
}

void FindFinalState(const Scene& scene, const Contact& contact, Precision precision, SolvedRun* run) {
  const SolveReport& report = run->report;
  MotionOptions ends;
  ends.precision = precision;
  ends.most_nodes = 2;
  ends.stop = InterruptGuard::GraceIsOver;
  const MotionInput input{report.initial_state, report.control, report.durations};
  run->final_state = LastState(SimulateMotion(scene, contact, input, ends));
}

}  // namespace

void CheckRun(const Scene& given, const Contact& contact, Precision precision, SolvedRun* run) {
  const Scene scene = WithDesign(given, run->report.parameters);
  CheckExactly(scene, run);
  if (IsExact(contact) && run->exact.ok) {
    run->final_state = run->exact.end;
  } else {
    FindFinalState(scene, contact, precision, run);
  }
}

SolvedRun SimulateOnly(const Request& request, const std::string& contact) {
  const Scene& scene = request.scene;
  SolvedRun run;
  SolveReport& report = run.report;
  report.solver = kNoSolver;
  report.contact = contact;
  report.reason = WhyNotApplicable(contact, scene);
  report.termination = report.reason.empty() ? Termination::kFailed : Termination::kNotApplicable;
  if (!report.reason.empty()) return run;
  const auto start = std::chrono::steady_clock::now();
  report.initial_state = InitialState(scene);
  report.control = InitialControl(scene, scene.steps);
  if (request.start) {
    report.control = request.start->control;
    report.durations = request.start->durations;
  }
  CheckExactly(scene, &run);
  std::optional<RolloutOutcome> outcome;
  if (IsExact(contact) && run.exact.ok) outcome = {run.exact.loss, "", run.exact.end};
  if (IsExact(contact) && !outcome && request.precision == Precision::kDouble) {
    outcome = OutcomeOf(run.exact, scene, report);
  }
  if (!outcome) outcome = RollOutUnderModel(scene, contact, request.precision, report);
  run.final_state = outcome->end;
  if (run.final_state.empty()) FindFinalState(scene, contact, request.precision, &run);
  report.reason = IsExact(contact) ? run.exact.reason : outcome->reason;
  report.seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
  run.simulated = outcome->loss && std::isfinite(*outcome->loss);
  if (report.reason == kStopped) report.termination = Termination::kInterrupted;
  if (!run.simulated) return run;
  report.initial_loss = report.final_loss = *outcome->loss;
  report.termination = Termination::kConverged;
  return run;
}

Motion MotionOf(const Request& request, const SolveReport& report, bool exact, const MotionOptions& options) {
  const MotionInput input{report.initial_state, report.control, report.durations};
  MotionOptions own = options;
  own.precision = request.precision;
  own.stop = InterruptGuard::GraceIsOver;
  const Scene scene = WithDesign(request.scene, report.parameters);
  return exact ? SimulateExactMotion(scene, input, own) : SimulateMotion(scene, report.contact, input, own);
}

std::vector<double> NodesOf(const Scene& scene, const SolveReport& report) {
  std::vector<double> nodes = {0};
  for (const double length : report.durations) nodes.push_back(nodes.back() + length);
  if (!report.durations.empty()) return nodes;
  const int steps = scene.steps / FindContactModel(report.contact)->grid_steps;
  for (int k = 1; k <= steps; ++k) nodes.push_back(k * (scene.duration / steps));
  return nodes;
}

}  // namespace saltus
