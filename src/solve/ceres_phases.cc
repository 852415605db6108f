#include "ceres_phases.h"

#include "phase_attempt.h"
#include "saltus/dynamics/registry.h"
#include "solve_run.h"

namespace saltus {

std::string WhyNotPhases(const SolveRequest& request) {
  const Scene& scene = request.scene;
  const ModelTraits* model = FindContactModel(request.contact);
  if (model != nullptr && !model->event_driven) return "it solves with exact impacts only (contact model event)";
  if (const std::string reason = WhyNothingToOptimize(scene); !reason.empty()) return reason;
  if (scene.optimize != Optimize::kControl) return "it finds a control, and the scene optimizes something else";
  if (!scene.objective.IsSumOfSquares()) return "least squares needs a sum of squares";
  return "";
}

SolveReport SolveByCeresPhases(const SolveRequest& request, const SolverOptions& options) {
  PhaseRun run("ceres_phases", request, options);
  if (auto refused = run.WhyNotStart()) return *refused;
  return SolveMending(&run, [&](const PhasePlan& plan, const PlanStart& start, const MayGoOn& may_go_on) {
    return TryByTranscription(&run, plan, start, may_go_on);
  });
}

}  // namespace saltus
