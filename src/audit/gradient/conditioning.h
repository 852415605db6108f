// How much of a gradient rounding leaves.
//
// Where discs meet again and again, each impact magnifies what was there before: after a few dozen of them the last
// bits of the initial state, and the rounding of every step since, may decide the leading digits of the derivative. A
// gradient that differs from the exact one by no more than the exact one differs from itself is not wrong: nobody can
// tell.
#pragma once

#include <optional>

#include "saltus/audit/refinement.h"

namespace saltus {

// Of the event-driven model; nothing where that one cannot take the scene or fails, or if it was stopped.
std::optional<Conditioning> MeasureConditioning(const Scene& scene, const StopRequest& stop = nullptr);

}  // namespace saltus
