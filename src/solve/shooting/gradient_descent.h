// Gradient descent at a fixed rate, z <- z - learning_rate * gradient, as in Zhong, Han, Brikis, "Differentiable
// Physics Simulations with Contacts: Do They Have Correct Gradients w.r.t. Position, Velocity and Control?" (2022).
// In single precision the update is rounded to float after each operation. A surrogate may take the gradient's place;
// iteration k then takes its normals from seed + k. With bounds on forces each update is followed by a projection on
// them. The rate may be one per unit of time, divided by the length of a step.
#pragma once

#include <functional>
#include <vector>

#include "saltus/solve/solver.h"
#include "solve/solve_run.h"

namespace saltus {

// What an iteration does.
struct DescentRule {
  // The update, within bounds.
  std::function<void(const std::vector<double>& gradient, std::vector<double>* z)> step;
  // Moves an initial guess into its bounds.
  std::function<void(std::vector<double>* z)> move_within;
  // What stands in for the gradient; none: the function's own. False if it is not finite.
  std::function<bool(const std::vector<double>& z, int iteration, std::vector<double>* gradient,
                     std::vector<double>* standard_error)>
      estimate = nullptr;
};

// Of any function by shooting.
SolveReport DescendGradient(ShootingRun* run, const DescentRule& rule);

// Always does options.iterations updates; kConverged if the last one changed nothing. Stops early (kFailed) where loss
// or gradient are not finite, at the last iterate where the loss is.
SolveReport SolveByGradientDescent(const SolveRequest& request, const SolverOptions& options);

}  // namespace saltus
