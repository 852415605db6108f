// Finds the sequence of impacts of a scene, by a search over sequences (sequence_search.h).
//
// Where closed arcs take the problem, solves are those of ceres_event, the lower bounds those of loss_bound.h, and
// descents of ceres_lm and gd from the guess are solved from, too. Bounds, hard terms, running and via costs, a free
// final time and initial states that are to be found are for solves of ceres_phases; starts are then the best motion of
// the problem without all that, by the first way, and the sequences of its other optima, too. Motions at random
// (search_starts.h) are brought near the targets by ceres_lm without bounds and constraints.
//
// With SolverOptions::Sequences::search off, only the sequence given (or that of the initial guess) is solved.
#pragma once

#include "saltus/solve/solver.h"

namespace saltus {

// Losses are the best exact loss after each solve. Converged: the best motion that meets all constraints is an optimum.
// Never worse than the guess or, unless a limit cuts that solve short, than ceres_phases from it; where closed arcs
// take the problem, than ceres_lm or gd from it, up to 1e-6 of the loss. Precondition: UnsupportedByModeSearch() is
// empty.
SolveReport SolveByModeSearch(const SolveRequest& request, const SolverOptions& options);

// Returns the reason why the solver does not support a request; empty if it does.
std::string UnsupportedByModeSearch(const SolveRequest& request);

// ceres_phases. Where the control is bounded, it solves again from the best of a few random motions, after some
// iterations of shooting: those whose loss is near that of the first solution, and whose sequence is another. The
// report is that of the best solve, constraints first, with `initial_loss` of the initial guess and `seconds` of all
// solves; `iterations` limits all solves together. It solves once if a guess or a sequence is given, or without
// SolverOptions::Sequences::search. Precondition: UnsupportedByCeresPhases() is empty.
SolveReport SolveByPhasesFromStarts(const SolveRequest& request, const SolverOptions& options);

}  // namespace saltus
