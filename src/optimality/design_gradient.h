// Derivatives of the exact loss by the design parameters of a scene.
#pragma once

#include <string>
#include <vector>

#include "saltus/optimality/certificate.h"
#include "saltus/scene/scene.h"
#include "saltus/simulate/events.h"

namespace saltus {

struct DesignGradient {
  std::string reason;           // why there is none
  std::vector<double> by;       // Scene::design
  std::vector<double> initial;  // by the initial state; of equal intervals only
  std::vector<Tie> ambiguous;   // of the motion; then there is no gradient
  double costate = 1;           // the largest magnitude of the costates at the end and at the start; at least 1

  bool ok() const { return reason.empty(); }
};

// Computes the derivatives of the loss by the parameters, under a given control from a given initial state.
//
// On equal intervals these are the adjoint's derivatives. On intervals of any length an impact at the boundary of two
// of them stays there: the boundary moves with it. So are the derivatives of the least loss over controls and lengths,
// as the loss does not change to first order with these (the envelope theorem); they are differences of fourth order of
// exact simulations. With path costs, a free final time or equality constraints they are such differences on equal
// intervals too. With constraints they are those of the Lagrangian: `constraints` are their multipliers, in the order
// of Certificate::constraints.
//
// Precondition: the scene is in natural units. Reasons are those of SimulateExactly, contacts that are no impacts,
// ties, and constraints without multipliers.
DesignGradient GradientByDesign(const Scene& scene, const std::vector<double>& initial,
                                const std::vector<double>& control, const std::vector<double>& durations,
                                const std::vector<ConstraintCertificate>& constraints = {},
                                const StopRequest& stop = nullptr);

// Adds the conditions of stationarity by parameters to a certificate: `by` are the derivatives of the loss, and their
// residuals are relative to `costate`. A stationary verdict falls if one is not met.
void JudgeParameters(const Scene& scene, const std::vector<double>& by, double costate, Certificate* certificate);

}  // namespace saltus
