#include "programs/simulated_run.h"

#include <chrono>
#include <cmath>

#include "base/interrupt.h"
#include "saltus/control/single_shooting.h"
#include "saltus/simulate/registry.h"
#include "solve/control_guess.h"

namespace saltus {
namespace {

// The loss under a model that steps in time; nothing if it is not finite, with the reason.
std::optional<double> LossUnderModel(const Scene& given, const Contact& contact, Precision precision,
                                     const SolveReport& report, std::string* reason) {
  Scene scene = given;
  scene.free.clear();
  scene.optimize = scene.num_controlled() > 0 ? Optimize::kControl : Optimize::kNone;
  double price_of_time = 0;
  if (scene.objective.duration) {
    scene.duration = DurationOf({report.control, report.durations}, scene);
    price_of_time = scene.objective.duration->weight * scene.duration;
    scene.objective.duration.reset();
  }
  *reason = WhyNotApplicable(contact, scene);
  if (!reason->empty()) return std::nullopt;
  SingleShooting shooting(MakeSimulator(contact, scene, precision));
  shooting.set_stop(InterruptGuard::GraceIsOver);
  std::vector<double> z;
  if (scene.num_controlled() > 0) {
    z = MeanOverSteps({report.control, report.durations}, scene.control_width(), shooting.simulator().num_steps());
  }
  double loss = 0;
  if (shooting.Evaluate(z, &loss, nullptr)) return loss + price_of_time;
  *reason = shooting.stopped() ? kStopped : shooting.WhyFailed();
  return std::nullopt;
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

}  // namespace

void CheckRun(const Scene& scene, const Contact& contact, Precision precision, SolvedRun* run) {
  const SolveReport& report = run->report;
  run->exact =
      SimulateExactly(scene, report.initial_state, report.control, report.durations, InterruptGuard::GraceIsOver);
  run->certificate = report.certificate;
  if (!run->certificate && scene.optimize == Optimize::kControl && scene.objective.effort > 0) {
    run->certificate =
        Certify(scene, report.initial_state, report.control, report.durations, InterruptGuard::GraceIsOver);
  }
  if (IsExact(contact) && run->exact.ok) {
    run->final_state = run->exact.end;
    return;
  }
  MotionOptions ends;
  ends.precision = precision;
  ends.most_nodes = 2;
  ends.stop = InterruptGuard::GraceIsOver;
  const MotionInput input{report.initial_state, report.control, report.durations};
  run->final_state = LastState(SimulateMotion(scene, contact, input, ends));
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
  CheckRun(scene, contact, request.precision, &run);
  std::optional<double> loss;
  if (IsExact(contact) && run.exact.ok) {
    loss = run.exact.loss;
  } else {
    loss = LossUnderModel(scene, contact, request.precision, report, &report.reason);
  }
  if (IsExact(contact)) report.reason = run.exact.reason;
  report.seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
  run.simulated = loss && std::isfinite(*loss);
  if (report.reason == kStopped) report.termination = Termination::kInterrupted;
  if (!run.simulated) return run;
  report.initial_loss = report.final_loss = *loss;
  report.termination = Termination::kConverged;
  return run;
}

Motion MotionOf(const Request& request, const SolveReport& report, bool exact, const MotionOptions& options) {
  const MotionInput input{report.initial_state, report.control, report.durations};
  MotionOptions own = options;
  own.precision = request.precision;
  own.stop = InterruptGuard::GraceIsOver;
  return exact ? SimulateExactMotion(request.scene, input, own)
               : SimulateMotion(request.scene, report.contact, input, own);
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
