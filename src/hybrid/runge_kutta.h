// One step of the Runge-Kutta method of saltus/internal/runge_kutta_step.h for the flow of a mode, and its derivatives.
//
// Derivatives are those of the step itself, not of the flow that it approximates: with the Jacobians of f at the
// stages, dk_i = f_x dX_i + f_t dt_i + f_p dp + f_u du. The two differ by the error of the step.
#pragma once

#include <Eigen/Core>
#include <vector>

#include "saltus/internal/hybrid_functions.h"

namespace saltus {

class RungeKutta {
 public:
  static constexpr int kStages = cooper_verner::kStages;
  static constexpr int kOrder = 8;

  explicit RungeKutta(const HybridFunctions& functions);

  // The state after the step, before it is projected, and the slope there. `slope` is f(t, x).
  void Step(const FlowStep& step, const double* slope, double* after, double* slope_after);
  // The state alone, projected, with no slope given.
  void Step(const FlowStep& step, double* after);

  // Pulls a cotangent of x' back. `after` and out->x may be the same.
  void PullBack(const FlowStep& step, const double* after, StepCotangent* out);

  // Evaluates the stages of a step with their Jacobians; the functions below are of that step.
  void Linearize(const FlowStep& step);
  // The derivative of x' by h, of a step that is not projected.
  void ByLength(double* derivative) const;

  // The derivative of x' in D directions, given those of what it depends on: x, p, u have a column each direction, t
  // and h are rows.
  using Matrix = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;
  struct Tangent {
    Matrix x;                 // n x D
    Eigen::RowVectorXd t, h;  // D
    Matrix p, u;              // P x D, m x D
  };
  Matrix PushForward(const Tangent& in) const;
  // The derivative of x' by [x t p u h]; linearizes the step.
  Matrix Jacobian(const FlowStep& step);

 private:
  using ConstMatrixMap = Eigen::Map<const Matrix>;
  ConstMatrixMap JacobianOfStage(int stage) const;
  template <int kSize>
  void PullBackOfSize(const double* after, StepCotangent* out) const;

  const HybridFunctions& functions_;
  int num_parameters_, num_controls_;
  int size_ = 0;  // of the state, in the last Linearize
  double length_ = 0;
  bool projects_ = false;
  mutable std::vector<double> scratch_;  // of a step
  std::vector<double> slopes_;           // k_i, one after the other
  std::vector<double> jacobians_;        // of f at the stages
  std::vector<double> projection_;       // its derivative by [x t p]
};

}  // namespace saltus
