#include "saltus/control/single_shooting.h"

#include <glog/logging.h>

#include <cmath>

namespace saltus {
namespace {

// Indices into the initial state (B x 4): of the first of two entries of each body, and the next.
void AddPairs(const std::vector<int>& bodies, int offset, std::vector<int>* indices) {
  for (int body : bodies) {
    for (int j = 0; j < 2; ++j) indices->push_back(4 * body + offset + j);
  }
}

std::vector<int> IndicesOfDecisionVariables(const Scene& scene) {
  std::vector<int> indices;
  if (scene.optimize == Optimize::kPosition) AddPairs(scene.free, 0, &indices);
  if (scene.optimize == Optimize::kVelocity) AddPairs(scene.free, 2, &indices);
  return indices;
}

std::vector<int> IndicesOfInitialState(const Scene& scene) {
  std::vector<int> moving, indices;
  for (int i = 0; i < scene.num_bodies(); ++i) {
    if (!scene.bodies[i].fixed) moving.push_back(i);
  }
  AddPairs(moving, 0, &indices);
  AddPairs(moving, 2, &indices);
  return indices;
}

}  // namespace

SingleShooting::SingleShooting(std::unique_ptr<Simulator> simulator, Variables variables)
    : simulator_(std::move(simulator)),
      controls_(variables == Variables::kOfScene && scene().optimize == Optimize::kControl),
      initial_(InitialState(simulator_->scene())),
      final_(simulator_->state_size()),
      cotangent_(simulator_->state_size()) {
  if (controls_) {
    guess_ = InitialControl(scene(), simulator_->num_steps());
    return;
  }
  control_ = InitialControl(scene(), simulator_->num_steps());
  variables_ =
      variables == Variables::kInitialState ? IndicesOfInitialState(scene()) : IndicesOfDecisionVariables(scene());
  for (int index : variables_) guess_.push_back(initial_[index]);
  if (!variables_.empty()) initial_gradient_.resize(initial_.size());
}

std::vector<double> SingleShooting::InitialStateAt(std::span<const double> z) const {
  std::vector<double> initial = InitialState(scene());
  for (size_t i = 0; i < variables_.size(); ++i) initial[variables_[i]] = z[i];
  return initial;
}

std::span<const double> SingleShooting::ControlIn(std::span<const double> z) const {
  if (controls_) return z;
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

void SingleShooting::PullBack(double effort, std::span<const double> z, double* gradient) {
  ++num_adjoints_;
  SensitivityView out;
  out.initial = initial_gradient_;
  if (controls_) {
    out.control = {gradient, guess_.size()};
    out.factor = effort;
    out.addend = z;
  }
  simulator_->AdjointInto(cotangent_, out);
  for (int index : variables_) *gradient++ = initial_gradient_[index];
}

bool SingleShooting::Evaluate(std::span<const double> z, double* loss, double* gradient) {
  if (!Rollout(z)) return false;
  *loss = LossOfLastRollout(z);
  if (!std::isfinite(*loss)) return false;
  if (gradient == nullptr) return true;
  TerminalGradient(scene().objective, final_, simulator_->body_size(), cotangent_);
  PullBack(EffortWeight(scene().objective, simulator_->step()), z, gradient);
  if (simulator_->precision() == Precision::kFloat) {
    for (int i = 0; i < num_variables(); ++i) gradient[i] = static_cast<float>(gradient[i]);
  }
  return !stopped();
}

bool SingleShooting::EvaluateTerminal(std::span<const double> z, double* residuals, double* jacobian) {
  if (!Rollout(z)) return false;
  const int rows = NumTerminalResiduals(scene().objective);
  TerminalResiduals(scene().objective, final_, simulator_->body_size(), {residuals, static_cast<size_t>(rows)});
  if (!std::isfinite(LossOfLastRollout(z))) return false;
  if (jacobian == nullptr) return true;
  TerminalJacobian(jacobian);
  return !stopped();
}

void SingleShooting::TerminalJacobian(double* jacobian) {
  const Eigen::MatrixXd terminal =
      saltus::TerminalJacobian(scene().objective, simulator_->state_size(), simulator_->body_size());
  for (int row = 0; row < terminal.rows(); ++row) {
    Eigen::Map<Eigen::RowVectorXd>(cotangent_.data(), cotangent_.size()) = terminal.row(row);
    PullBack(0, {}, jacobian + static_cast<size_t>(row) * num_variables());
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
  return !stopped();
}

}  // namespace saltus
