// Exact events with a law of impact, or event functions, that have parameters, for everything that takes a contact
// model.
#pragma once

#include "saltus/contact/event_functions.h"
#include "saltus/contact/impact_law.h"
#include "saltus/simulate/registry.h"

namespace saltus {

// Numbers of parameters whose derivatives one simulator has.
inline constexpr int kLawParametersAtOnce = 3;

// The contact model `neural_event` of a law. Derivatives by restitution, stiffness and damping (P of StepLinearization,
// ParameterGradient) are those by the law's parameters `first`, first + 1 and first + 2, of a scene in SI units.
// Precondition: nothing is wrong with the law.
Contact LearnedContact(const ImpactLaw& law, int first = 0);

// The contact model `learned_events`, likewise. Precondition: nothing is wrong with them, in the scenes that it is used
// on.
Contact LearnedContact(const EventFunctions& events, int first = 0);

}  // namespace saltus
