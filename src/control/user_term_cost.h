// User-defined terms in the units of a solver.
#pragma once

#include <ceres/cost_function.h>

#include <span>
#include <string>
#include <vector>

#include "saltus/control/user_term.h"
#include "scene/units.h"
#include "simulate/flight.h"

namespace saltus {

// Blocks: as UserTerm's, in the scene's units, rotations and torques as [r angle, r w] and torque / r of a disc with
// the radius r. Residuals: costs whose squares are in units of the loss, or constraints in parts of their scale.
class UserTermCost final : public ceres::CostFunction {
 public:
  // `term` is valid, and must outlive this object.
  UserTermCost(const UserTerm& term, const Scene& scene);

  bool Evaluate(double const* const* parameters, double* residuals, double** jacobians) const override;

 private:
  const UserTerm& term_;
  Units units_;
  UnitFactors to_si_;
  double row_factor_;
  std::vector<std::vector<double>> to_si_of_;  // of each block but the length: factors of its entries
};

// Values on a motion in the scene's units: the sum of squares of costs, and the largest violation of a constraint,
// relative to its scale; infinite where a function fails. `control` has a row for each of `durations`.
struct UserTermValues {
  double cost = 0, violation = 0;
  std::string worst;  // the name of the constraint that is violated most
};
UserTermValues EvaluateUserTerms(const std::vector<UserTerm>& terms, const Scene& scene, const Flight& flight,
                                 std::span<const double> control, std::span<const double> durations);

}  // namespace saltus
