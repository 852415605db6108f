// The conditions of the hybrid minimum principle (saltus/optimality/certificate.h), evaluated at a control and its
// exact motion: for free forces in free_conditions.cc, for the general problem in constrained_conditions.cc.
#pragma once

#include <optional>
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

// Returns the durations of the control intervals, s; if `durations` is empty, equal parts of the scene's.
std::vector<double> IntervalLengths(const Scene& scene, const std::vector<double>& control,
                                    const std::vector<double>& durations);

// Returns a certificate with times, names and speeds of the impacts, without residuals.
Certificate WithImpactsOf(const ControlledMotion& motion);

// Conditions if costates follow from the forces. Preconditions: BeyondTerminalCost() is empty, effort > 0.
Certificate FreeConditions(const ControlledMotion& motion);

// Conditions with bounds on the forces, hard terms, running and via terms, torques and a free final time. Costates are
// carried backwards through the motion, and the multipliers minimise the residuals.
Certificate ConstrainedConditions(const ControlledMotion& motion);
// The time at which two discs, or a disc and a plane, are nearest, s, and their gap then, in contact distances.
struct NearestPass {
  double time = 0, gap = 0;
};
NearestPass NearestPassOf(const Scene& scene, const Flight& flight, const Candidate& pair);
// Returns the reason why ConstrainedConditions() does not apply; empty if it does.
std::string WhyNotConstrainedConditions(const Scene& scene, const Flight& flight);

// Sets the theta of an impact on a node, by its multiplier and the one-sided ones: 0 at the late one, 1 at the early
// one; and whether the kink is concave. There is none if these two are the same, and the multiplier too. What changes
// the conditions of forces until the impact by less than their tolerance, in parts of `scale`, the largest costate of a
// velocity, is rounding.
void SetTheta(double early, double late, double multiplier, double scale, ImpactCertificate* impact);

// Computes the curvature. Returns std::nullopt if the matrices would be too large.
std::optional<Curvature> FindCurvature(const CondensedLoss& loss);
// Adds the kind of a curvature: it is flat if it is nearly zero, or less than `rounding` times the largest.
Curvature WithKind(const CurvatureRange& found, double rounding);

}  // namespace saltus
