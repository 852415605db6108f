// Step shooting by an augmented Lagrangian: ceres::Solver minimizes terminal terms and effort plus
//
//   sum_k mu |c_k + y_k / mu|^2,   c_k = x_{k+1} - f(x_k, u_k),
//
// over states and forces, at first with mu = 1 / dt (defects per time, in the mean over time); between such rounds the
// multipliers y_k grow by mu c_k, and mu by kGrowth where defects did not shrink enough (Hestenes, Powell 1969;
// Nocedal, Wright, "Numerical Optimization", 17.3).
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
