// Gradient descent at a fixed rate, z <- z - learning_rate * gradient, as in Zhong, Han, Brikis, "Differentiable
// Physics Simulations with Contacts: Do They Have Correct Gradients w.r.t. Position, Velocity and Control?" (2022).
// In single precision the update is rounded to float after each operation. A surrogate may take the gradient's place;
// iteration k then takes its normals from seed + k. With bounds on forces each update is followed by a projection on
// them. The rate may be one per unit of time, divided by the length of a step.
#pragma once

#include "saltus/solve/solver.h"

namespace saltus {

// Always does options.iterations updates; kConverged if the last one changed nothing. Stops early (kFailed) where loss
// or gradient are not finite, at the last iterate where the loss is.
SolveReport SolveByGradientDescent(const SolveRequest& request, const SolverOptions& options);

}  // namespace saltus
