// One-sided derivatives of the exact (event-driven) motion by the initial state. Contacts at the start cause them.
//
// Positions. Discs cannot overlap. A coordinate that opens a contact has a derivative from that side only, and one that
//   opens a contact and closes another has none. There is none either if the contact does not come to rest again
//   (restitution 1), or if several contacts with friction close again of which some stick against a tangential force:
//   the one that closes first then decides where they stick. A disc that slides past another disc, with a normal force
//   of zero, has a derivative from the side on which it has passed.
// Velocities. An active contact has derivatives from both sides: with a restitution below 1, the small impacts that
//   follow have the same total impulse. With restitution 1 they do not end: positions have a derivative, velocities
//   have none. A contact with a normal force of zero has the derivative of the side on which it separates. A contact
//   that begins to slide from rest has that of the side to which it slides.
// Both. Changes along the normal of an active contact have no derivative if the force of this contact is passed, by
//   discs that they share, to a contact with a normal force of zero: small impacts of the first contact then cause
//   impacts of the second.
//
// The event-driven model computes the derivative of the side that exists (event_group.h).
#pragma once

#include <vector>

#include "saltus/scene/scene.h"

namespace saltus {

// An entry of the derivative by the initial state that exists from one side only, or from none.
struct OneSided {
  enum class Quantity { kPosition, kVelocity };
  // The side on which the derivative exists: for larger values of the entry, for smaller ones, or for neither.
  enum class Side { kAbove, kBelow, kNone };

  int body = 0;  // index into Scene::bodies
  Quantity quantity = Quantity::kPosition;
  int component = 0;  // 0 is x, 1 is y
  Side side = Side::kAbove;

  bool operator==(const OneSided&) const = default;
};
// Returns the name that JSON uses: "position" or "velocity"; "+", "-" or "none".
const char* QuantityToString(OneSided::Quantity quantity);
const char* SideToString(OneSided::Side side);

// Returns the one-sided derivatives by the scene's initial positions and velocities, under Control::initial, ordered by
// body, then position before velocity, then x before y. With restitution 1 they depend on whether the loss contains a
// velocity. Precondition: the scene is valid.
std::vector<OneSided> OneSidedDerivatives(const Scene& scene);

}  // namespace saltus
