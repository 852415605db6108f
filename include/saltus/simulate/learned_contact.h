// Contact models with exact events whose law of impact, or whose event functions, have parameters.
#pragma once

#include "saltus/contact/event_functions.h"
#include "saltus/contact/impact_law.h"
#include "saltus/simulate/registry.h"

namespace saltus {

// The number of parameters by which one simulator computes derivatives: a law with more needs several simulators.
inline constexpr int kLawParametersAtOnce = 3;

// Makes the contact model `neural_event` of a law. Derivatives by restitution, stiffness and damping (P of
// StepLinearization, ParameterGradient) are those by the law's parameters `first`, first + 1 and first + 2 (0 beyond
// the last), in SI units. Preconditions: Validate(law) is empty, first >= 0.
Contact LearnedContact(const ImpactLaw& law, int first = 0);

// Makes the contact model `learned_events` of event functions, with derivatives by three of their parameters in the
// places of restitution, stiffness and damping, as above. Precondition: Validate(events, scene) is empty for the
// scenes that it is used on.
Contact LearnedContact(const EventFunctions& events, int first = 0);

}  // namespace saltus
