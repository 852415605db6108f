// Solvers that run only if they are named.
#pragma once

#include <vector>

#include "saltus/solve/solver.h"

namespace saltus {

// Returns the solvers that take long. `all` and AllSolvers() leave them out; FindSolver() and Solve() have them.
const std::vector<SolverEntry>& SolversByName();

}  // namespace saltus
