// Solvers that run only where they are named.
#pragma once

#include <vector>

#include "saltus/solve/solver.h"

namespace saltus {

// Solvers that take long: `all` leaves them out, and AllSolvers() does not list them. FindSolver() and Solve() have
// them.
const std::vector<SolverEntry>& SolversByName();

}  // namespace saltus
