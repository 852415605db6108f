// The indirect method: a zero of the conditions of the hybrid minimum principle (optimality/costate.h), in continuous
// time and to rounding.
//
// Unknowns are the variables of EventPhases and one multiplier an impact: five for one impact of a pushed disc.
// Newton's method needs a start near by, which Levenberg-Marquardt on the same variables gives; both by Ceres. The
// control reported is the best one on Scene::steps intervals with the very same impacts, so its loss is a little
// higher. Bounds, hard terms, running costs and a free final time: hmp_constrained.h.
#pragma once

#include "saltus/solve/solver.h"

namespace saltus {

std::string WhyNotHmp(const SolveRequest& request);

// The certificate holds the conditions in continuous time. Precondition: WhyNotHmp is empty.
SolveReport SolveByHmp(const SolveRequest& request, const SolverOptions& options);

}  // namespace saltus
