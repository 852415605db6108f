// What a solver takes and reports, between the units of users and the natural ones in which it works.
#pragma once

#include "saltus/solve/solver.h"
#include "scene/units.h"

namespace saltus {

// The options for a solver that works on `scene`, with losses called back in SI units.
SolverOptions OptionsFor(const Scene& scene, const SolverOptions& options);

// The report of a solver that worked on `scene`, in SI units.
SolveReport InSiUnits(const Scene& scene, SolveReport report);

}  // namespace saltus
