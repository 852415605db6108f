// Ceres through collisions with a cost for every step (hybrid_transcription.h), for problems with bounds, constraints,
// running costs and a free final time.
#pragma once

#include "saltus/solve/solver.h"
#include "solve/phases/phase_run.h"

namespace saltus {

// Solves along the sequence that is given, or that of the initial guess, which is updated (sequence_update.h).
// A problem with goal regions that the guess misses is solved with a target in each first. Converged means: an optimum
// along its sequence, to rounding, and the exact roll-out has that sequence and violates no constraint. Under another
// contact model than event, a second solve goes on from there, with impacts that stay exact and steps as the model
// flies them: its loss is the one reported. Precondition: UnsupportedByCeresPhases() is empty.
SolveReport SolveByCeresPhases(
    const SolveRequest& request, const SolverOptions& options,
    AugmentedLagrangian::Algorithm algorithm = AugmentedLagrangian::Algorithm::kLeastSquares);

// The solver `ipopt`: minimizes along sequences by the interior-point method (interior_point.h), once from the initial
// guess. Precondition: UnsupportedByInteriorPoint() is empty.
SolveReport SolveByInteriorPoint(const SolveRequest& request, const SolverOptions& options);
std::string UnsupportedByInteriorPoint(const SolveRequest& request);

// Solves the request of `run` under exact contact, from the motion of the run.
SolveReport UpdateBySteps(PhaseRun* run, const SolveRequest& request);

// Whether a terminal term of a scene has a region.
bool HasGoalRegion(const Scene& scene);
// Returns the scene with a hard target in the place of each region: in each component the middle of its bounds, or the
// nearest value to where the disc starts.
Scene ReplaceRegionsByTargets(Scene scene);

// Returns the reason why the solver does not support a request; empty if it does.
std::string UnsupportedByCeresPhases(const SolveRequest& request);

}  // namespace saltus
