// Solvers of hybrid systems keep the number of integration steps that is chosen where they begin, so that the loss is a
// smooth function. Where a solution needs more steps, the solver goes on from it with the number that is chosen there.
#pragma once

#include <functional>

#include "saltus/hybrid/hybrid_problem.h"
#include "saltus/solve/solver.h"

namespace saltus {

// One run of a solver from the guess of a problem.
using SolveFrom = std::function<SolveReport(const HybridProblem& problem, const SolverOptions& options)>;

// Runs a solver from the guess of a problem, and from what it finds again until the steps suffice there. Returns one
// report of all runs, whose iterations are together at most those of the options. A run whose steps do not suffice in
// the end has not converged, and its reason states this.
SolveReport SolveWithEnoughSteps(const HybridProblem& problem, const SolverOptions& options, const SolveFrom& solve);

}  // namespace saltus
