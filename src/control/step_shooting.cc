#include "control/step_shooting.h"

#include <ceres/manifold.h>
#include <glog/logging.h>

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <span>
#include <vector>

#include "saltus/control/objective.h"
#include "saltus/control/step_cost.h"

namespace saltus {
namespace {

using RowMajor = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;

// Returns the columns of `b` that belong to the control.
RowMajor ControlColumns(const Simulator& simulator, const RowMajor& b) {
  const auto size = static_cast<size_t>(b.cols()), width = static_cast<size_t>(simulator.control_width());
  RowMajor columns(b.rows(), width);
  for (Eigen::Index row = 0; row < b.rows(); ++row) {
    simulator.SelectControl({b.row(row).data(), size}, {columns.row(row).data(), width});
  }
  return columns;
}

}  // namespace

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

StepShooting::StepShooting(const SingleShooting* shooting, std::span<const double> z)
    : shooting_(shooting), states_(StatesOf(shooting->simulator())), control_(shooting->ControlAt(z)) {
  const Scene& scene = shooting->scene();
  if (scene.optimize != Optimize::kVelocity && scene.optimize != Optimize::kPosition) return;
  const int offset = scene.optimize == Optimize::kVelocity ? 2 : 0;
  for (int body : scene.free) {
    for (int j = 0; j < 2; ++j) decision_indices_.push_back(body * simulator().body_size() + offset + j);
  }
  for (int body : scene.free_spin) decision_indices_.push_back(body * simulator().body_size() + 5);
}

std::vector<double*> StepShooting::StepBlocks(int k) {
  const int forces = simulator().control_width();
  if (forces == 0) return {State(k), State(k + 1)};
  return {State(k), &control_[static_cast<size_t>(k) * forces], State(k + 1)};
}

std::vector<double> StepShooting::Decisions() const {
  if (shooting_->scene().optimize == Optimize::kControl) return control_;
  std::vector<double> z;
  for (int index : decision_indices_) z.push_back(states_[index]);
  return z;
}

void StepShooting::AddEffort(const std::function<void(std::unique_ptr<ceres::CostFunction>, double*)>& add) {
  const Scene& scene = shooting_->scene();
  if (scene.optimize != Optimize::kControl || scene.objective.effort == 0) return;
  const double scale = std::sqrt(scene.objective.effort * simulator().step());
  const int forces = simulator().control_width();
  for (int k = 0; k < num_steps(); ++k) {
    add(std::make_unique<EffortCost>(scale, forces), StepBlocks(k)[1]);
  }
}

void StepShooting::HoldConstants(ceres::Problem* problem) {
  if (shooting_->scene().optimize == Optimize::kControl) {
    problem->SetParameterBlockConstant(State(0));
    return;
  }
  std::vector<int> held;
  for (int i = 0; i < state_size(); ++i) {
    if (std::find(decision_indices_.begin(), decision_indices_.end(), i) == decision_indices_.end()) held.push_back(i);
  }
  problem->SetManifold(State(0), new ceres::SubsetManifold(state_size(), held));
  if (simulator().num_controlled() == 0) return;
  for (int k = 0; k < num_steps(); ++k) problem->SetParameterBlockConstant(StepBlocks(k)[1]);
}

std::unique_ptr<StepCost> MakeStepCost(const Simulator& simulator) {
  return std::make_unique<StepCost>(std::shared_ptr<const Simulator>(std::shared_ptr<void>(), &simulator));
}

std::unique_ptr<TerminalCost> MakeTerminalCost(const Simulator& simulator) {
  const Objective& objective = simulator.scene().objective;
  if (objective.terminal.empty()) return nullptr;
  return std::make_unique<TerminalCost>(objective, simulator.num_bodies(), simulator.body_size());
}

std::vector<double> StatesOf(const Simulator& simulator) {
  const size_t size = simulator.state_size();
  std::vector<double> states((simulator.num_steps() + 1) * size);
  for (int k = 0; k <= simulator.num_steps(); ++k) simulator.GetState(k, {&states[k * size], size});
  return states;
}

std::vector<double> LargestDefects(const Simulator& simulator, std::span<const double> states,
                                   std::span<const double> control) {
  const size_t size = simulator.state_size();
  CHECK_EQ(states.size(), (simulator.num_steps() + 1) * size);
  std::vector<double> force(simulator.force_size()), next(size), largest(simulator.num_steps());
  for (int k = 0; k < simulator.num_steps(); ++k) {
    simulator.ExpandForce(control, k, force);
    simulator.Step(states.subspan(k * size, size), force, next);
    for (size_t i = 0; i < size; ++i) {
      const double defect = std::abs(states[(k + 1) * size + i] - next[i]);
      if (!(defect <= largest[k])) largest[k] = defect;  // so that one that is not a number is seen
    }
  }
  return largest;
}

}  // namespace saltus
