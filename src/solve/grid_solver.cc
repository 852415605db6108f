#include "solve/grid_solver.h"

#include <cmath>
#include <optional>
#include <sstream>

#include "exact/two_disc_optimum.h"
#include "saltus/simulate/registry.h"
#include "solve/phases/phase_solution.h"
#include "solve/solve_run.h"

namespace saltus {
namespace {

std::optional<GridOptimum> FindBest(const Scene& scene, std::string* reason_not_applicable) {
  std::optional<GridOptimum> best;
  for (const TwoDiscSequence sequence : {TwoDiscSequence::kImpactThenPlane, TwoDiscSequence::kImpact}) {
    const std::optional<GridOptimum> found = FindGridOptimum(scene, sequence, reason_not_applicable);
    if (found && (!best || found->loss < best->loss)) best = found;
  }
  return best;
}

std::string Describe(const Units& units, const GridOptimum& optimum) {
  std::ostringstream text;
  text << "impact on node " << optimum.node << " at " << optimum.impact_time * units.time
       << " s; one-sided gradients balance at theta " << optimum.theta << ", to " << optimum.residual;
  return text.str();
}

}  // namespace

std::string UnsupportedByGridOptimum(const SolveRequest& request) {
  if (!IsExact(request)) return "the closed form is that of exact event-driven dynamics";
  if (request.scene.optimize != Optimize::kControl) return "the closed form optimizes a control";
  std::string reason_not_applicable;
  return FindBest(request.scene, &reason_not_applicable) ? "" : reason_not_applicable;
}

SolveReport SolveByGridOptimum(const SolveRequest& request, const SolverOptions& options) {
  SolveRun run("grid_optimum", request, options);
  std::vector<double> z = run.initial_guess();
  double loss = 0;
  if (!run.shooting().Evaluate(z, &loss, nullptr)) {
    return run.Finish(z, Termination::kFailed, "loss not finite at iteration 0");
  }
  if (!run.Record(loss, z)) return run.Finish(z, Termination::kInterrupted);

  const std::optional<GridOptimum> optimum = FindBest(request.scene, nullptr);
  for (size_t k = 0; k < optimum->control.size(); ++k) {
    for (int j = 0; j < 2; ++j) z[2 * k + j] = optimum->control[k][j];
  }
  if (!run.shooting().Evaluate(z, &loss, nullptr) || !(std::abs(loss - optimum->loss) < 1e-9 * (1 + optimum->loss))) {
    return run.Finish(run.initial_guess(), Termination::kFailed, "a rollout contradicts the closed form");
  }
  run.Record(loss, z);
  const bool stationary = optimum->theta >= 0 && optimum->theta <= 1 && optimum->residual < 1e-12;
  return run.Finish(
      z, stationary ? Termination::kConverged : Termination::kNoProgress, Describe(request.scene.units, *optimum));
}

}  // namespace saltus
