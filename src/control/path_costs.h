// Path costs (running and via terms) of a rollout, for single shooting: their loss, its derivatives, and the same as
// least squares.
//
// In exact dynamics in double precision the integrals are exact; they are cut at impacts and where targets turn. For
// any other model they are the trapezoidal rule on the states after its steps, and via terms interpolate these states
// linearly.
#pragma once

#include <memory>
#include <span>
#include <string>

#include "saltus/simulate/simulator.h"

namespace saltus {

class PathCosts {
 public:
  // Returns null if the scene has no path costs and its final time is fixed.
  static std::unique_ptr<PathCosts> Make(const Simulator& simulator);
  virtual ~PathCosts() = default;

  // To be called after a rollout, which must remain the simulator's last one while the other functions are called.
  // Returns why the costs are not defined; empty if they are.
  virtual std::string Update(const Simulator& simulator, std::span<const double> initial,
                             std::span<const double> control) = 0;
  virtual double Loss() const = 0;
  // Writes the derivatives of all terms, terminal ones included, except the effort: by control (K x C x 2), initial
  // state (B x 4), and final time if all steps scale with it (exact dynamics only). What is empty or null is left out.
  virtual void Gradient(std::span<double> control, std::span<double> initial, double* duration) const = 0;

  // Rows: two for each terminal term first. The sum of all squares is the loss of the terminal terms and Loss().
  virtual int num_residuals() const = 0;
  virtual void Residuals(std::span<double> residuals) const = 0;
  // Sets the derivatives of all rows, with the shapes rows x control, rows x initial state, and rows.
  virtual void Jacobian(std::span<double> control, std::span<double> initial, std::span<double> duration) const = 0;
};

}  // namespace saltus
