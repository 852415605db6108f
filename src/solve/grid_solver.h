// The optimum of one disc that strikes another, on the scene's time grid, in closed form except for two numbers: see
// exact/two_disc_optimum.h. Other solvers stall at any of the nodes around it, each of which is a local minimum.
#pragma once

#include <string>

#include "saltus/solve/solver.h"

namespace saltus {

// The best of the collision sequences that the closed form supports (the discs once, then perhaps the second disc on a
// plane). kConverged means stationary in the sense of Clarke: the two one-sided gradients balance.
SolveReport SolveByGridOptimum(const SolveRequest& request, const SolverOptions& options);

// Returns the reason why the closed form does not support a request; empty if it does.
std::string UnsupportedByGridOptimum(const SolveRequest& request);

}  // namespace saltus
