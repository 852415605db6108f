// A search over collision sequences for what closed arcs do not take: bounds, hard terms, running and via costs, a free
// final time, initial states that are to be found.
//
// Every solve is one of ceres_phases, which mends its sequence. They begin from
//
//   the initial guess
//   the best motion of the problem without all that, by mode_search, and the sequences of its other optima
//   motions of its own (search_starts.h), brought near the targets by ceres_lm without bounds and constraints
//
// and go on along the neighbours of the best optimum (search_solve.h), each from that optimum, until none is better.
//
// Rule, by which a search is complete: the neighbours of the best optimum, and of those before it, are all tried.
// Limits, which leave it incomplete: `iterations` solves, SearchOptions, an interrupt, neighbours left out of very
// many. As in mode_search, solves are looked at in one order, whatever the threads (task_queue.h).
#pragma once

#include "saltus/solve/solver.h"

namespace saltus {

// Losses are the best exact loss after each solve. Converged: the best motion that meets all constraints is an optimum;
// never worse than ceres_phases from the initial guess, unless a limit cuts that solve short. Precondition:
// UnsupportedByCeresPhases() is empty, exact contact.
SolveReport SearchByPhases(const SolveRequest& request, const SolverOptions& options);

// ceres_phases. Where the control is bounded, it solves again from the best of a few random motions, after some
// iterations of shooting: those whose loss is near that of the first solution, and whose sequence is another. The
// report is that of the best solve, constraints first, with `initial_loss` of the initial guess and `seconds` of all
// solves; `iterations` limits all solves together. It solves once if a guess or a sequence is given, or without
// SolverOptions::Sequences::search. Precondition: UnsupportedByCeresPhases() is empty.
SolveReport SolveByPhasesFromStarts(const SolveRequest& request, const SolverOptions& options);

}  // namespace saltus
