// Solvers of hybrid systems keep the number of integration steps that is chosen where they begin, so that the loss is a
// smooth function, and the sizes of states and of the loss by which they judge what is small. Where a solution needs
// more steps, or is so far below the loss of the guess that these sizes hide what is left, the solver goes on from it
// with those that are chosen there.
#pragma once

#include <functional>

#include "saltus/hybrid/hybrid_problem.h"
#include "saltus/solve/solver.h"

namespace saltus {

// One run of a solver from the guess of a problem.
using SolveFrom = std::function<SolveReport(const HybridProblem& problem, const SolverOptions& options)>;

// Runs a solver from the guess of a problem, and from what it finds again until steps and sizes suffice there. Returns
// one report of all runs, whose iterations are together at most those of the options. A run whose steps do not suffice
// in the end has not converged, and its reason states this. A first run that is of no use is not repeated.
SolveReport SolveWithEnoughSteps(
    const HybridProblem& problem, const SolverOptions& options, const SolveFrom& solve,
    const std::function<bool(const SolveReport&)>& is_of_use = [](const SolveReport&) { return true; });

// Whether the loss of a solution is zero beside that where all that the costs read has changed by its size.
bool HasNoLoss(const HybridProblem& problem, const SolveReport& report);

}  // namespace saltus
