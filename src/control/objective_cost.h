// The objective as cost functions of Ceres: sums of squares whose halves Ceres minimizes, so that the loss is twice its
// cost.
#pragma once

#include <ceres/cost_function.h>

#include <Eigen/Core>

#include "saltus/scene/scene.h"

namespace saltus {

// The terminal terms. Parameter block: the final state, B * body_size numbers.
class TerminalCost final : public ceres::CostFunction {
 public:
  // Precondition: objective.IsSumOfSquares() and there is at least one term.
  TerminalCost(const Objective& objective, int num_bodies, int body_size);
  bool Evaluate(double const* const* parameters, double* residuals, double** jacobians) const override;

 private:
  Objective objective_;
  int body_size_;
  Eigen::MatrixXd jacobian_;
};

// scale * u, for the effort. Parameter block: u, `size` numbers.
class EffortCost final : public ceres::CostFunction {
 public:
  EffortCost(double scale, int size);
  bool Evaluate(double const* const* parameters, double* residuals, double** jacobians) const override;

 private:
  double scale_;
};

}  // namespace saltus
