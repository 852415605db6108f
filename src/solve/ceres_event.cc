#include "ceres_event.h"

#include "phase_run.h"

namespace saltus {
namespace {

std::pair<Termination, std::string> Judge(const Scene& scene, const PhaseSolution& solution, int most_iterations) {
  if (solution.minimum.interrupted) return {Termination::kInterrupted, ""};
  if (solution.optimal()) return {Termination::kConverged, ""};
  if (solution.minimum.iterations >= most_iterations) return {Termination::kIterationLimit, ""};
  if (solution.only_given || solution.minimum.touches || !solution.realized) {
    return {Termination::kNoProgress, WhyNotOptimal(scene, solution)};
  }
  return {Termination::kNoProgress, "steps have become too small"};
}

}  // namespace

SolveReport SolveByCeresEvent(const SolveRequest& request, const SolverOptions& options) {
  PhaseRun run("ceres_event", request, options);
  const Scene& scene = run.scene();
  const ContactSequence sequence = SequenceFor(options, run.guess());
  if (auto refused = run.WhyNot(sequence)) return *refused;
  PhaseMinimumOptions minimum;
  minimum.callback = [&](double loss) { return run.Record(loss); };
  minimum.iterations = options.iterations;
  PhaseSolution solution =
      SolveAlong(scene, sequence, GuessFrom(scene, FlightOf(scene, run.guess()), sequence), minimum);
  if (!solution.valid) {
    return run.Finish(run.guess(),
                      run.guess().exact.loss,
                      Termination::kFailed,
                      "no path along " + ContactSequenceToString(scene, sequence) + " was found to start from");
  }
  int jacobians = solution.minimum.jacobians;
  std::optional<Trial> saddle;
  for (int saddles = 0; saddles < kMostSaddles && solution.optimal(); ++saddles) {
    run.report().certificate = CertifyTrial(scene, solution.trial);
    if (!run.report().certificate->IsSaddle()) break;
    const auto aside = LeaveSaddle(scene, solution.trial, *run.report().certificate->curvature);
    if (aside.empty()) break;
    run.report().certificate.reset();
    saddle = solution.trial;
    solution = SolveFrom(scene, aside, minimum);
    jacobians += solution.minimum.jacobians;
  }
  run.report().evaluations = jacobians;
  auto [termination, reason] = Judge(scene, solution, options.iterations);
  if (saddle) reason = DescribeSaddle(reason);
  return run.Finish(solution.trial, solution.minimum.loss, termination, std::move(reason));
}

}  // namespace saltus
