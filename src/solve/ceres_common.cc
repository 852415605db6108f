#include "solve/ceres_common.h"

#include <algorithm>
#include <utility>

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

// What Ceres says of itself is about its own thresholds.
std::string Describe(Termination termination, const CeresOutcome& outcome) {
  switch (termination) {
    case Termination::kConverged:
      return "the gradient has vanished";
    case Termination::kIterationLimit:
      return "the gradient has not vanished within the iterations allowed";
    case Termination::kNoProgress:
      return outcome.type == ceres::FAILURE ? "no descent was found, though the gradient has not vanished"
                                            : "steps no longer lower the loss, though the gradient has not vanished";
    case Termination::kFailed:
      return "no step was found that has a finite loss and derivatives";
    case Termination::kInterrupted:
    case Termination::kNotApplicable:
      return "";
  }
  return "";
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

End RecordEnd(ShootingRun* run, RecordIteration* record, std::span<const double> z, const CeresOutcome& outcome) {
  const Termination termination = Judge(outcome);
  if (termination != Termination::kInterrupted) {
    for (size_t i = run->num_recorded(); i < outcome.iterations.size(); ++i) record->Record(outcome.iterations[i]);
  }
  // Where the gradient vanishes at the initial guess, the line search solver reports no iteration at all.
  double loss = 0;
  if (run->num_recorded() == 0 && run->function().Evaluate(z, &loss, nullptr)) run->Record(loss, z);
  return {termination, Describe(termination, outcome)};
}

SolveReport Conclude(ShootingRun* run, RecordIteration* record, std::span<const double> z,
                     const CeresOutcome& outcome) {
  auto [termination, words] = RecordEnd(run, record, z, outcome);
  return run->Finish(z, termination, std::move(words));
}

}  // namespace saltus
