#include "ceres_common.h"

#include <algorithm>

namespace saltus {
namespace {

bool GradientVanished(std::span<const ceres::IterationSummary> iterations) {
  double largest = 0;
  for (const ceres::IterationSummary& iteration : iterations) largest = std::max(largest, iteration.gradient_max_norm);
  return iterations.back().gradient_max_norm <= std::max(kGradientTolerance, kGradientReduction * largest);
}

Termination Judge(const CeresOutcome& outcome) {
  if (outcome.iterations.empty()) {
    return outcome.type == ceres::CONVERGENCE ? Termination::kConverged : Termination::kFailed;
  }
  if (outcome.type == ceres::USER_SUCCESS) return Termination::kInterrupted;
  if (outcome.type == ceres::FAILURE && !outcome.failure_is_stall) return Termination::kFailed;
  if (GradientVanished(outcome.iterations)) return Termination::kConverged;
  return outcome.type == ceres::NO_CONVERGENCE ? Termination::kIterationLimit : Termination::kNoProgress;
}

}  // namespace

double GivenEffort(const SingleShooting& shooting) {
  const Scene& scene = shooting.scene();
  if (scene.optimize == Optimize::kControl) return 0;
  return EffortLoss(scene.objective, shooting.ControlAt(shooting.initial_guess()), shooting.simulator().step());
}

bool RecordIteration::Record(const ceres::IterationSummary& summary) {
  if (summary.iteration == 0 || summary.step_is_successful) last_ = loss_(summary.cost);
  return run_->Record(last_, *z_);
}

ceres::CallbackReturnType RecordIteration::operator()(const ceres::IterationSummary& summary) {
  return Record(summary) ? ceres::SOLVER_CONTINUE : ceres::SOLVER_TERMINATE_SUCCESSFULLY;
}

Termination RecordEnd(SolveRun* run, RecordIteration* record, std::span<const double> z, const CeresOutcome& outcome) {
  const Termination termination = Judge(outcome);
  if (termination != Termination::kInterrupted) {
    for (size_t i = run->num_recorded(); i < outcome.iterations.size(); ++i) record->Record(outcome.iterations[i]);
  }
  // Where the gradient vanishes at the initial guess, the line search solver reports no iteration at all.
  double loss = 0;
  if (run->num_recorded() == 0 && run->shooting().Evaluate(z, &loss, nullptr)) run->Record(loss, z);
  return termination;
}

SolveReport Conclude(SolveRun* run, RecordIteration* record, std::span<const double> z, const CeresOutcome& outcome) {
  const Termination termination = RecordEnd(run, record, z, outcome);
  return run->Finish(z, termination, outcome.message);
}

}  // namespace saltus
