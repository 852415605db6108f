#include "saltus/control/single_shooting.h"

#include <glog/logging.h>

#include <cmath>

namespace saltus {

SingleShooting::SingleShooting(std::unique_ptr<Simulator> simulator)
    : simulator_(std::move(simulator)),
      initial_(InitialState(simulator_->scene())),
      final_(simulator_->state_size()),
      cotangent_(simulator_->state_size()) {
  if (scene().optimize == Optimize::kControl) {
    guess_ = InitialControl(scene(), simulator_->num_steps());
    return;
  }
  control_ = InitialControl(scene(), simulator_->num_steps());
  if (scene().optimize != Optimize::kNone) {
    const int offset = scene().optimize == Optimize::kVelocity ? 2 : 0;
    for (int body : scene().free) {
      for (int j = 0; j < 2; ++j) variables_.push_back(4 * body + offset + j);
    }
    for (int index : variables_) guess_.push_back(initial_[index]);
    initial_gradient_.resize(initial_.size());
  }
}

std::vector<double> SingleShooting::InitialStateAt(std::span<const double> z) const {
  std::vector<double> initial = InitialState(scene());
  for (size_t i = 0; i < variables_.size(); ++i) initial[variables_[i]] = z[i];
  return initial;
}

std::span<const double> SingleShooting::ControlIn(std::span<const double> z) const {
  if (scene().optimize == Optimize::kControl) return z;
  return control_;
}

std::vector<double> SingleShooting::ControlAt(std::span<const double> z) const {
  const std::span<const double> control = ControlIn(z);
  return {control.begin(), control.end()};
}

bool SingleShooting::Rollout(std::span<const double> z) {
  CHECK_EQ(static_cast<int>(z.size()), num_variables());
  for (size_t i = 0; i < variables_.size(); ++i) initial_[variables_[i]] = z[i];
  ++num_rollouts_;
  if (!simulator_->Rollout(initial_, ControlIn(z))) return false;
  simulator_->GetState(simulator_->num_steps(), final_);
  return true;
}

double SingleShooting::LossOfLastRollout(std::span<const double> z) const {
  return TerminalLoss(scene().objective, final_, simulator_->body_size()) +
         EffortLoss(scene().objective, ControlIn(z), simulator_->step());
}

void SingleShooting::PullBack(double* gradient) {
  ++num_adjoints_;
  SensitivityView out;
  out.initial = initial_gradient_;
  if (scene().optimize == Optimize::kControl) out.control = {gradient, guess_.size()};
  simulator_->AdjointInto(cotangent_, out);
  for (int index : variables_) *gradient++ = initial_gradient_[index];
}

bool SingleShooting::Evaluate(std::span<const double> z, double* loss, double* gradient) {
  if (!Rollout(z)) return false;
  *loss = LossOfLastRollout(z);
  if (!std::isfinite(*loss)) return false;
  if (gradient == nullptr) return true;
  TerminalGradient(scene().objective, final_, simulator_->body_size(), cotangent_);
  PullBack(gradient);
  if (scene().optimize == Optimize::kControl) {
    AddEffortGradient(scene().objective, z, simulator_->step(), {gradient, guess_.size()});
  }
  if (simulator_->precision() == Precision::kFloat) {
    for (int i = 0; i < num_variables(); ++i) gradient[i] = static_cast<float>(gradient[i]);
  }
  return true;
}

bool SingleShooting::EvaluateTerminal(std::span<const double> z, double* residuals, double* jacobian) {
  if (!Rollout(z)) return false;
  const int rows = NumTerminalResiduals(scene().objective);
  TerminalResiduals(scene().objective, final_, simulator_->body_size(), {residuals, static_cast<size_t>(rows)});
  if (!std::isfinite(LossOfLastRollout(z))) return false;
  if (jacobian != nullptr) TerminalJacobian(jacobian);
  return true;
}

void SingleShooting::TerminalJacobian(double* jacobian) {
  const Eigen::MatrixXd terminal =
      saltus::TerminalJacobian(scene().objective, simulator_->state_size(), simulator_->body_size());
  for (int row = 0; row < terminal.rows(); ++row) {
    Eigen::Map<Eigen::RowVectorXd>(cotangent_.data(), cotangent_.size()) = terminal.row(row);
    PullBack(jacobian + static_cast<size_t>(row) * num_variables());
  }
}

bool SingleShooting::EvaluateAll(std::span<const double> z, double* loss, Sensitivity* gradient) {
  if (!Rollout(z)) return false;
  *loss = LossOfLastRollout(z);
  if (!std::isfinite(*loss)) return false;
  TerminalGradient(scene().objective, final_, simulator_->body_size(), cotangent_);
  simulator_->Adjoint(cotangent_, /*with_parameters=*/true, gradient);
  ++num_adjoints_;
  AddEffortGradient(scene().objective, ControlIn(z), simulator_->step(), gradient->control);
  return true;
}

}  // namespace saltus
