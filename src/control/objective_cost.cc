#include "control/objective_cost.h"

#include <algorithm>

#include "saltus/control/objective.h"

namespace saltus {

TerminalCost::TerminalCost(const Objective& objective, int num_bodies, int body_size)
    : objective_(objective),
      body_size_(body_size),
      jacobian_(TerminalJacobian(objective, num_bodies * body_size, body_size)) {
  set_num_residuals(static_cast<int>(jacobian_.rows()));
  mutable_parameter_block_sizes()->push_back(static_cast<int>(jacobian_.cols()));
}

bool TerminalCost::Evaluate(double const* const* parameters, double* residuals, double** jacobians) const {
  const size_t size = jacobian_.cols(), rows = num_residuals();
  TerminalResiduals(objective_, {parameters[0], size}, body_size_, {residuals, rows});
  if (jacobians == nullptr || jacobians[0] == nullptr) return true;
  using RowMajor = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;
  Eigen::Map<RowMajor>(jacobians[0], rows, size) = jacobian_;
  return true;
}

EffortCost::EffortCost(double scale, int size) : scale_(scale) {
  set_num_residuals(size);
  mutable_parameter_block_sizes()->push_back(size);
}

bool EffortCost::Evaluate(double const* const* parameters, double* residuals, double** jacobians) const {
  const int size = num_residuals();
  for (int i = 0; i < size; ++i) residuals[i] = scale_ * parameters[0][i];
  if (jacobians == nullptr || jacobians[0] == nullptr) return true;
  std::fill_n(jacobians[0], size * size, 0.0);
  for (int i = 0; i < size; ++i) jacobians[0][i * size + i] = scale_;
  return true;
}

}  // namespace saltus
