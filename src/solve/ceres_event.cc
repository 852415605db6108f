#include "ceres_event.h"

#include "phase_run.h"

namespace saltus {
namespace {

std::pair<Termination, std::string> Judge(const Scene& scene, const PhaseSolution& solution, int most_iterations) {
  if (solution.minimum.interrupted) return {Termination::kInterrupted, ""};
  if (solution.optimal()) return {Termination::kConverged, ""};
  if (!solution.realized) {
    return {Termination::kNoProgress, WhyNotRealized(scene, solution.trial.exact, solution.sequence)};
  }
  if (solution.minimum.iterations >= most_iterations) return {Termination::kIterationLimit, ""};
  return {Termination::kNoProgress, "steps have become too small"};
}

}  // namespace

SolveReport SolveByCeresEvent(const SolveRequest& request, const SolverOptions& options) {
  PhaseRun run("ceres_event", request, options);
  const Scene& scene = run.scene();
  const ContactSequence sequence = SequenceFor(options, run.guess());
  if (auto refused = run.WhyNot(sequence)) return *refused;
  const Flight flight = FlightOf(scene, run.guess());
  PhaseMinimumOptions minimum;
  minimum.iterations = options.iterations;
  minimum.callback = [&](double loss) { return run.Record(loss); };
  const PhaseSolution solution = SolveAlong(scene, sequence, GuessFrom(scene, flight, sequence), minimum);
  if (!solution.valid) {
    return run.Finish(run.guess(),
                      run.guess().exact.loss,
                      Termination::kFailed,
                      "no path along " + ContactSequenceToString(scene, sequence) + " was found to start from");
  }
  run.report().evaluations = solution.minimum.jacobians;
  auto [termination, reason] = Judge(scene, solution, options.iterations);
  return run.Finish(solution.trial, solution.minimum.loss, termination, std::move(reason));
}

}  // namespace saltus
