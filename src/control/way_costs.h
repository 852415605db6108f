// Running and via terms of a rollout, for single shooting: their loss, its derivatives, and the same as least squares.
//
// In exact dynamics in double precision integrals are exact, cut at impacts and where targets turn. Of any other model
// they are those of its own steps: the trapezoidal rule on its states, which are also what via terms read, linear
// between two of them.
#pragma once

#include <memory>
#include <span>
#include <string>
#include <vector>

#include "saltus/simulate/simulator.h"

namespace saltus {

class WayCosts {
 public:
  // Null if the scene has no such terms and its final time is fixed.
  static std::unique_ptr<WayCosts> Make(const Simulator& simulator);
  virtual ~WayCosts() = default;

  // After a rollout, which stays the simulator's last one as long as this is used. Returns why there are none.
  virtual std::string Update(const Simulator& simulator, std::span<const double> initial,
                             std::span<const double> control) = 0;
  virtual double Loss() const = 0;
  // Derivatives of all terms, terminal ones too, but for the effort: by control (K x C x 2), initial state (B x 4), and
  // the final time if all steps scale with it (exact dynamics only). Overwritten; left out where empty or null.
  virtual void Gradient(std::span<double> control, std::span<double> initial, double* duration) const = 0;

  // Terminal rows first, two a term; the sum of their squares is the loss of those terms and Loss().
  virtual int num_residuals() const = 0;
  virtual void Residuals(std::span<double> residuals) const = 0;
  // Derivatives of all rows, each as those of Gradient: rows x control, rows x initial state, rows.
  virtual void Jacobian(std::span<double> control, std::span<double> initial, std::span<double> duration) const = 0;
};

}  // namespace saltus
