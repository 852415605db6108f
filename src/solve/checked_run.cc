#include "solve/checked_run.h"

#include <chrono>
#include <cmath>
#include <numeric>

#include "saltus/control/objective.h"
#include "saltus/control/single_shooting.h"
#include "saltus/scene/scene_parameter.h"
#include "saltus/simulate/registry.h"
#include "solve/control_guess.h"

namespace saltus {
namespace {

// A rollout under a contact model.
struct RolloutOutcome {
  std::optional<double> loss;  // nothing if it is not finite
  std::string reason;          // then
  std::vector<double> end;     // final state, in the shape of an initial state; empty if it has to be found otherwise
};

// Rolls out under a contact model by equal steps that last as long as the control.
RolloutOutcome RollOutUnderModel(const SolveRequest& request, const SolveReport& report, const StopRequest& stop) {
  double price_of_time = 0;
  const Scene scene = FixFinalTime(request.scene, InputOf(report), &price_of_time);
  RolloutOutcome outcome;
  outcome.reason = ReasonNotApplicable(request.contact, scene);
  if (!outcome.reason.empty()) return outcome;
  SingleShooting shooting(MakeSimulator(request.contact, scene, request.precision));
  shooting.set_stop(stop);
  const Simulator& simulator = shooting.simulator();
  std::vector<double> z;
  if (scene.num_controlled() > 0) {
    z = MeanOverSteps(
        {report.solution.control, report.solution.durations}, scene.control_width(), simulator.num_steps());
  }
  double loss = 0;
  if (!shooting.Evaluate(z, &loss, nullptr)) {
    outcome.reason = shooting.stopped() ? kStopped : shooting.FailureReason();
    return outcome;
  }
  outcome.loss = loss + price_of_time;
  if (!report.solution.durations.empty()) return outcome;
  std::vector<double> end(simulator.state_size());
  simulator.GetState(simulator.num_steps(), end);
  outcome.end = ToInitial(end, scene.num_bodies());
  return outcome;
}

// Returns the rollout of the exact model, from its motion with time-stepping fallbacks. Returns std::nullopt if the
// loss is not a function of the final state and of a control with equal steps.
std::optional<RolloutOutcome> OutcomeOf(const ExactRun& exact, const Scene& scene, const SolveReport& report) {
  const Objective& objective = scene.objective;
  const std::size_t numbers = InitialControl(scene, scene.steps).size();
  if (exact.end.empty() || !report.solution.durations.empty() || report.solution.control.size() != numbers) {
    return std::nullopt;
  }
  if (!objective.running.empty() || !objective.via.empty() || objective.duration) return std::nullopt;
  const double loss =
      TerminalLoss(objective, ToState(exact.end, scene.num_bodies()), InitialSize(scene) / scene.num_bodies()) +
      EffortLoss(objective, report.solution.control, scene.dt());
  if (!std::isfinite(loss)) return std::nullopt;
  return RolloutOutcome{loss, "", exact.end};
}

// Returns the last state of a motion in the shape of an initial state; empty if the motion failed.
std::vector<double> LastState(const Motion& motion) {
  if (!motion.failure.empty() || motion.times.empty()) return {};
  std::vector<double> last;
  for (const std::vector<double>* all : {&motion.states, &motion.rotations}) {
    const auto row = static_cast<std::ptrdiff_t>(all->size() / motion.times.size());
    last.insert(last.end(), all->end() - row, all->end());
  }
  return last;
}

void CheckExactly(const Scene& scene, const StopRequest& stop, CheckedRun* run) {
  const SolveReport& report = run->report;
  run->exact =
      SimulateExactly(scene, report.solution.initial_state, report.solution.control, report.solution.durations, stop);
  run->certificate = report.certificate;
  const bool control = scene.optimize == Optimize::kControl && scene.objective.effort > 0;
  const bool design = !report.solution.parameters.empty();
  if (!run->certificate && (control || design)) {
    run->certificate =
        Certify(scene, report.solution.initial_state, report.solution.control, report.solution.durations, stop);
  }
}

// Simulates the motion under the contact model for its final state.
std::vector<double> FindFinalState(const Scene& scene, const SolveRequest& request, const SolveReport& report,
                                   const StopRequest& stop) {
  const MotionOptions ends{.precision = request.precision, .most_nodes = 2, .stop = stop};
  return LastState(SimulateMotion(scene, request.contact, InputOf(report), ends));
}

bool IsExact(const Contact& contact) { return contact.entry()->traits.event_driven; }

}  // namespace

MotionInput InputOf(const SolveReport& report) {
  return {report.solution.initial_state, report.solution.control, report.solution.durations};
}

CheckedRun SolveAndCheck(const std::string& solver, const SolveRequest& request, const SolverOptions& options,
                         const StopRequest& stop, const std::function<void(CheckedRun)>& keep) {
  CheckedRun run;
  run.report = Solve(solver, request, options);
  if (run.report.history.losses.empty()) return run;
  if (request.scene.objective.duration) {
    run.duration = std::accumulate(run.report.solution.durations.begin(), run.report.solution.durations.end(), 0.0);
  }
  keep(run);
  const Scene scene = WithDesign(request.scene, run.report.solution.parameters);
  CheckExactly(scene, stop, &run);
  const bool known = IsExact(request.contact) && run.exact.ok;
  run.final_state = known ? run.exact.end : FindFinalState(scene, request, run.report, stop);
  return run;
}

CheckedRun SolveAndSimulate(const std::string& solver, const SolveRequest& request, const SolverOptions& options) {
  CheckedRun run;
  run.report = Solve(solver, request, options);
  const SolveReport& report = run.report;
  if (report.history.losses.empty()) return run;
  const Scene scene = WithDesign(request.scene, report.solution.parameters);
  run.exact = SimulateExactly(scene, report.solution.initial_state, report.solution.control, report.solution.durations);
  return run;
}

CheckedRun SimulateAndCheck(const SolveRequest& request, const std::optional<ControlGuess>& guess,
                            const StopRequest& stop) {
  const Scene& scene = request.scene;
  CheckedRun run;
  SolveReport& report = run.report;
  report.solver = kNoSolver;
  report.contact = request.contact.name();
  report.reason = ReasonNotApplicable(request.contact, scene);
  report.termination = report.reason.empty() ? Termination::kFailed : Termination::kNotApplicable;
  if (!report.reason.empty()) return run;
  const auto begin = std::chrono::steady_clock::now();
  report.solution.initial_state = InitialState(scene);
  report.solution.parameters = DesignOf(scene);
  report.solution.control = guess ? guess->control : InitialControl(scene, scene.steps);
  if (guess) report.solution.durations = guess->durations;
  CheckExactly(scene, stop, &run);
  const bool exact = IsExact(request.contact);
  std::optional<RolloutOutcome> outcome;
  if (exact && run.exact.ok) outcome = {run.exact.loss, "", run.exact.end};
  if (exact && !outcome && request.precision == Precision::kDouble) outcome = OutcomeOf(run.exact, scene, report);
  if (!outcome) outcome = RollOutUnderModel(request, report, stop);
  run.final_state = outcome->end.empty() ? FindFinalState(scene, request, report, stop) : outcome->end;
  report.reason = exact ? run.exact.reason : outcome->reason;
  report.work.seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count();
  run.simulated = outcome->loss && std::isfinite(*outcome->loss);
  if (report.reason == kStopped) report.termination = Termination::kInterrupted;
  if (!run.simulated) return run;
  report.guess.loss = report.solution.loss = *outcome->loss;
  report.termination = Termination::kConverged;
  return run;
}

}  // namespace saltus
