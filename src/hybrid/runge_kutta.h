// One step of an explicit Runge-Kutta method of order 8 for the flow of a mode, and its derivatives.
//
// The method of Cooper and Verner (SIAM J. Numer. Anal. 9, 1972): 11 stages, with coefficients in closed form,
//
//   k_i = f(t + c_i h, X_i),   X_i = x + h sum_{j < i} a_ij k_j,   x' = x + h sum_i b_i k_i.
//
// Derivatives are those of the step itself, not of the flow that it approximates: with the Jacobians of f at the
// stages, dk_i = f_x dX_i + f_t dt_i + f_p dp + f_u du. The two differ by the error of the step.
#pragma once

#include <Eigen/Core>
#include <vector>

#include "saltus/internal/hybrid_functions.h"

namespace saltus {

// Where a step begins and how long it is.
struct FlowStep {
  int mode = 0;
  double t = 0, h = 0;
  const double* x = nullptr;  // state of the mode
  const double* u = nullptr;  // control
  const double* p = nullptr;  // parameters
};

class RungeKutta {
 public:
  static constexpr int kStages = 11;
  static constexpr int kOrder = 8;

  explicit RungeKutta(const HybridFunctions& functions);

  // The state after the step. `slope` is f(t, x).
  void Step(const FlowStep& step, const double* slope, double* after);

  // Evaluates the stages of a step with their Jacobians; the functions below are of that step.
  void Linearize(const FlowStep& step);
  // The derivative of x' by h.
  void ByLength(double* derivative) const;

  // A cotangent of all that a step depends on.
  struct Cotangent {
    double* x;      // overwritten
    double t, h;    // overwritten
    double *p, *u;  // added to
  };
  // Pulls a cotangent of x' back. `after` and out->x may be the same.
  void PullBack(const double* after, Cotangent* out) const;

  // The derivative of x' in D directions, given those of what it depends on: x, p, u have a column each direction, t
  // and h are rows.
  using Matrix = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;
  struct Tangent {
    Matrix x;                 // n x D
    Eigen::RowVectorXd t, h;  // D
    Matrix p, u;              // P x D, m x D
  };
  Matrix PushForward(const Tangent& in) const;

 private:
  using ConstMatrixMap = Eigen::Map<const Matrix>;
  ConstMatrixMap JacobianOfStage(int stage) const;

  const HybridFunctions& functions_;
  int num_parameters_, num_controls_;
  int size_ = 0;  // of the state, in the last Linearize
  double length_ = 0;
  std::vector<double> stage_;                 // X_i
  std::vector<double> slopes_;                // k_i, one after the other
  std::vector<double> jacobians_;             // of f at the stages
  mutable std::vector<double> cotangents_;    // of k_i
  mutable std::vector<double> of_variables_;  // a cotangent of [x t p u] of a stage
};

}  // namespace saltus
