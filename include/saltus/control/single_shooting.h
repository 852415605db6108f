// Single shooting: the loss as a function of the decision variables alone, states eliminated by rollout.
//
// Decision variables z, by Scene::optimize:
//   control    the whole control, K x C x 2
//   velocity   the initial velocities of Scene::free, in that order, 2 each; then the angular velocities of
//              Scene::free_spin
//   position   the initial positions of Scene::free, likewise
//   none       empty
// if the final time is free, followed by it; or, whatever the scene optimizes, the whole initial state: the positions
// of all discs that move, then their velocities; then angle and angular velocity of those that spin.
#pragma once

#include <Eigen/Core>
#include <functional>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "saltus/control/objective.h"
#include "saltus/control/shooting_function.h"
#include "saltus/simulate/simulator.h"

namespace saltus {

class WayCosts;

// The loss has all terms of the objective that are not hard. Running and via terms are exact in exact dynamics (the
// event-driven model in double precision); of other models they are the trapezoidal rule on the model's own steps, and
// via terms read states in between linearly.
class SingleShooting final : public ShootingFunction {
 public:
  enum class Variables { kOfScene, kInitialState };
  // The simulator of the scene with another duration.
  using OfDuration = std::function<std::unique_ptr<Simulator>(double duration)>;

  // Only with `of_duration`, exact dynamics and Variables::kOfScene is a free final time a variable; else it stays at
  // the scene's.
  explicit SingleShooting(std::unique_ptr<Simulator> simulator, Variables variables = Variables::kOfScene,
                          OfDuration of_duration = nullptr);
  SingleShooting(SingleShooting&&) noexcept;
  ~SingleShooting() override;

  const Scene& scene() const { return simulator_->scene(); }
  const Simulator& simulator() const { return *simulator_; }
  // As Simulator::set_memory_limit.
  void set_memory_limit(std::size_t bytes) { simulator_->set_memory_limit(bytes); }
  // As Simulator::set_stop and stopped(); what returns false "if not finite" does so too if it was stopped.
  void set_stop(StopRequest stop) {
    stop_ = stop;
    simulator_->set_stop(std::move(stop));
  }
  bool stopped() const override { return simulator_->stopped(); }
  int num_variables() const override { return static_cast<int>(guess_.size()); }
  const std::vector<double>& initial_guess() const override { return guess_; }

  // The loss at z, and its gradient (num_variables() numbers) unless null. False if rollout or loss are not
  // finite; the gradient may be infinite even so. In single precision the gradient is rounded to float, as automatic
  // differentiation in float would leave it.
  bool Evaluate(std::span<const double> z, double* loss, double* gradient) override;

  // Why the last evaluation returned false; empty if it did not, or was stopped.
  std::string WhyFailed() const override;

  // The residuals of all terms but the effort and the price of time at z, num_residuals() of them, and their Jacobian
  // with respect to z (rows x num_variables(), row-major), unless null: one adjoint a residual. False as above.
  // Precondition: the objective is a sum of squares.
  int num_residuals() const override;
  bool EvaluateResiduals(std::span<const double> z, double* residuals, double* jacobian) override;

  // That Jacobian where the last evaluation, which returned true, has been: without another rollout. Without meaning if
  // stopped().
  void ResidualJacobian(double* jacobian) override;

  // The loss at z and its derivatives with respect to everything: initial state, control (effort included), parameters.
  // False as above.
  bool EvaluateAll(std::span<const double> z, double* loss, Sensitivity* gradient);

  // The initial state and the control (K x C x 2) that z stands for.
  std::vector<double> InitialStateAt(std::span<const double> z) const override;
  std::vector<double> ControlAt(std::span<const double> z) const override;
  // Whether the last variable is the final time; then the lengths of the steps, else nothing.
  bool has_duration() const { return of_duration_ != nullptr; }
  std::vector<double> DurationsAt(std::span<const double> z) const override;

  // How often a rollout and an adjoint have been computed.
  int num_rollouts() const { return num_rollouts_; }
  int num_adjoints() const override { return num_adjoints_; }

 private:
  bool Rollout(std::span<const double> z);
  // `z` as in the last rollout.
  double LossOfLastRollout(std::span<const double> z) const;
  bool SetDuration(double duration);
  void WayGradient(std::span<const double> z, double* gradient);
  // The control that z stands for, without a copy.
  std::span<const double> ControlIn(std::span<const double> z) const;
  // The derivative by z of a function of the final state with derivative cotangent_, plus `effort` times z if z is the
  // control.
  void PullBack(double effort, std::span<const double> z, double* gradient);

  std::unique_ptr<Simulator> simulator_;
  OfDuration of_duration_;         // none: the final time is no variable
  std::unique_ptr<WayCosts> way_;  // null if the loss is that of the end and the effort
  std::string way_failure_;
  StopRequest stop_;
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
