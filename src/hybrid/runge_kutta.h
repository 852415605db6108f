// One step of the Runge-Kutta method of saltus/internal/runge_kutta_step.h for the flow of a mode, or of the closed
// form that the system has of it (HybridFunctions::Fly), and its derivatives.
//
// Derivatives are those of the step itself, not of the flow that it approximates: with the Jacobians of f at the
// stages, dk_i = f_x dX_i + f_t dt_i + f_p dp + f_u du. The two differ by the error of the step.
#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <type_traits>
#include <vector>

#include "saltus/internal/hybrid_functions.h"

namespace saltus {

namespace cooper_verner {

// The coefficients by columns: in which rows the slope of a stage stands, the last row first.
constexpr std::array<Row, kStages> MakeColumns() {
  std::array<Row, kStages> columns{};
  for (int row = kStages; row >= 0; --row) {
    for (int k = 0; k < kRows[row].count; ++k) {
      Row& column = columns[kRows[row].terms[k].stage];
      column.terms[column.count++] = {row, kRows[row].terms[k].factor};
    }
  }
  return columns;
}
inline constexpr std::array<Row, kStages> kColumns = MakeColumns();

}  // namespace cooper_verner

// Calls function(size) with the size of the state as a constant if it is small, else with 0.
template <int kFrom = 1, typename Function>
void DispatchSize(int size, const Function& function) {
  constexpr int kMost = 6;
  if (size == kFrom) return function(std::integral_constant<int, kFrom>());
  if constexpr (kFrom < kMost) return DispatchSize<kFrom + 1>(size, function);
  function(std::integral_constant<int, 0>());
}

// EvaluateStep() and LinearizeStep() of runge_kutta_step.h for a state of `size` numbers. `scratch` has room for the
// slopes of all stages and a state. Where the size is small, the flow gets the state as an array of that size.
template <typename Flow>
void EvaluateStep(int size, const FlowStep& step, const Flow& flow, const double* slope, double* scratch, double* after,
                  double* slope_after) {
  using namespace cooper_verner;
  DispatchSize(size, [&](auto known) {
    if constexpr (known > 0) return EvaluateStep<known>(step, flow, slope, after, slope_after);
    double *slopes = scratch, *stage = scratch + kStages * size;
    std::copy_n(slope, size, slopes);
    for (int i = 1; i < kStages; ++i) {
      CombineSlopes(i, size, step.h, step.x, slopes, stage);
      flow(step.t + kC[i] * step.h, stage, slopes + i * size);
    }
    CombineSlopes(kStages, size, step.h, step.x, slopes, after);
    flow(step.t + step.h, after, slope_after);
  });
}
template <typename FlowJacobian>
void LinearizeStep(int size, const FlowStep& step, std::size_t stride, const FlowJacobian& flow, double* scratch,
                   double* slopes, double* jacobians) {
  using namespace cooper_verner;
  DispatchSize(size, [&](auto known) {
    if constexpr (known > 0) return LinearizeStep<known>(step, stride, flow, slopes, jacobians);
    for (int i = 0; i < kStages; ++i) {
      CombineSlopes(i, size, step.h, step.x, slopes, scratch);
      flow(step.t + kC[i] * step.h, scratch, slopes + i * size, jacobians + i * stride);
    }
  });
}

// Pulls a cotangent of x' back through the stages of a step of length h, whose slopes are given. multiply(stage,
// of_slope, of_stage) sets of_stage, by [x t p u], to the product of of_slope and the Jacobian of the flow at a stage.
// `after` and out->x may be the same; `scratch` has room for the slopes of all stages, a state and [x t p u].
template <int kSize, typename Multiply>
void PullBackThroughStages(int size, int num_parameters, int num_controls, double h, const double* slopes,
                           const Multiply& multiply, double* scratch, const double* after, StepCotangent* out) {
  using namespace cooper_verner;
  const int n = kSize > 0 ? kSize : size;
  // Cotangents of the sums of rows 1 to kStages, of the slope of a stage, and of all that it depends on.
  double *of_rows = scratch, *of_slope = of_rows + kStages * n, *of_stage = of_slope + n;
  double known[kSize > 0 ? kSize : 1];
  double* sum = kSize > 0 ? known : of_slope;
  std::copy_n(after, n, of_rows + (kStages - 1) * n);
  if (out->x != after) std::copy_n(after, n, out->x);
  double by_t = 0, by_h = 0;
  for (int i = kStages - 1; i >= 0; --i) {
    for (int j = 0; j < n; ++j) sum[j] = 0;
    for (int k = 0; k < kColumns[i].count; ++k) {
      const Term& term = kColumns[i].terms[k];
      const double* of_row = of_rows + (term.stage - 1) * n;
      for (int j = 0; j < n; ++j) sum[j] += term.factor * of_row[j];
    }
    for (int j = 0; j < n; ++j) {
      by_h += sum[j] * slopes[i * n + j];
      of_slope[j] = sum[j] * h;
    }
    multiply(i, of_slope, of_stage);
    for (int j = 0; j < n; ++j) {
      out->x[j] += of_stage[j];
      if (i > 0) of_rows[(i - 1) * n + j] = of_stage[j];
    }
    by_t += of_stage[n];
    if (kC[i] != 0) by_h += kC[i] * of_stage[n];  // which may be infinite at the start
    for (int j = 0; j < num_parameters; ++j) out->p[j] += of_stage[n + 1 + j];
    for (int j = 0; j < num_controls; ++j) out->u[j] += of_stage[n + 1 + num_parameters + j];
  }
  out->t = by_t;
  out->h = by_h;
}

class RungeKutta {
 public:
  static constexpr int kStages = cooper_verner::kStages;

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
  void LengthDerivative(double* derivative) const;
  // Whether all derivatives that Linearize has evaluated are finite. If not, finds the first of a stage (0 for a closed
  // form) that is none: of a component by [x t p u]; the component is -1 for one of the projection.
  bool IsFinite(int* stage, int* component, int* column) const;

  // The derivative of x' in D directions, given those of what it depends on: x, p, u have a column each direction, t
  // and h are rows.
  using Matrix = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;
  struct Tangent {
    Matrix x;                 // n x D
    Eigen::RowVectorXd t, h;  // D
    Matrix p, u;              // P x D, m x D
  };
  Matrix PushForward(const Tangent& in) const;
  // The derivative of x', projected, by [x t p u h]; linearizes the step. Unless `after` is null, it is set to x'.
  Matrix Jacobian(const FlowStep& step, double* after = nullptr);

 private:
  using ConstMatrixMap = Eigen::Map<const Matrix>;
  ConstMatrixMap JacobianOfStage(int stage) const;

  const HybridFunctions& functions_;
  int num_parameters_, num_controls_;
  int size_ = 0;  // of the state, in the last Linearize
  double length_ = 0;
  bool projects_ = false;
  bool flies_ = false;                   // by a closed form: slopes_ is the flow after the step, jacobians_ that of x'
  mutable std::vector<double> scratch_;  // of a step
  std::vector<double> slopes_;           // k_i, one after the other
  std::vector<double> jacobians_;        // of f at the stages
  std::vector<double> projection_;       // its derivative by [x t p]
};

}  // namespace saltus
