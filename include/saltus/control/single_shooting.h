// Single shooting: the loss as a function of the decision variables alone, states eliminated by rollout.
//
// Decision variables z, by Scene::optimize:
//   control    the whole control, K x C x 2
//   velocity   the initial velocities of Scene::free, in that order, 2 each
//   position   the initial positions of Scene::free, likewise
//   none       empty
// or, whatever the scene optimizes, the whole initial state: the positions of all discs that move, then their
// velocities.
#pragma once

#include <Eigen/Core>
#include <memory>
#include <span>
#include <vector>

#include "saltus/control/objective.h"
#include "saltus/dynamics/simulator.h"

namespace saltus {

class SingleShooting {
 public:
  enum class Variables { kOfScene, kInitialState };

  explicit SingleShooting(std::unique_ptr<Simulator> simulator, Variables variables = Variables::kOfScene);

  const Scene& scene() const { return simulator_->scene(); }
  const Simulator& simulator() const { return *simulator_; }
  // As Simulator::set_memory_limit.
  void set_memory_limit(std::size_t bytes) { simulator_->set_memory_limit(bytes); }
  // As Simulator::set_stop and stopped(); what returns false "if not finite" does so too if it was stopped.
  void set_stop(StopRequest stop) { simulator_->set_stop(std::move(stop)); }
  bool stopped() const { return simulator_->stopped(); }
  int num_variables() const { return static_cast<int>(guess_.size()); }
  const std::vector<double>& initial_guess() const { return guess_; }

  // The loss at z, and its gradient (num_variables() numbers) unless null. False if rollout or loss are not
  // finite; the gradient may be infinite even so. In single precision the gradient is rounded to float, as automatic
  // differentiation in float would leave it.
  bool Evaluate(std::span<const double> z, double* loss, double* gradient);

  // Terminal residuals at z and their Jacobian with respect to z (rows x num_variables(), row-major), unless null: one
  // adjoint a residual. The effort is not among them. False as above. Precondition: the objective is a sum of squares.
  bool EvaluateTerminal(std::span<const double> z, double* residuals, double* jacobian);

  // That Jacobian where the last evaluation, which returned true, has been: without another rollout. Without meaning if
  // stopped().
  void TerminalJacobian(double* jacobian);

  // The loss at z and its derivatives with respect to everything: initial state, control (effort included), parameters.
  // False as above.
  bool EvaluateAll(std::span<const double> z, double* loss, Sensitivity* gradient);

  // The initial state (B x 4) and the control (K x C x 2) that z stands for.
  std::vector<double> InitialStateAt(std::span<const double> z) const;
  std::vector<double> ControlAt(std::span<const double> z) const;

  // How often a rollout and an adjoint have been computed.
  int num_rollouts() const { return num_rollouts_; }
  int num_adjoints() const { return num_adjoints_; }

 private:
  bool Rollout(std::span<const double> z);
  // `z` as in the last rollout.
  double LossOfLastRollout(std::span<const double> z) const;
  // The control that z stands for, without a copy.
  std::span<const double> ControlIn(std::span<const double> z) const;
  // The derivative by z of a function of the final state with derivative cotangent_, plus `effort` times z if z is the
  // control.
  void PullBack(double effort, std::span<const double> z, double* gradient);

  std::unique_ptr<Simulator> simulator_;
  bool controls_;  // z is the control
  std::vector<double> guess_;
  std::vector<int> variables_;  // if it is not: index of each variable in the initial state
  std::vector<double> initial_, final_, cotangent_;
  std::vector<double> control_;           // if it is not what z stands for
  std::vector<double> initial_gradient_;  // if z stands for some of it
  int num_rollouts_ = 0;
  int num_adjoints_ = 0;
};

}  // namespace saltus
