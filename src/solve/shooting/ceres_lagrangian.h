// Step shooting by an augmented Lagrangian (augmented_lagrangian.h), which demonstrates that this fails: terminal terms
// and effort are minimized over states and forces, subject to
//
//   c_k = x_{k+1} - f(x_k, u_k) = 0,
//
// of weight 1 / dt at first: defects per time, in the mean over time.
//
// Without contact this converges. Through a collision it should not be trusted: with its defects open a trajectory need
// not collide as the forces would have it. The Jacobian of a defect knows nothing of a collision in the step before or
// after, so that a defect which carries a disc past a collision, or hits it without one, is never corrected through the
// forces. Runs end at false minima, or with defects open. Losses in the report are therefore those of rollouts of the
// forces, at every iterate.
#pragma once

#include "saltus/solve/solver.h"

namespace saltus {

// kConverged means: every defect is below 1e-9, and the gradient of the rollout's loss has vanished. Precondition: the
// objective is a sum of squares.
SolveReport SolveByCeresLagrangian(const SolveRequest& request, const SolverOptions& options);

}  // namespace saltus
