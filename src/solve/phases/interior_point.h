// Interior-point solution of the problems of augmented_lagrangian.h by IPOPT (Waechter, Biegler, "On the implementation
// of an interior-point filter line-search algorithm for large-scale nonlinear programming", 2006):
//
//   minimize sum |f(x)|^2 + sum v(x)   subject to   c(x) = 0,  d(x) <= 0,  l <= x <= u
//
// with the Hessian of the Lagrangian. Each function adds
//
//   2 J_f^T J_f + d/dx (J^T w),   w = (2 f, 1, multipliers of c and d)
//
// in which the derivative of J^T w at constant w is by differences of the function's own Jacobian. Only the
// parameter blocks in which the function is not affine take part in them.
#pragma once

#include <ceres/problem.h>

#include <string>
#include <vector>

#include "solve/phases/augmented_lagrangian.h"

namespace saltus {

// Whether this library was built with IPOPT. The second returns how to get it; empty if it was.
bool HasInteriorPoint();
std::string ReasonNoInteriorPoint();

// Minimizes from where the parameter blocks of `problem` stand, within their bounds in `problem`, and leaves them at
// the last iterate. Blocks that are constant in `problem`, and components that a manifold holds, are constant. Solves
// are serialised, as the linear solver of IPOPT is not safe with several threads. Preconditions: HasInteriorPoint();
// manifolds are ceres::SubsetManifolds.
AugmentedLagrangian::Summary MinimizeByInteriorPoint(const std::vector<ConstrainedFunction>& functions,
                                                     const AugmentedLagrangian::Options& options,
                                                     ceres::Problem* problem);

}  // namespace saltus
