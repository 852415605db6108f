// The greatest values of functions in a control interval, for inequalities that hold at all times.
#pragma once

#include <ceres/cost_function.h>

#include "hybrid/recorded_functions.h"
#include "saltus/hybrid/hybrid_system.h"

namespace saltus::python {

// The values of functions at the end of a control interval, and then their greatest ones before it, along the flow of a
// mode, which is integrated in kParts steps from the state at the beginning. The latter are at the beginning, or where
// the rate of a function falls through zero within a step, which is found; of several such times within one step one is
// found. Each value is then differentiated at its time. Those at the end are residuals of their own because a function
// that is at its bound for a while has all its values there: with one residual, whose derivative jumps with the time of
// the greatest value, solvers do not converge.
//
// Parameter blocks: the state at the beginning, the control and the parameters, if the system has any, the time of the
// beginning and the length of the interval.
class GreatestValue final : public ceres::CostFunction {
 public:
  static constexpr int kParts = 8;

  // Precondition: the functions read [x t p u].
  GreatestValue(HybridSystem system, int mode, RecordedFunction functions);
  bool Evaluate(double const* const* parameters, double* residuals, double** jacobians) const override;

 private:
  const HybridSystem system_;
  const int mode_, num_parameters_, num_controls_;
  const RecordedFunction functions_;
};

}  // namespace saltus::python
