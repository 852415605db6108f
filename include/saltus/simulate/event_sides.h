// Derivatives by the initial state that exist from one side only, because of what touches at the start.
//
// The exact motion of discs that touch at the start depends on a small change of the initial state as follows.
//
// Positions. Discs cannot overlap, so a coordinate that opens a contact has a derivative from that side, and one that
//   opens one contact and closes another has none. Nor has one that opens a contact which does not come to rest again
//   (restitution 1), or in which several contacts with friction must be closed again of which some stick against a
//   force along them: which of them meets first then decides where they stick. A disc that slides past another, which
//   it touches without pressing, has one from the side on which it has passed.
// Velocities. A contact that presses has a derivative from both sides: the small impacts that follow add up to the same
//   impulse, whatever the restitution below 1. With restitution 1 they go on for ever: positions have a derivative,
//   velocities have none. A pair that touches without pressing has that of the side on which the two part. A contact
//   that is about to slide from rest has that of the side to which it slides.
// Neither do changes along a contact that presses have a derivative if its force reaches one that touches only, through
//   the discs that they share: what bounces on the former strikes the latter.
//
// The derivatives that the event-driven model gives are those of that side (event_group.h).
#pragma once

#include <vector>

#include "saltus/scene/scene.h"

namespace saltus {

struct OneSided {
  enum class Quantity { kPosition, kVelocity };
  enum class Side { kAbove, kBelow, kNone };  // on which the derivative exists: for a larger value, a smaller one

  int body = 0;
  Quantity quantity = Quantity::kPosition;
  int component = 0;  // 0 is x, 1 is y
  Side side = Side::kAbove;

  bool operator==(const OneSided&) const = default;
};
// Returns the name that JSON uses: "position" or "velocity"; "+", "-" or "none".
const char* QuantityToString(OneSided::Quantity quantity);
const char* SideToString(OneSided::Side side);

// Returns the one-sided derivatives by the scene's initial state, under the first of its forces; by bodies, positions
// first. With restitution 1 it depends on whether the loss has a velocity in it. Precondition: the scene is valid.
std::vector<OneSided> OneSidedDerivatives(const Scene& scene);

}  // namespace saltus
