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
#include <array>
#include <vector>

#include "saltus/internal/hybrid_functions.h"

namespace saltus {

namespace cooper_verner {

inline constexpr int kStages = 11;
inline constexpr double kRoot21 = 4.58257569495584000658804719372800849;

inline constexpr double kA[kStages][kStages] = {
    {},
    {1.0 / 2},
    {1.0 / 4, 1.0 / 4},
    {1.0 / 7, (-7 - 3 * kRoot21) / 98, (21 + 5 * kRoot21) / 49},
    {(11 + kRoot21) / 84, 0, (18 + 4 * kRoot21) / 63, (21 - kRoot21) / 252},
    {(5 + kRoot21) / 48, 0, (9 + kRoot21) / 36, (-231 + 14 * kRoot21) / 360, (63 - 7 * kRoot21) / 80},
    {(10 - kRoot21) / 42,
     0,
     (-432 + 92 * kRoot21) / 315,
     (633 - 145 * kRoot21) / 90,
     (-504 + 115 * kRoot21) / 70,
     (63 - 13 * kRoot21) / 35},
    {1.0 / 14, 0, 0, 0, (14 - 3 * kRoot21) / 126, (13 - 3 * kRoot21) / 63, 1.0 / 9},
    {1.0 / 32, 0, 0, 0, (91 - 21 * kRoot21) / 576, 11.0 / 72, (-385 - 75 * kRoot21) / 1152, (63 + 13 * kRoot21) / 128},
    {1.0 / 14,
     0,
     0,
     0,
     1.0 / 9,
     (-733 - 147 * kRoot21) / 2205,
     (515 + 111 * kRoot21) / 504,
     (-51 - 11 * kRoot21) / 56,
     (132 + 28 * kRoot21) / 245},
    {0,
     0,
     0,
     0,
     (-42 + 7 * kRoot21) / 18,
     (-18 + 28 * kRoot21) / 45,
     (-273 - 53 * kRoot21) / 72,
     (301 + 53 * kRoot21) / 72,
     (28 - 28 * kRoot21) / 45,
     (49 - 7 * kRoot21) / 18}};
inline constexpr double kB[kStages] = {1.0 / 20, 0, 0, 0, 0, 0, 0, 49.0 / 180, 16.0 / 45, 49.0 / 180, 1.0 / 20};
inline constexpr double kC[kStages] = {0,
                                       0.5,
                                       0.5,
                                       (7 + kRoot21) / 14,
                                       (7 + kRoot21) / 14,
                                       0.5,
                                       (7 - kRoot21) / 14,
                                       (7 - kRoot21) / 14,
                                       0.5,
                                       (7 + kRoot21) / 14,
                                       1};

// The coefficients that are not zero: those of b as row kStages.
struct Term {
  int stage;
  double factor;
};
struct Row {
  int count = 0;
  std::array<Term, kStages> terms{};
};
constexpr std::array<Row, kStages + 1> MakeRows() {
  std::array<Row, kStages + 1> rows{};
  for (int i = 0; i <= kStages; ++i) {
    for (int j = 0; j < kStages; ++j) {
      const double factor = i < kStages ? kA[i][j] : kB[j];
      if (factor != 0) rows[i].terms[rows[i].count++] = {j, factor};
    }
  }
  return rows;
}
inline constexpr std::array<Row, kStages + 1> kRows = MakeRows();

}  // namespace cooper_verner

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
  static constexpr int kStages = cooper_verner::kStages;
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
  template <int kSize>
  void PullBackOfSize(const double* after, Cotangent* out) const;

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
