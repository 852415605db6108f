// The greatest values of functions in a control interval, for inequalities that hold at all times.
#pragma once

#include <ceres/cost_function.h>

#include "hybrid/recorded_functions.h"
#include "saltus/hybrid/hybrid_system.h"

namespace saltus::python {

// The greatest values in a control interval of functions along the flow of a mode, which is integrated in kParts steps
// from the state at the beginning. Where the rate of a function falls through zero within a step, the time is found at
// which it does; of several such times within one step one is found. Each value is then differentiated at its time.
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
