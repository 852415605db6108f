#include "solve/phases/ceres_event.h"

#include "solve/phases/phase_attempt.h"
#include "solve/phases/sequence_update.h"

namespace saltus {

void PolishByTranscription(PhaseRun* run, const PhasePlan& plan, const std::vector<int>& intervals,
                           const ContinuePredicate& may_continue, PlanAttempt* attempt) {
  if (!attempt->converged || !attempt->realized || !run->IsRefuted(attempt->trial)) return;
  const PlanStart found{{attempt->times.begin(), attempt->times.end() - 1}, attempt->trial};
  PlanAttempt last = TryByTranscription(run, plan, found, may_continue, intervals);
  if (last.feasible() && last.converged) *attempt = std::move(last);
}

PlanAttempt TryByArcs(PhaseRun* run, const PhasePlan& plan, const PlanStart& start,
                      const ContinuePredicate& may_continue) {
  if (plan.HasTies() || plan.HasRegimes() || !plan.apart.empty())
    return TryByTranscription(run, plan, start, may_continue);
  if (!start.trial.exact.ok || !start.trial.exact.only_impacts) return {};
  const Scene& scene = run->scene();
  PhaseMinimumOptions options;
  options.callback = [&](double loss) { return run->Record(loss); };
  options.iterations = run->iterations_left();
  const ContactSequence sequence = plan.Sequence();
  const PhaseGuess guess = GuessFrom(scene, FlightOf(scene, start.trial), sequence);
  PhaseSolution solution = SolveAlong(scene, sequence, guess, options);
  PlanAttempt& attempt = solution.attempt;
  if (!attempt.valid) return attempt;
  FollowEvents(DiscMotions(scene), plan, solution.intervals, &attempt);
  PolishByTranscription(run, plan, solution.intervals, may_continue, &attempt);
  return attempt;
}

SolveReport SolveByCeresEvent(const SolveRequest& request, const SolverOptions& options) {
  PhaseRun run("ceres_event", request, options);
  if (auto refused = run.SequenceFailure(SequenceFor(options, run.guess()))) return *refused;
  return UpdateByArcs(&run);
}

SolveReport UpdateByArcs(PhaseRun* run) {
  return SolveWithSequenceUpdates(
      run, [run](const PhasePlan& plan, const PlanStart& start, const ContinuePredicate& may_continue) {
        return TryByArcs(run, plan, start, may_continue);
      });
}

}  // namespace saltus
