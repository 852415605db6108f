// Levenberg-Marquardt, by ceres::Solver, with the states eliminated: the residuals are the terminal ones and
// sqrt(effort dt) u, as functions of the decision variables.
//
// The Gauss-Newton matrix is a multiple of the identity plus one rank a terminal residual. It is never formed: the
// variables come in small blocks, and conjugate gradients need one iteration per distinct eigenvalue, three for one
// terminal term.
// Running terms are residuals at Gauss' nodes of each step, via terms and a final time as they are; bounds on
// components of forces are Ceres' own.
#pragma once

#include <functional>
#include <vector>

#include "saltus/solve/solver.h"
#include "solve/solve_run.h"

namespace ceres {
class Problem;
}

namespace saltus {

// The variables as Ceres has them.
struct VariableBlocks {
  std::vector<int> sizes;
  std::vector<double*> blocks;
};

// Minimises the residuals of the run's function from z, plus the terms that `add_terms` adds, whose loss is without
// `offset`. It may also set bounds, within which z is. The last `num_times` variables have blocks of their own.
SolveReport MinimizeLeastSquares(
    ShootingRun* run, std::vector<double> z, int num_times, double offset,
    const std::function<void(const VariableBlocks& variables, ceres::Problem* problem)>& add_terms);

// Precondition: the objective is a sum of squares.
SolveReport SolveByCeresLm(const SolveRequest& request, const SolverOptions& options);

}  // namespace saltus
