// The conditions of the hybrid minimum principle, each read off a control and its exact motion (saltus/control/
// certificate.h says what they are); one file for forces that are free, and one for the general problem.
#pragma once

#include <optional>
#include <span>
#include <vector>

#include "optimality/condensed.h"
#include "saltus/optimality/certificate.h"
#include "simulate/flight.h"

namespace saltus {

// A control on intervals of `lengths`, in natural units, and its motion.
struct ControlledMotion {
  const Scene& scene;  // its duration is that of the motion
  const std::vector<double>& control;
  const std::vector<double>& lengths;  // of the control intervals, s
  const Flight& flight;
  const ExactRun& exact;
};

// A certificate with what is known of the impacts themselves.
Certificate WithImpactsOf(const ControlledMotion& motion);

// Costates are read off the forces. Precondition: BeyondTerminalCost() is empty, effort > 0.
Certificate FreeConditions(const ControlledMotion& motion);

// Costates are carried backwards through the motion; multipliers are those that fit best.
Certificate ConstrainedConditions(const ControlledMotion& motion);
// Why the latter do not apply; empty if they do.
std::string WhyNotConstrainedConditions(const Scene& scene, const Flight& flight);

// Nothing if it would take long.
std::optional<Curvature> FindCurvature(const CondensedLoss& loss);

}  // namespace saltus
