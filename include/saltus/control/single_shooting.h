// Single shooting: the loss as a function of the decision variables alone, with states eliminated by rollout.
//
// The decision variables z depend on Scene::optimize:
//   control    the whole control, K x Scene::control_width() numbers (K x C x 2 without torque controls)
//   velocity   the initial velocities of Scene::free, in that order, 2 each; then the angular velocities of
//              Scene::free_spin
//   position   the initial positions of Scene::free, in that order, 2 each
//   none       empty
// They are followed by the final time, s, if it is free, and by the values of Scene::design. With
// Variables::kInitialState they are the whole initial state instead: the positions of all discs that are not fixed,
// then all their velocities, then [angle, angular velocity] of each disc that spins.
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

class PathCosts;

// The loss has all terms of the objective that are not hard. Path costs are exact in exact dynamics (the event-driven
// model in double precision). With other models running costs are integrated by the trapezoidal rule on the steps of
// the model, and waypoint costs interpolate states linearly.
class SingleShooting final : public ShootingFunction {
 public:
  enum class Variables { kOptimized, kInitialState };
  // A function that returns the simulator of the scene with another duration or other values of its design parameters;
  // null if the contact model does not support that scene.
  using SimulatorFactory = std::function<std::unique_ptr<Simulator>(const Scene& scene)>;

  // A free final time and design parameters are variables only with `simulator_factory` and Variables::kOptimized, and
  // otherwise have the values of the scene. Design parameters of a scene with path costs are variables in exact
  // dynamics only. Preconditions, with `simulator_factory` and a free final time: the control is optimized, and the
  // dynamics are exact.
  explicit SingleShooting(std::unique_ptr<Simulator> simulator, Variables variables = Variables::kOptimized,
                          SimulatorFactory simulator_factory = nullptr);
  SingleShooting(SingleShooting&&) noexcept;
  ~SingleShooting() override;

  const Scene& scene() const { return simulator_->scene(); }
  const Simulator& simulator() const { return *simulator_; }
  // Sets the limit of Simulator::set_memory_limit.
  void set_memory_limit(std::size_t bytes) { simulator_->set_memory_limit(bytes); }
  // Sets the request of Simulator::set_stop. Evaluations return false when it stops them.
  void set_stop(StopRequest stop) {
    stop_ = stop;
    simulator_->set_stop(std::move(stop));
  }
  bool stopped() const override { return simulator_->stopped(); }
  int num_variables() const override { return static_cast<int>(guess_.size()); }
  const std::vector<double>& initial_guess() const override { return guess_; }

  // Computes the loss at z, and its gradient (num_variables() numbers) unless null. Returns false if the rollout or the
  // loss is not finite, a design parameter is out of its bounds, or discs overlap at positions in z; the gradient may
  // be infinite nevertheless. In single precision the gradient is rounded to float, as that of automatic
  // differentiation in float is.
  bool Evaluate(std::span<const double> z, double* loss, double* gradient) override;

  // Returns how many points EvaluateTogether evaluates at once; 1 if that is not faster than one after the other.
  int num_lanes() const;
  // Evaluates point i, row i of `points`, by shootings[i], for up to num_lanes() points, with the bits of Evaluate().
  // ok[i] is its result; `gradients` is P x num_variables(), or empty. Precondition: all shootings are of the same
  // problem.
  static void EvaluateTogether(std::span<const std::unique_ptr<SingleShooting>> shootings,
                               std::span<const double> points, std::span<double> losses, std::span<double> gradients,
                               std::span<bool> ok);

  // Returns why the last evaluation returned false, or has derivatives that are not finite; empty if neither, or
  // stopped.
  std::string FailureReason() const override;

  // Computes the num_residuals() residuals of all terms but the effort and the weight of a free final time at z, and
  // their Jacobian with respect to z (rows x num_variables(), row-major) unless null, by one adjoint for each residual.
  // Returns false if Evaluate() does. Preconditions: the objective is a sum of squares and has no hard terms.
  int num_residuals() const override;
  bool EvaluateResiduals(std::span<const double> z, double* residuals, double* jacobian) override;

  // Computes the Jacobian of the residuals at the last evaluation, which returned true, without another rollout. It has
  // no meaning if stopped().
  void ResidualJacobian(double* jacobian) override;

  // Computes the loss at z and its derivatives with respect to initial state, control (effort included) and parameters.
  // Returns false if Evaluate() does.
  bool EvaluateAll(std::span<const double> z, double* loss, Sensitivity* gradient);

  // Return the initial state and the control (K x control_width()) of z, or those of the scene where z has none.
  std::vector<double> InitialStateAt(std::span<const double> z) const override;
  std::vector<double> ControlAt(std::span<const double> z) const override;
  // Returns whether the final time is a variable. DurationsAt() then returns the lengths of the K steps, s, which are
  // equal, and otherwise an empty vector.
  bool has_duration() const { return has_duration_; }
  std::vector<double> DurationsAt(std::span<const double> z) const override;
  // Returns the values of the scene's design parameters, the last num_design() variables.
  std::vector<double> ParametersAt(std::span<const double> z) const override;
  int num_design() const { return num_design_; }

  // Return how many rollouts and adjoints have been computed.
  int num_rollouts() const { return num_rollouts_; }
  int num_adjoints() const override { return num_adjoints_; }

 private:
  void AddDesign();
  bool Rollout(std::span<const double> z);
  // The parts of a rollout before and after that of the simulator.
  bool BeginRollout(std::span<const double> z);
  bool EndRollout(std::span<const double> z);
  // The loss of the effort at z, and that of the last rollout, if this is its effort.
  double Effort(std::span<const double> z) const;
  double LossOfLastRollout(double effort) const;
  // Evaluate() after the rollout.
  bool EvaluateLast(std::span<const double> z, double effort, double* loss, double* gradient);
  // Moves on to the simulator of the scene that z stands for; returns why there is none, or nothing.
  std::string SetScene(std::span<const double> z);
  void PathCostGradient(std::span<const double> z, double* gradient);
  template <typename Numbers, typename Put>
  void DifferenceByParameters(const Numbers& numbers, const Put& put);
  // z without the design parameters.
  std::span<const double> StripDesign(std::span<const double> z) const { return z.first(z.size() - num_design_); }
  // The control that z stands for, without a copy.
  std::span<const double> ControlIn(std::span<const double> z) const;
  // The derivative by z of a function of the final state with derivative cotangent_, plus `effort` times z if z is the
  // control.
  void PullBack(double effort, std::span<const double> z, double* gradient);

  std::unique_ptr<Simulator> simulator_;
  SimulatorFactory simulator_factory_;  // none: only initial state and control are variables
  bool has_duration_ = false;
  int num_design_ = 0;
  Scene given_;  // whose design parameters are those of the start; only if there are any
  ParameterGradient parameters_;
  std::unique_ptr<PathCosts> path_costs_;  // null if the loss is that of the end and the effort
  std::string failure_;                    // of the last evaluation, if it is not the simulator's
  std::vector<double> at_;                 // with path costs: where the last rollout was
  StopRequest stop_;
  bool controls_;  // z is the control
  bool places_;    // z is positions at the start, at which discs must not overlap
  std::vector<double> guess_;
  std::vector<int> variables_;  // if it is not: index of each variable in the initial state
  std::vector<double> initial_, final_, cotangent_;
  std::vector<double> control_;           // if it is not what z stands for
  std::vector<double> initial_gradient_;  // if z stands for some of it
  int num_rollouts_ = 0;
  int num_adjoints_ = 0;
};

}  // namespace saltus
