#include "hybrid/runge_kutta.h"

#include <algorithm>
#include <array>

namespace saltus {
namespace {

constexpr int kStages = RungeKutta::kStages;
constexpr double kRoot21 = 4.58257569495584000658804719372800849;

constexpr double kA[kStages][kStages] = {
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
constexpr double kB[kStages] = {1.0 / 20, 0, 0, 0, 0, 0, 0, 49.0 / 180, 16.0 / 45, 49.0 / 180, 1.0 / 20};
constexpr double kC[kStages] = {0,
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
constexpr std::array<Row, kStages + 1> kRows = MakeRows();

// out = x + h sum of the row's slopes. kSize: the size of the state if the compiler shall know it, else 0.
template <int kSize>
inline void Combine(const Row& row, int size, double h, const double* x, const double* slopes, double* out) {
  const int n = kSize > 0 ? kSize : size;
  if constexpr (kSize > 0) {
    double sum[kSize] = {};
    for (int k = 0; k < row.count; ++k) {
      const double* slope = slopes + row.terms[k].stage * kSize;
      for (int i = 0; i < kSize; ++i) sum[i] += row.terms[k].factor * slope[i];
    }
    for (int i = 0; i < kSize; ++i) out[i] = x[i] + h * sum[i];
  } else {
    for (int i = 0; i < n; ++i) {
      double sum = 0;
      for (int k = 0; k < row.count; ++k) sum += row.terms[k].factor * slopes[row.terms[k].stage * n + i];
      out[i] = x[i] + h * sum;
    }
  }
}

template <int kSize>
void StepOfSize(const HybridFunctions& f, const FlowStep& step, int size, double* slopes, double* stage,
                double* after) {
  const int n = kSize > 0 ? kSize : size;
  for (int i = 1; i < kStages; ++i) {
    Combine<kSize>(kRows[i], n, step.h, step.x, slopes, stage);
    f.Flow(step.mode, step.t + kC[i] * step.h, stage, step.u, step.p, slopes + i * n);
  }
  Combine<kSize>(kRows[kStages], n, step.h, step.x, slopes, after);
}

}  // namespace

RungeKutta::RungeKutta(const HybridFunctions& functions)
    : functions_(functions),
      num_parameters_(functions.layout().num_parameters),
      num_controls_(functions.layout().num_controls) {
  const int most = functions.most_states();
  stage_.resize(most);
  slopes_.resize(kStages * most);
  cotangents_.resize(kStages * most);
  of_variables_.resize(most + 1 + num_parameters_ + num_controls_);
  jacobians_.resize(kStages * most * (most + 1 + num_parameters_ + num_controls_));
}

void RungeKutta::Step(const FlowStep& step, const double* slope, double* after) {
  const int n = functions_.state_size(step.mode);
  double *slopes = slopes_.data(), *stage = stage_.data();
  std::copy_n(slope, n, slopes);
  switch (n) {
    case 1:
      return StepOfSize<1>(functions_, step, n, slopes, stage, after);
    case 2:
      return StepOfSize<2>(functions_, step, n, slopes, stage, after);
    case 3:
      return StepOfSize<3>(functions_, step, n, slopes, stage, after);
    case 4:
      return StepOfSize<4>(functions_, step, n, slopes, stage, after);
    case 5:
      return StepOfSize<5>(functions_, step, n, slopes, stage, after);
    case 6:
      return StepOfSize<6>(functions_, step, n, slopes, stage, after);
    default:
      return StepOfSize<0>(functions_, step, n, slopes, stage, after);
  }
}

RungeKutta::ConstMatrixMap RungeKutta::JacobianOfStage(int stage) const {
  const int columns = size_ + 1 + num_parameters_ + num_controls_;
  return ConstMatrixMap(&jacobians_[static_cast<std::size_t>(stage) * size_ * columns], size_, columns);
}

void RungeKutta::Linearize(const FlowStep& step) {
  size_ = functions_.state_size(step.mode);
  length_ = step.h;
  for (int i = 0; i < kStages; ++i) {
    Combine<0>(kRows[i], size_, step.h, step.x, slopes_.data(), stage_.data());
    functions_.FlowJacobian(step.mode,
                            step.t + kC[i] * step.h,
                            stage_.data(),
                            step.u,
                            step.p,
                            &slopes_[i * size_],
                            const_cast<double*>(JacobianOfStage(i).data()));
  }
}

void RungeKutta::ByLength(double* derivative) const {
  // dX_i/dh = sum a_ij (k_j + h dk_j/dh): cotangents_ holds k_j + h dk_j/dh.
  double* total = cotangents_.data();
  Eigen::VectorXd by_length(size_);
  for (int i = 0; i <= kStages; ++i) {
    by_length.setZero();
    for (int k = 0; k < kRows[i].count; ++k) {
      const Term& term = kRows[i].terms[k];
      by_length += term.factor * Eigen::Map<const Eigen::VectorXd>(total + term.stage * size_, size_);
    }
    if (i == kStages) break;
    const ConstMatrixMap jacobian = JacobianOfStage(i);
    Eigen::Map<Eigen::VectorXd>(total + i * size_, size_) =
        Eigen::Map<const Eigen::VectorXd>(&slopes_[i * size_], size_) +
        length_ * (jacobian.leftCols(size_) * by_length + kC[i] * jacobian.col(size_));
  }
  std::copy_n(by_length.data(), size_, derivative);
}

void RungeKutta::PullBack(const double* after, Cotangent* out) const {
  const int n = size_, columns = n + 1 + num_parameters_ + num_controls_;
  double* of_slopes = cotangents_.data();
  out->t = out->h = 0;
  std::fill_n(of_slopes, kStages * n, 0.0);
  // Adds the cotangent of x + h sum of the row's slopes.
  const auto add = [&](const Row& row, const double* cotangent) {
    for (int k = 0; k < row.count; ++k) {
      const Term& term = row.terms[k];
      const double* slope = &slopes_[term.stage * n];
      double *of_slope = of_slopes + term.stage * n, dot = 0;
      for (int j = 0; j < n; ++j) {
        dot += cotangent[j] * slope[j];
        of_slope[j] += length_ * term.factor * cotangent[j];
      }
      out->h += term.factor * dot;
    }
  };
  add(kRows[kStages], after);
  if (out->x != after) std::copy_n(after, n, out->x);
  double* of_stage = of_variables_.data();
  for (int i = kStages - 1; i >= 0; --i) {
    const double* jacobian = &jacobians_[static_cast<std::size_t>(i) * n * columns];
    const double* of_slope = of_slopes + i * n;
    std::fill_n(of_stage, columns, 0.0);
    for (int row = 0; row < n; ++row) {
      for (int column = 0; column < columns; ++column)
        of_stage[column] += of_slope[row] * jacobian[row * columns + column];
    }
    for (int j = 0; j < n; ++j) out->x[j] += of_stage[j];
    out->t += of_stage[n];
    out->h += kC[i] * of_stage[n];
    for (int j = 0; j < num_parameters_; ++j) out->p[j] += of_stage[n + 1 + j];
    for (int j = 0; j < num_controls_; ++j) out->u[j] += of_stage[n + 1 + num_parameters_ + j];
    add(kRows[i], of_stage);
  }
}

RungeKutta::Matrix RungeKutta::PushForward(const Tangent& in) const {
  const int n = size_;
  std::array<Matrix, kStages> total;  // (k_i dh + h dk_i)
  const auto combine = [&](const Row& row) {
    Matrix out = in.x;
    for (int k = 0; k < row.count; ++k) out += row.terms[k].factor * total[row.terms[k].stage];
    return out;
  };
  for (int i = 0; i < kStages; ++i) {
    const ConstMatrixMap jacobian = JacobianOfStage(i);
    total[i] = jacobian.leftCols(n) * combine(kRows[i]) + jacobian.col(n) * (in.t + kC[i] * in.h) +
               jacobian.middleCols(n + 1, num_parameters_) * in.p + jacobian.rightCols(num_controls_) * in.u;
    total[i] = Eigen::Map<const Eigen::VectorXd>(&slopes_[i * n], n) * in.h + length_ * total[i];
  }
  return combine(kRows[kStages]);
}

}  // namespace saltus
