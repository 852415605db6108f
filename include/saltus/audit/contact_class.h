// How a model makes contact, told from what its first contact does as the step shrinks. The model's name and traits are
// not asked.
//
// From the state just before the first contact of two bodies by themselves in the model's rollout, that contact is run
// again with steps of length h, h / 2^(1/3), h / 2^(2/3), ... under the same force. At every length, along the normal
// of the pair,
//
//   change of a step  = relative velocity after it, less that after free flight
//   concentration     = largest change of a step / sum of all       stays: an impulse;  falls with h: a force
//   first full change = that of the second step in contact          ~ h: a force that jumps at its onset;
//                                                                   ~ h^2 and faster: one that sets in continuously
//   rebound           = speed of separation / closing speed         near 0: no restitution, if the scene asks for it
//
// An impulse is told apart by its derivative: the model's linearization over the steps around it, with the free flight
// before and after undone, is a map (dx, dv) -> (dx', dv') of relative normal position and velocity. The saltation
// matrix of a rigid impact has dx'/dx = -e and a bounded dv'/dx.
//
//   dx'/dx = -e    the time of impact is differentiated
//   dx'/dx = +1    it is not: the impulse is taken to act at the boundary of a step
//   dx'/dx =  0    overlap is projected away, and the position with it
//   dv'/dx ~ 1/h   the impulse makes up for the depth, which is part of what a step moves: depth feedback
//
// Lengths are medians over neighbouring ones, as what happens depends on where in a step the contact falls.
#pragma once

#include <optional>
#include <string>

#include "saltus/scene/scene.h"
#include "saltus/simulate/registry.h"

namespace saltus {

enum class ContactClass {
  kUnclear,
  kImpactTimeResolved,
  kImpulseAtStepBoundary,
  kProjection,
  kDepthFeedback,
  kContinuousForce,
  kForceWithJump,
  kNoRestitution
};
const char* ContactClassToString(ContactClass contact_class);  // "impulse at a step boundary"
// Returns in one sentence how the class affects gradients.
const char* MeaningOf(ContactClass contact_class);

struct ContactRecognition {
  ContactClass contact_class = ContactClass::kUnclear;
  std::string words;  // the numbers that decided, in one sentence; or why they did not

  // Evidence; what was not measured is empty.
  int step = -1;     // of the rollout, in which the contact begins; -1 if there is none
  std::string a, b;  // a disc, and a disc or plane
  double restitution = 0;
  std::optional<double> rebound, finer_rebound;  // at the model's own step, and at up to 16 times finer ones
  std::optional<double> concentration, finer_concentration;  // at its own step, and at the finest that was run
  std::optional<double> onset_order;                         // p of: first full change ~ h^p
  std::optional<double> position_from_position;              // dx'/dx
  std::optional<double> velocity_from_position;              // h dv'/dx, as h falls
};

// Where the model cannot take the scene, `words` says why. What was stopped is of no use.
ContactRecognition RecogniseContact(const Contact& contact, const Scene& scene, const StopRequest& stop = nullptr);

}  // namespace saltus
