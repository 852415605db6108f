// Event phases by Ceres: the best piecewise constant control along a collision sequence, on intervals that begin
// and end with the impacts.
//
// The transcription (control/event_phases.h) leaves impact times, impact points and the pushed discs' velocities before
// their impacts: for task 3 four variables, whatever the number of intervals. Levenberg-Marquardt with one dense block
// takes 14 iterations of a few microseconds there, to the last digit, and 41 for the single collision.
//
// What else was tried, and what it cost. All controls and durations as variables, gaps as penalties: 20 to 80
// iterations to 1e-3 to 1e-6. Controls as variables, free flight and the multiplier eliminated: 16 iterations, but
// 240 ms each with one dense Jacobian of all controls. Here, with an augmented Lagrangian alone for gaps that no pushed
// disc closes: 64 iterations for two impacts, and 200 without an end for three. So Newton's method on the costate
// conditions (hmp.h) takes the last steps where there are such gaps, or steps have become small; about 10
// iterations.
#pragma once

#include "saltus/solve/solver.h"
#include "solve/phases/phase_run.h"

namespace saltus {

// An active-set update changes the sequence (sequence_update.h). Converged means: the gradient has vanished, gaps are
// closed, and in exact dynamics the control has the impacts of the sequence and no others. Precondition:
// UnsupportedByEventPhases is empty.
SolveReport SolveByCeresEvent(const SolveRequest& request, const SolverOptions& options);

// One solve along a plan by closed arcs, which support impacts at different times and no inequalities; the
// transcription takes the others. Precondition: as above, of the scene of `run`.
PlanAttempt TryByArcs(PhaseRun* run, const PhasePlan& plan, const PlanStart& start,
                      const ContinuePredicate& may_continue);

// Takes the last steps to an optimum that a certificate refutes by the transcription, with as many intervals in each
// phase: many impacts leave the variables of arcs ill conditioned.
void PolishByTranscription(PhaseRun* run, const PhasePlan& plan, const std::vector<int>& intervals,
                           const ContinuePredicate& may_continue, PlanAttempt* attempt);

// All of it from the motion of `run`.
SolveReport UpdateByArcs(PhaseRun* run);

}  // namespace saltus
