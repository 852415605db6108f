// The best solution of mode_search, with a rigorous lower bound of the loss over all controls.
#pragma once

#include "saltus/solve/solver.h"

namespace saltus {

// Searches as mode_search, solves along the best sequence again on more control intervals, and bounds the loss of all
// other controls from below (saltus/global/global_bound.h). Converged: the gap is at most GlobalOptions::gap of the
// loss; the verdict of the certificate then is kGlobal. SearchOptions limit the search and the bound, each for itself:
// a box counts as kWorkOfBox. Precondition: UnsupportedByGlobalSearch() is empty.
SolveReport SolveByGlobal(const SolveRequest& request, const SolverOptions& options);

// Returns the part of the request that the solver does not support; empty if it supports all.
std::string UnsupportedByGlobalSearch(const SolveRequest& request);

}  // namespace saltus
