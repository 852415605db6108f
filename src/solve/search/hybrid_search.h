// mode_search for problems of hybrid systems: a search over sequences of events (sequence_search.h).
//
// Random starts have controls linear in time, of a size that moves the state by its own size within the duration, and
// free initial states and parameters between their bounds. They are brought down by ceres_lm, with equalities as costs
// and without inequalities.
//
// Neighbours of a sequence have one event inserted, removed or replaced, or two that follow each other inserted or
// removed, where modes need both; those whose events cannot follow one another are left out.
#pragma once

#include "saltus/hybrid/hybrid_problem.h"
#include "saltus/solve/solver.h"

namespace saltus {

// In SolveReport::optima an event stands in a sequence as {mode, guard}. Never worse than ceres_phases from the initial
// guess, unless a limit cuts that solve short. Precondition: UnsupportedByHybridPhases() is empty.
SolveReport SolveHybridByModeSearch(const HybridProblem& problem, const SolverOptions& options);

}  // namespace saltus
