// Derivatives of the exact loss by the design parameters of a scene.
#pragma once

#include <string>
#include <vector>

#include "saltus/scene/scene.h"
#include "saltus/simulate/exact_run.h"

namespace saltus {

struct DesignGradient {
  std::string reason;           // why there is none
  std::vector<double> by;       // Scene::design
  std::vector<double> initial;  // by the initial state; of equal intervals only
  std::vector<Tie> ambiguous;   // of the motion; then there is no gradient
  double costate = 0;           // the largest magnitude of the costates at the end and at the start

  bool ok() const { return reason.empty(); }
};

// The loss as a function of the parameters, under a given control from a given initial state.
//
// On equal intervals these are the adjoint's derivatives. On intervals of any length an impact at the boundary of two
// of them stays there: the boundary moves with it. So are the derivatives of the least loss over controls and lengths,
// as the loss does not change to first order with these (the envelope theorem); they are differences of fourth order of
// exact simulations. Path costs and a free final time are taken there only.
//
// Precondition: the scene is in natural units. Reasons are those of SimulateExactly, path costs on equal intervals,
// contacts that are no impacts, and ties.
DesignGradient GradientByDesign(const Scene& scene, const std::vector<double>& initial,
                                const std::vector<double>& control, const std::vector<double>& durations,
                                const StopRequest& stop = nullptr);

}  // namespace saltus
