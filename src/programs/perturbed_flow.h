// What a displacement before a contact becomes, under a contact model and under exact dynamics.
#pragma once

#include <vector>

#include "output/figure.h"
#include "saltus/audit/attribution.h"

namespace saltus {

// A tangent of the flow over a few steps around a contact: it begins as a displacement of disc a by 1 along the
// contact's normal, and goes on by the linearizations of the steps.
struct PerturbedFlow {
  std::vector<double> times;          // s, nodes of the model's steps
  std::vector<double> first, second;  // displacements of disc a and of disc b along the normal; no second for a plane
};

struct PerturbedFlows {
  PerturbedFlow model, exact;  // from the same state, under the same forces
};

// Of the scene's own initial state and control. Nothing in either if the rollout fails, or the steps of `event` do.
PerturbedFlows PerturbAtContact(const Scene& scene, const Contact& contact, const ContactError& error);

// Both, over time.
Panel PerturbedFlowPanel(const Scene& scene, const Contact& contact, const ContactError& error);

}  // namespace saltus
