// A step of free flight as a contact model takes it, as a function for Ceres: as PushedStep and CoastingStep
// (phase_costs.h), by the model's own rule of integration and its derivative by the step's length.
#pragma once

#include <ceres/cost_function.h>

#include "control/phase_costs.h"
#include "saltus/simulate/simulator.h"

namespace saltus {

// Sets `next` to the model's free flight from the state x = [p_x p_y v_x v_y] under the acceleration a.
inline void Fly(const StepLinearization::FreeFlight& by, const double* x, const Vec2d& a, double* next) {
  for (int j = 0; j < 2; ++j) {
    next[j] = by.pp * x[j] + by.pv * x[2 + j] + by.pa * a[j];
    next[2 + j] = by.vp * x[j] + by.vv * x[2 + j] + by.va * a[j];
  }
}

// Blocks: node, force (2) if the disc is pushed, begin, end, next node. Rows: 4 equalities next - f(node, force, h),
// and if it is pushed the costs sqrt(effort h) force. Fails where the model has no free flight over h.
class ModelStep final : public ceres::CostFunction {
 public:
  struct Push {
    double inverse_mass, effort;
    double least;  // s, of the length in the cost, whose root has no derivative at 0
  };

  // `simulator` must outlive this object.
  ModelStep(const Simulator& simulator, StepOfPhase step, std::optional<Push> push);

  bool Evaluate(double const* const* parameters, double* rows, double** jacobians) const override;

 private:
  const Simulator& simulator_;
  StepOfPhase step_;
  std::optional<Push> push_;
};

// A step of a disc with a torque, as TurnedStep. Blocks: rotation, torque / radius, begin, end, next rotation. Rows:
// 2 equalities and a cost.
class ModelTurn final : public ceres::CostFunction {
 public:
  // `simulator` must outlive this object.
  ModelTurn(const Simulator& simulator, StepOfPhase step, const ModelStep::Push& push);

  bool Evaluate(double const* const* parameters, double* rows, double** jacobians) const override;

 private:
  const Simulator& simulator_;
  StepOfPhase step_;
  ModelStep::Push push_;  // with r^2 / I
};

}  // namespace saltus
