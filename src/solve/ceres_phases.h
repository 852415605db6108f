// Ceres through collisions with a cost for every step (phase_transcription.h), for problems with bounds, constraints,
// running costs and a free final time.
#pragma once

#include "saltus/solve/solver.h"

namespace saltus {

std::string WhyNotPhases(const SolveRequest& request);

// Along the sequence that is given, or that of the initial guess. Where that is not the sequence of an optimum it is
// mended on the way: a phase that vanishes swaps its impacts, leaves the last one at the final time or drops it, and
// what the exact roll-out meets unplanned becomes part of the sequence; each is a warm start. The report is of the best
// control whose exact roll-out has its sequence, and says which sequences it passed.
SolveReport SolveByCeresPhases(const SolveRequest& request, const SolverOptions& options);

}  // namespace saltus
