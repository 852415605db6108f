// Step shooting along a feasible path, by ceres::Solver with sparse linear algebra: Levenberg-Marquardt with states and
// forces as variables, whose costs are evaluated not where Ceres believes the states to be, but where a rollout of the
// forces brings them.
//
// All defects c_k = x_{k+1} - f(x_k, u_k) are then zero at every iterate, and what a step promises is compared with
// what its rollout keeps. A step minimizes the linearized terminal and effort terms plus those of the Lagrangian,
//
//   sum_k |w c_k + y_k / w|^2,   y_{K-1} = -r_x^T r(x_K),   y_{k-1} = (df_k/dx)^T y_k,
//
// with the costates y of the path, so that it vanishes exactly where the gradient of the loss does, and the gradient
// that Ceres computes is that of the loss by the forces. Iterates are those of Gauss-Newton in the forces alone, to
// about 1 / w^2; what differs from ceres_lm is the linear algebra, whose cost grows with the steps and not with the
// terminal residuals, and the damping, which is of states and forces alike.
#pragma once

#include "saltus/solve/solver.h"

namespace saltus {

// Precondition: the objective is a sum of squares.
SolveReport SolveByCeresShooting(const SolveRequest& request, const SolverOptions& options);

}  // namespace saltus
