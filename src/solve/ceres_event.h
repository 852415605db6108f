// Event phases by Ceres: the best piecewise constant control along a given collision sequence, on intervals that begin
// and end with the impacts.
//
// The transcription (control/event_phases.h) leaves impact times, impact points and the pushed discs' velocities before
// their impacts: for task 3 four variables, whatever the number of intervals. Levenberg-Marquardt with one dense block
// takes 14 iterations of 3 us there, to the last digit. What was tried before: all controls and durations as variables
// and gaps as penalties took 20 to 80 iterations to 1e-3 to 1e-6; with one multiplier and free flight eliminated, but
// controls kept, 16 iterations, of 240 ms each with a dense Jacobian of all controls.
#pragma once

#include "saltus/solve/solver.h"

namespace saltus {

// Converged means: the gradient has vanished, gaps are closed, and in exact dynamics the control has the impacts of the
// sequence and no others. Precondition: WhyNotEventPhases is empty.
SolveReport SolveByCeresEvent(const SolveRequest& request, const SolverOptions& options);

}  // namespace saltus
