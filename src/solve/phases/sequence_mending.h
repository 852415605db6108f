// A local optimum over collision sequences near by, for any solver along one sequence.
//
// A sequence that is not that of an optimum shows: impacts come out of order, a phase shrinks to nothing, the two sides
// of an impact approach each other no more, or the exact roll-out meets something else. Each of these says which
// sequences are next, and each is a warm start (an active set, whose members are impacts):
//
//   impacts out of order, or at the same time   swap them; or hold them at the same time
//   an impact after the final time, or at it    hold it there; or drop it
//   a graze                                     drop it, and keep its pair apart by an inequality
//   an impact between slip and stick            slip; or stick: each by an inequality
//   the roll-out meets something else           the sequence that it has; or keep that pair apart
//
// Besides, wherever a solve leaves its sequence, exact roll-outs on the way from where it began to where it stands look
// for a better real motion, whatever the sequence that it has: solves go on from there, each from a lower loss.
#pragma once

#include "solve/phases/phase_plan.h"
#include "solve/phases/phase_run.h"

namespace saltus {

// From the sequence that the options ask for, or that of the initial guess; a sequence that is given is not left, but
// for that of a motion beside a saddle. Saddles are left. The report is of the best control whose exact roll-out has
// its plan, and says in `reason` which sequences were passed.
SolveReport SolveMending(PhaseRun* run, const TryPlan& try_plan);

}  // namespace saltus
