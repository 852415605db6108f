// L-BFGS with a Wolfe line search, by ceres::GradientProblemSolver, on the loss and its adjoint gradient.
#pragma once

#include "saltus/solve/solver.h"
#include "solve/solve_run.h"

namespace saltus {

// Of any function by shooting.
SolveReport MinimizeByLbfgs(ShootingRun* run);

SolveReport SolveByCeresLbfgs(const SolveRequest& request, const SolverOptions& options);

}  // namespace saltus
