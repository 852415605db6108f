#include "saltus/control/step_cost.h"

#include <Eigen/Core>
#include <span>
#include <vector>

namespace saltus {
namespace {

using RowMajor = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;

// Columns of `b` that belong to the control.
RowMajor ControlColumns(const Simulator& simulator, const RowMajor& b) {
  const auto size = static_cast<size_t>(b.cols()), width = static_cast<size_t>(simulator.control_width());
  RowMajor columns(b.rows(), width);
  for (Eigen::Index row = 0; row < b.rows(); ++row) {
    simulator.SelectControl({b.row(row).data(), size}, {columns.row(row).data(), width});
  }
  return columns;
}

}  // namespace

StepCost::StepCost(std::shared_ptr<const Simulator> simulator) : simulator_(std::move(simulator)) {
  const int size = simulator_->state_size();
  set_num_residuals(size);
  std::vector<int>& blocks = *mutable_parameter_block_sizes();
  blocks.push_back(size);
  if (simulator_->num_controlled() > 0) blocks.push_back(simulator_->control_width());
  blocks.push_back(size);
}

bool StepCost::Evaluate(double const* const* parameters, double* residuals, double** jacobians) const {
  if (simulator_->stopped()) return false;
  const int size = simulator_->state_size();
  const bool controlled = simulator_->num_controlled() > 0;
  const std::span<const double> x(parameters[0], size);
  std::vector<double> force(simulator_->force_size());
  if (controlled) {
    simulator_->ExpandForce({parameters[1], static_cast<size_t>(simulator_->control_width())}, 0, force);
  }

  Eigen::Map<Eigen::VectorXd> r(residuals, size);
  simulator_->Step(x, force, {residuals, static_cast<size_t>(size)});
  r = Eigen::Map<const Eigen::VectorXd>(parameters[controlled ? 2 : 1], size) - r;
  if (!r.allFinite()) return false;
  if (jacobians == nullptr) return true;

  StepLinearization linearization;
  simulator_->Linearize(x, force, /*with_parameters=*/false, &linearization);
  Eigen::MatrixXd a, b;
  linearization.ToDense(&a, &b);
  if (!a.allFinite() || !b.allFinite()) return false;
  const auto write = [&](int block, const Eigen::MatrixXd& jacobian) {
    if (jacobians[block] != nullptr) Eigen::Map<RowMajor>(jacobians[block], size, jacobian.cols()) = jacobian;
  };
  write(0, -a);
  if (controlled) write(1, -ControlColumns(*simulator_, b));
  write(controlled ? 2 : 1, Eigen::MatrixXd::Identity(size, size));
  return true;
}

}  // namespace saltus
