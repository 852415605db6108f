// One step of a simulator as a cost function of Ceres, for transcriptions in which states are variables too:
//
//   r(x, u, x') = x' - f(x, u)
//
// Parameter blocks: the state x (Simulator::state_size() numbers), one row u of a control (Scene::control_width()
// numbers, torque controls among them; no such block if no disc is controlled), the next state x'. Jacobians are those
// of Simulator::Linearize.
#pragma once

#include <ceres/cost_function.h>

#include <memory>

#include "saltus/simulate/simulator.h"

namespace saltus {

class StepCost final : public ceres::CostFunction {
 public:
  // Shares the simulator, with other costs and other threads too: only its Step and Linearize are called.
  explicit StepCost(std::shared_ptr<const Simulator> simulator);

  // Returns false, so that Ceres rejects the point, if step or linearization are not finite, or the simulator stopped.
  bool Evaluate(double const* const* parameters, double* residuals, double** jacobians) const override;

 private:
  std::shared_ptr<const Simulator> simulator_;
};

}  // namespace saltus
