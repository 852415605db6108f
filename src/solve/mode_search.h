// Finds the collision sequence: solves along one after another, and keeps every optimum that really happens.
//
// It starts with the sequence of the initial guess. Each solve along a sequence (as ceres_event) is re-simulated
// exactly. If impacts have appeared or vanished, what really happened is transcribed anew and solved next. Then the
// neighbours of what really happened are queued: an impact inserted, removed or replaced by one of another pair, each
// started from the motion at hand. The queue is worked off best first, by the exact loss of the motion that a neighbour
// comes from; a sequence is tried from kStarts motions at most.
//
// Bound: nothing is queued with more than kMostImpacts impacts, and the search stops at the first queued loss above
// kBound times the best. Stopping rule: that, or an empty queue, or `iterations` solves.
//
// An optimum that is a saddle is left, both ways, and what is found beside it solved next. If a motion met on the way,
// such as one that only touches, is better than every optimum, it is the result, without having converged: the result
// is never worse than the guess.
//
// With SolverOptions::search off, only the sequence given (or that of the initial guess) is solved.
#pragma once

#include "saltus/solve/solver.h"

namespace saltus {

// Losses are the best exact loss after each solve. Converged: the search has ended by its own rule, and found an
// optimum. Precondition: WhyNotEventPhases is empty.
SolveReport SolveByModeSearch(const SolveRequest& request, const SolverOptions& options);

}  // namespace saltus
