// Finds the collision sequence: solves along one after another, and keeps every optimum that really happens.
//
// It starts from the initial guess, whatever that does, and from SearchOptions::starts motions of its own
// (search_starts.h). ceres_lm goes down from all of them and gd from the guess; where they end, solves along the
// sequence found there (as ceres_event) go on. Each solve is re-simulated exactly. If impacts have appeared or
// vanished, what really happened is transcribed anew and solved next. Then the neighbours of what really happened are
// queued: an impact inserted, removed or replaced by one of another pair, each started from the motion at hand. The
// queue is worked off best first, by the exact loss of the motion that a neighbour comes from. A saddle is left, both
// ways, and what is found beside it solved next. Where a motion that is no optimum is the best, its sequence is mended
// (sequence_update.h): it may be an optimum with a kink, which just touches or strikes at the final time. Where
// nothing better is found any more, up to kMostRounds times, or where nothing is left to be tried and some pair does
// not meet in the best motion, up to kRoundsAtEnd times (with fewer control intervals): others near the best are
// mended, and ceres_lm goes down from more motions, at random and around the best. At last intervals of the best move
// to other phases.
//
// Rule, by which a search is complete: the queue is empty, or nothing is left in it that comes from a motion below
// kBound times the best loss. A sequence is tried from kStarts motions at most, and not at all if a lower bound of the
// loss along it (loss_bound.h) is above that.
// Limits, which leave a search incomplete: `iterations` solves, kPatience of them without anything better (after the
// rounds above), SearchOptions, an interrupt, neighbours left out of very many (search_solve.h) and those of motions
// with kMoreImpacts more impacts than the best one. Motions with more than kMostImpactsOfMotion impacts are cut, and
// not gone on from.
//
// Solves are drawn and looked at in one order, whatever the threads that work them off (task_queue.h), so that the
// answer is the same for any number of these, and on a busy machine too. SearchOptions::work counts what solves have
// computed when they are looked at, and a solve may use what was left of it when it was drawn. Only with a limit of
// time, SearchOptions::seconds, the answer depends on the machine.
//
// With SolverOptions::Sequences::search off, only the sequence given (or that of the initial guess) is solved.
#pragma once

#include "saltus/solve/solver.h"

namespace saltus {

// Losses are the best exact loss after each solve. Never worse than the guess, ceres_lm or gd from it, up to 1e-6 of
// the loss. Converged: the best motion is an optimum. Problems that arcs do not support are searched by ceres_phases,
// in a simpler way (phase_search.h). Precondition: UnsupportedByModeSearch() is empty.
SolveReport SolveByModeSearch(const SolveRequest& request, const SolverOptions& options);

// Returns the reason why the solver does not support a request; empty if it does.
std::string UnsupportedByModeSearch(const SolveRequest& request);

}  // namespace saltus
