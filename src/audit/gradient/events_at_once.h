// Derivatives of the exact loss that exist from one side only because events happen at the same time, or because
// two discs pass each other with a gap of zero.
//
// Where a disc meets two others at once, a change of the initial state makes it meet one of them first. If the motion
// is the same in both orders, the loss is continuous there, but its slopes to either side may differ: the gradient of
// the event-driven model is that of one order. Which entries that concerns follows from differences of its own loss:
// an entry that agrees with those of one side alone, while those of the other side settle on another slope, is the
// derivative from that side; one that agrees with neither, while both settle, is none. Likewise where discs pass each
// other without a gap: moved to one side they meet.
#pragma once

#include <vector>

#include "saltus/scene/scene.h"
#include "saltus/simulate/event_sides.h"
#include "saltus/simulate/registry.h"

namespace saltus {

// Returns the one-sided derivatives by the initial state that are not among `known`. Empty where no impact coincides
// with another event of one of its discs and no discs pass each other without a gap, and where rollouts are so long
// that differences by every entry would take minutes. The result has no meaning if it was stopped. `contact` is
// event-driven and can simulate the scene, which is in natural units.
std::vector<OneSided> OneSidedAtOnce(const Contact& contact, const Scene& scene, const std::vector<OneSided>& known,
                                     const StopRequest& stop = nullptr);

}  // namespace saltus
