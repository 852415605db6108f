// A loss as a function of decision variables, states eliminated by simulation: what solvers by single shooting
// minimise, whatever is simulated.
#pragma once

#include <span>
#include <string>
#include <vector>

namespace saltus {

class ShootingFunction {
 public:
  virtual ~ShootingFunction() = default;

  virtual int num_variables() const = 0;
  virtual const std::vector<double>& initial_guess() const = 0;

  // The loss at z, and its gradient (num_variables() numbers) unless null. False if the motion or the loss is not
  // finite or does not exist, or if it was stopped.
  virtual bool Evaluate(std::span<const double> z, double* loss, double* gradient) = 0;
  // Why the last evaluation returned false; empty if it did not, or was stopped.
  virtual std::string WhyFailed() const = 0;
  virtual bool stopped() const = 0;

  // The loss as a sum of squares (without a half) of num_residuals() numbers, to which a solver may add others that it
  // knows; and their Jacobian by z where the last evaluation has been, which returned true (row-major). A
  // Jacobian may be not finite even so; WhyFailed() may then say why.
  virtual int num_residuals() const = 0;
  virtual bool EvaluateResiduals(std::span<const double> z, double* residuals, double* jacobian) = 0;
  virtual void ResidualJacobian(double* jacobian) = 0;

  // The data in z: initial state, control, lengths of the control intervals (empty if the final time is given), and
  // parameters of a hybrid system.
  virtual std::vector<double> InitialStateAt(std::span<const double> z) const = 0;
  virtual std::vector<double> ControlAt(std::span<const double> z) const = 0;
  virtual std::vector<double> DurationsAt(std::span<const double> z) const = 0;
  virtual std::vector<double> ParametersAt(std::span<const double> /*z*/) const { return {}; }

  // How many gradients have been computed.
  virtual int num_adjoints() const = 0;
};

}  // namespace saltus
