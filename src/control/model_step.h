// A step of free flight as a contact model takes it, as a function for Ceres: as PushedStep and CoastingStep
// (phase_costs.h), by the model's own rule of integration and its derivative by the step's length.
#pragma once

#include <ceres/cost_function.h>

#include "control/phase_costs.h"
#include "saltus/simulate/simulator.h"

namespace saltus {

// Sets `next` to the model's free flight from the state x = [p v] under the acceleration a.
template <int kSize>
void Fly(const StepLinearization::FreeFlight& by, const double* x, const Coordinates<double, kSize>& a, double* next) {
  for (int j = 0; j < kSize; ++j) {
    next[j] = by.pp * x[j] + by.pv * x[kSize + j] + by.pa * a[j];
    next[kSize + j] = by.vp * x[j] + by.vv * x[kSize + j] + by.va * a[j];
  }
}

// The effect of a force on a disc and its cost; that of a torque has r^2 / I in place of 1/m.
struct Push {
  double inverse_mass, effort;
  double least;  // s, of the length in the cost, whose root has no derivative at 0
};

// Blocks: node, force if the disc is pushed, begin, end, next node. Rows: the equalities next - f(node, force, h), and
// if it is pushed the costs sqrt(effort h) force. Fails where the model has no free flight over h. With kSize 1, a step
// of a disc with a torque, by rotations and torque / radius.
template <int kSize>
class ModelStep final : public ceres::CostFunction {
 public:
  // `simulator` must outlive this object.
  ModelStep(const Simulator& simulator, StepOfPhase step, std::optional<Push> push);

  bool Evaluate(double const* const* parameters, double* rows, double** jacobians) const override;

 private:
  const Simulator& simulator_;
  StepOfPhase step_;
  std::optional<Push> push_;
};

extern template class ModelStep<1>;
extern template class ModelStep<2>;

}  // namespace saltus
