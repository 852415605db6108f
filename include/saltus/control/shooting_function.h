// The interface of a loss as a function of decision variables, with states eliminated by simulation, for solvers by
// single shooting.
#pragma once

#include <span>
#include <string>
#include <vector>

namespace saltus {

// A loss of num_variables() decision variables z. What z consists of is documented by each implementation.
class ShootingFunction {
 public:
  virtual ~ShootingFunction() = default;

  virtual int num_variables() const = 0;
  virtual const std::vector<double>& initial_guess() const = 0;

  // Computes the loss at z, and its gradient (num_variables() numbers) unless null. Returns false if the motion or the
  // loss does not exist or is not finite, or if it was stopped.
  virtual bool Evaluate(std::span<const double> z, double* loss, double* gradient) = 0;
  // Returns why the last evaluation returned false; empty if it did not, or was stopped.
  virtual std::string FailureReason() const = 0;
  virtual bool stopped() const = 0;

  // Computes the num_residuals() residuals whose squares, without a half, add up to the loss (apart from the effort and
  // the weight of a free final time, which solvers add), and their Jacobian by z (num_residuals() x num_variables(),
  // row-major) unless null. ResidualJacobian() computes the Jacobian at the last evaluation, which returned true. A
  // Jacobian may be not finite nevertheless; FailureReason() may then give the reason.
  virtual int num_residuals() const = 0;
  virtual bool EvaluateResiduals(std::span<const double> z, double* residuals, double* jacobian) = 0;
  virtual void ResidualJacobian(double* jacobian) = 0;

  // Return the parts of z, or the given values of what is no part of it: initial state, control, lengths of the control
  // intervals in s (empty if the final time is not a variable), and parameters.
  virtual std::vector<double> InitialStateAt(std::span<const double> z) const = 0;
  virtual std::vector<double> ControlAt(std::span<const double> z) const = 0;
  virtual std::vector<double> DurationsAt(std::span<const double> z) const = 0;
  virtual std::vector<double> ParametersAt(std::span<const double> /*z*/) const { return {}; }

  // Returns how many gradients have been computed.
  virtual int num_adjoints() const = 0;
};

}  // namespace saltus
