#include "ceres_phases.h"

#include "phase_attempt.h"

namespace saltus {

SolveReport SolveByCeresPhases(const SolveRequest& request, const SolverOptions& options) {
  PhaseRun run("ceres_phases", request, options);
  if (auto refused = run.WhyNotStart()) return *refused;
  return SolveMending(&run, [&](const PhasePlan& plan, const PlanStart& start, const MayGoOn& may_go_on) {
    return TryByTranscription(&run, plan, start, may_go_on);
  });
}

}  // namespace saltus
