// One step of an explicit Runge-Kutta method of order 8, as a template on the flow.
//
// The method of Cooper and Verner (SIAM J. Numer. Anal. 9, 1972): 11 stages, with coefficients in closed form,
//
//   k_i = f(t + c_i h, X_i),   X_i = x + h sum_{j < i} a_ij k_j,   x' = x + h sum_i b_i k_i.
#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <cstddef>
#include <cstring>
#include <type_traits>
#include <utility>

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

// Calls function(stage, factor) for each term of row kRow.
template <int kRow, typename Function>
[[gnu::always_inline]] inline void ForEachTerm(const Function& function) {
  [&]<std::size_t... k>(std::index_sequence<k...>) __attribute__((always_inline)) {
    (function(kRows[kRow].terms[k].stage, kRows[kRow].terms[k].factor), ...);
  }
  (std::make_index_sequence<kRows[kRow].count>());
}

// Two numbers in one register. The sums below are computed in pairs, as users' builds are without the vectorizer that
// would find them (src/CMakeLists.txt).
using Pair = double __attribute__((vector_size(2 * sizeof(double))));
// Loads one number after the other: the newest slopes were stored so, and a load of both would wait for the cache.
[[gnu::always_inline]] inline Pair LoadPair(const double* from) { return Pair{from[0], from[1]}; }

// out = x + h sum of the slopes of row kRow, which stand one after the other.
template <int kRow, int kSize>
[[gnu::always_inline]] inline void CombineSlopes(double h, const double* x, const double* slopes, double* out) {
  constexpr int kPairs = kSize / 2;
  Pair sums[kPairs + 1] = {};
  double last = 0;
  ForEachTerm<kRow>([&](int stage, double factor) __attribute__((always_inline)) {
    const double* slope = slopes + stage * kSize;
    for (int i = 0; i < kPairs; ++i) sums[i] += factor * LoadPair(slope + 2 * i);
    if (kSize % 2 == 1) last += factor * slope[kSize - 1];
  });
  for (int i = 0; i < kPairs; ++i) {
    const Pair sum = LoadPair(x + 2 * i) + h * sums[i];
    std::memcpy(out + 2 * i, &sum, sizeof(sum));
  }
  if (kSize % 2 == 1) out[kSize - 1] = x[kSize - 1] + h * last;
}
// Combines slopes of a state whose size is known only as the program runs.
inline void CombineSlopes(int row, int size, double h, const double* x, const double* slopes, double* out) {
  for (int i = 0; i < size; ++i) {
    double sum = 0;
    for (int k = 0; k < kRows[row].count; ++k) {
      sum += kRows[row].terms[k].factor * slopes[kRows[row].terms[k].stage * size + i];
    }
    out[i] = x[i] + h * sum;
  }
}

}  // namespace cooper_verner

// The point at which the functions of a hybrid system are evaluated.
struct ModePoint {
  int mode = 0;
  double t = 0;
  const double* x = nullptr;  // state of the mode
  const double* u = nullptr;  // control
  const double* p = nullptr;  // parameters
  // Whether derivatives by the parameters are asked for. Otherwise the columns of these are not to be read.
  bool by_parameters = true;
};

// The beginning of a step and its length, s.
struct FlowStep : ModePoint {
  double h = 0;
  // Whether the state after a step is put onto the equations of the mode (HybridFunctions::Project).
  bool projects = false;
};

// Evaluates x' and the slope there by flow(t, X, k), given k_0.
template <int kSize, typename Flow>
void EvaluateStep(const FlowStep& step, const Flow& flow, const double* slope, double* after, double* slope_after) {
  using namespace cooper_verner;
  double x[kSize], stage[kSize], slopes[kStages * kSize];
  std::copy_n(step.x, kSize, x);
  std::copy_n(slope, kSize, slopes);
  [&]<std::size_t... i>(std::index_sequence<i...>) __attribute__((always_inline)) {
    ((CombineSlopes<i + 1, kSize>(step.h, x, slopes, stage),
      flow(step.t + kC[i + 1] * step.h, stage, slopes + (i + 1) * kSize)),
     ...);
  }
  (std::make_index_sequence<kStages - 1>());
  CombineSlopes<kStages, kSize>(step.h, x, slopes, after);
  flow(step.t + step.h, after, slope_after);
}

// Evaluates all k_i and the Jacobians of f at the stages, `stride` numbers or Jets each, by flow(t, X, k, jacobian).
template <int kSize, typename FlowJacobian, typename Number>
void LinearizeStep(const FlowStep& step, std::size_t stride, const FlowJacobian& flow, double* slopes,
                   Number* jacobians) {
  using namespace cooper_verner;
  double stage[kSize];
  [&]<std::size_t... i>(std::index_sequence<i...>) __attribute__((always_inline)) {
    ((CombineSlopes<i, kSize>(step.h, step.x, slopes, stage),
      flow(step.t + kC[i] * step.h, stage, slopes + i * kSize, jacobians + i * stride)),
     ...);
  }
  (std::make_index_sequence<kStages>());
}

// The derivatives of a function by all inputs of a step (a cotangent).
struct StepCotangent {
  double* x;      // overwritten
  double t, h;    // overwritten
  double *p, *u;  // added to
};

// Computes the vector-Jacobian product of a cotangent of x', given the Jets of the slopes of all stages, one after the
// other, with derivatives by [x t p u]. `after` and out->x may be the same.
template <int kSize, int kParameters, int kControls, typename Jet>
void PullBackStages(double h, const Jet* slopes, const double* after, StepCotangent* out) {
  using namespace cooper_verner;
  using Variables = std::decay_t<decltype(slopes->v)>;
  double of_slopes[kStages][kSize] = {};  // divided by h
  // Adds the cotangent of x + h sum of the slopes of a row.
  const auto add = [&](const Variables& cotangent) __attribute__((always_inline)) {
    return [&](int stage, double factor) __attribute__((always_inline)) {
      for (int j = 0; j < kSize; ++j) of_slopes[stage][j] += factor * cotangent[j];
    };
  };
  Variables sum = Variables::Zero();  // Jets may be wider than [x t p u]
  for (int j = 0; j < kSize; ++j) sum[j] = after[j];
  for (int j = 0; j < kParameters; ++j) sum[kSize + 1 + j] = out->p[j];
  for (int j = 0; j < kControls; ++j) sum[kSize + 1 + kParameters + j] = out->u[j];
  ForEachTerm<kStages>(add(sum));
  double by_h = 0;
  const auto pull_back = [&]<std::size_t kStage>(std::integral_constant<std::size_t, kStage>)
      __attribute__((always_inline)) {
    const Jet* slope = slopes + kStage * kSize;
    const double* of_slope = of_slopes[kStage];
    Variables of_stage = (h * of_slope[0]) * slope[0].v;
    by_h += of_slope[0] * slope[0].a;
    for (int row = 1; row < kSize; ++row) {
      of_stage += (h * of_slope[row]) * slope[row].v;
      by_h += of_slope[row] * slope[row].a;
    }
    if constexpr (kC[kStage] != 0) by_h += kC[kStage] * of_stage[kSize];  // which may be infinite at the start
    sum += of_stage;
    ForEachTerm<kStage>(add(of_stage));
  };
  [&]<std::size_t... k>(std::index_sequence<k...>) __attribute__((always_inline)) {
    (pull_back(std::integral_constant<std::size_t, kStages - 1 - k>()), ...);
  }
  (std::make_index_sequence<kStages>());
  for (int j = 0; j < kSize; ++j) out->x[j] = sum[j];
  out->t = sum[kSize];
  out->h = by_h;
  for (int j = 0; j < kParameters; ++j) out->p[j] = sum[kSize + 1 + j];
  for (int j = 0; j < kControls; ++j) out->u[j] = sum[kSize + 1 + kParameters + j];
}

}  // namespace saltus
