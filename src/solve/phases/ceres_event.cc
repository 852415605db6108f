#include "solve/phases/ceres_event.h"

#include "solve/phases/phase_attempt.h"
#include "solve/phases/sequence_update.h"

namespace saltus {

PlanAttempt TryByArcs(PhaseRun* run, const PhasePlan& plan, const PlanStart& start,
                      const ContinuePredicate& may_continue) {
  if (plan.HasTies() || plan.HasRegimes() || !plan.apart.empty())
    return TryByTranscription(run, plan, start, may_continue);
  PlanAttempt attempt;
  if (!start.trial.exact.ok || !start.trial.exact.only_impacts) return attempt;
  const Scene& scene = run->scene();
  PhaseMinimumOptions options;
  options.callback = [&](double loss) { return run->Record(loss); };
  options.iterations = run->iterations_left();
  const ContactSequence sequence = plan.Sequence();
  PhaseSolution solution =
      SolveAlong(scene, sequence, GuessFrom(scene, FlightOf(scene, start.trial), sequence), options);
  attempt.jacobians = solution.minimum.jacobians;
  attempt.interrupted = solution.minimum.interrupted;
  if (!solution.valid) return attempt;
  attempt.valid = true;
  attempt.times = solution.times;
  attempt.speeds = solution.speeds;
  attempt.converged = solution.minimum.converged;
  attempt.trial = std::move(solution.trial);
  attempt.realized = solution.realized;
  FollowEvents(DiscMotions(scene), plan, solution.intervals, &attempt);
  // Where many impacts leave the variables of arcs ill conditioned, the last digits are the transcription's.
  if (attempt.converged && attempt.realized &&
      run->Certify(attempt.trial).verdict == Certificate::Verdict::kNotStationary) {
    PlanStart found{{attempt.times.begin(), attempt.times.end() - 1}, attempt.trial};
    PlanAttempt last = TryByTranscription(run, plan, found, may_continue);
    if (last.feasible() && last.converged) attempt = std::move(last);
  }
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
