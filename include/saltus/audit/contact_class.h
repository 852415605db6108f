// Recognition of the class of a contact model from its first contact at decreasing time steps. The name and the traits
// of the model are not used.
//
// The first contact of two bodies that touch nothing else is simulated again from the state just before it, with steps
// of length h, h / 2^(1/3), h / 2^(2/3), ... under the same force. Measured along the normal of the pair are
//
//   change of a step  = relative velocity after it, less that after free flight
//   concentration     = largest change of a step / sum of all       stays: an impulse;  falls with h: a force
//   first full change = that of the second step in contact          ~ h: a force that jumps at its onset;
//                                                                   ~ h^2 and faster: one that begins continuously
//   rebound           = speed of separation / closing speed         near 0: no restitution, if the scene asks for it
//
// Impulses are classified by their derivative: the model's linearization over the steps around the impulse, without the
// free flight before and after it, is a map (dx, dv) -> (dx', dv') of relative normal position and velocity. The
// saltation matrix of a rigid impact has dx'/dx = -e and a bounded dv'/dx.
//
//   dx'/dx = -e    the time of impact is differentiated
//   dx'/dx = +1    the time of impact is not differentiated: the impulse acts at the boundary of a step
//   dx'/dx =  0    the overlap is projected away, and the position with it
//   dv'/dx ~ 1/h   the impulse corrects the depth, which is a part of the displacement of a step: depth feedback
//
// Measured values are medians over neighbouring step lengths, because they depend on where in a step the contact
// begins.
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
  std::string words;  // the numbers that decided the class, in one sentence; or why they did not

  // The measured numbers; empty if they were not measured.
  int step = -1;                                 // step of the rollout in which the contact begins; -1 if there is none
  std::string a, b;                              // names: a disc, and a disc or wall
  double restitution = 0;                        // that of the scene for this pair
  std::optional<double> rebound, finer_rebound;  // at the model's own step, and at up to 16 times finer ones
  std::optional<double> concentration, finer_concentration;  // at its own step, and at the finest that was run
  std::optional<double> onset_order;                         // p in: first full change ~ h^p
  std::optional<double> position_from_position;              // dx'/dx
  std::optional<double> velocity_from_position;              // limit of h dv'/dx for decreasing h
};

// Recognises the class of a model in a scene, at its first contact. If the model does not support the scene, `words`
// states the reason. A result that was stopped has no meaning.
ContactRecognition RecogniseContact(const Contact& contact, const Scene& scene, const StopRequest& stop = nullptr);

}  // namespace saltus
