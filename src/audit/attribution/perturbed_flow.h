// Displacements before a contact, and what becomes of them under a contact model and in exact dynamics.
#pragma once

#include <vector>

#include "saltus/audit/attribution.h"
#include "saltus/scene/scene.h"
#include "saltus/simulate/registry.h"

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

// Perturbs the scene's initial state under its control. Both flows are empty if the rollout, or that of `event`, fails.
PerturbedFlows PerturbAtContact(const Scene& scene, const Contact& contact, const ContactError& error,
                                const StopRequest& stop = nullptr);

}  // namespace saltus
