// Solvers by single shooting: they minimise a ShootingFunction, whose states are eliminated by simulation. The
// functions that take a ShootingRun minimise any such function, those that take a SolveRequest that of a scene.
#pragma once

#include <functional>
#include <vector>

#include "saltus/solve/solver.h"
#include "solve/phases/augmented_lagrangian.h"
#include "solve/solve_run.h"

namespace ceres {
class Problem;
}

namespace saltus {

// The rule of an iteration of gradient descent.
struct DescentRule {
  // The update, within bounds.
  std::function<void(const std::vector<double>& gradient, std::vector<double>* z)> step;
  // Moves an initial guess into its bounds.
  std::function<void(std::vector<double>* z)> move_within;
  // An estimate that replaces the gradient; none: the function's own. Returns false if it is not finite.
  std::function<bool(const std::vector<double>& z, int iteration, std::vector<double>* gradient,
                     std::vector<double>* standard_error)>
      estimate = nullptr;
};

// Gradient descent at a fixed rate, z <- z - learning_rate * gradient, as in Zhong, Han, Brikis, "Differentiable
// Physics Simulations with Contacts: Do They Have Correct Gradients w.r.t. Position, Velocity and Control?" (2022).
// It does options.iterations updates; kConverged if the last one changed nothing. It stops early (kFailed) where the
// loss or the gradient is not finite, at the last iterate where the loss is.
SolveReport DescendGradient(ShootingRun* run, const DescentRule& rule);

// In single precision the update is rounded to float after each operation. A surrogate may take the gradient's place;
// iteration k then takes its normal variates from seed + k. With bounds on forces each update is followed by a
// projection. The rate may be one per unit of time, divided by the length of a step.
SolveReport SolveByGradientDescent(const SolveRequest& request, const SolverOptions& options);

// Minimises by L-BFGS with a Wolfe line search (ceres::GradientProblemSolver), on the loss and its adjoint gradient.
SolveReport MinimizeByLbfgs(ShootingRun* run);
SolveReport SolveByCeresLbfgs(const SolveRequest& request, const SolverOptions& options);

// The variables as Ceres has them.
struct VariableBlocks {
  std::vector<int> sizes;
  std::vector<double*> blocks;
};

// Levenberg-Marquardt, by ceres::Solver, on the residuals of the run's function, from z, plus the terms that
// `add_terms` adds, whose loss is without `offset`. `add_terms` may also set bounds, within which z is. The last
// `num_own` variables have blocks of their own, and no block ends within a row of the control of `width` numbers.
//
// The Gauss-Newton matrix is a multiple of the identity plus one rank per terminal residual. It is never formed: the
// variables come in small blocks, and conjugate gradients need one iteration per distinct eigenvalue, three for one
// terminal term.
SolveReport MinimizeLeastSquares(
    ShootingRun* run, std::vector<double> z, int num_own, double offset,
    const std::function<void(const VariableBlocks& variables, ceres::Problem* problem)>& add_terms, int width = 1);

// Minimises with constraints, by an augmented Lagrangian or an interior-point method (augmented_lagrangian.h) from z.
// The rows of the run's function have these roles. `set_bounds` may bound z, which is within.
SolveReport MinimizeWithConstraints(
    ShootingRun* run, std::vector<double> z, const RowRoles& roles, AugmentedLagrangian::Algorithm algorithm,
    const std::function<void(const VariableBlocks& variables, ceres::Problem* problem)>& set_bounds);

// The residuals are the terminal ones and sqrt(effort dt) u; running terms at Gauss' nodes of each step, via terms and
// the price of a free final time. Bounds on components of forces are Ceres' own. Precondition: the objective is a sum
// of squares.
SolveReport SolveByCeresLm(const SolveRequest& request, const SolverOptions& options);

}  // namespace saltus
