// L-BFGS with a Wolfe line search, by ceres::GradientProblemSolver, on the loss and its adjoint gradient.
#pragma once

#include "saltus/solve/solver.h"

namespace saltus {

SolveReport SolveByCeresLbfgs(const SolveRequest& request, const SolverOptions& options);

}  // namespace saltus
