// Enclosures of functions of N parameters over a box: a polynomial of degree two and a bound of what it neglects, with
// the rounding errors. Dependencies between quantities cancel up to second order, which they do not in intervals.
//
// Models are computed while the processor rounds upward (see interval.h).
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <vector>

#include "global/interval.h"

namespace saltus::global {

inline constexpr double kUlp = std::numeric_limits<double>::epsilon();  // bounds the relative error of an operation
inline constexpr double kUnderflow = 1e-290;                            // above all errors by underflow in an operation

// With each parameter mapped onto x_j in [-1, 1], the function differs from
//
//   value + sum_j slope_j x_j + sum_{j <= k} curve_jk x_j x_k
//
// by at most `error` in the whole box.
template <int N>
class TaylorModel {
 public:
  static constexpr int kCurves = N * (N + 1) / 2;  // curve_jk row by row, k from j on

  double value = 0;
  std::array<double, N> slope{};
  std::array<double, kCurves> curve{};
  double error = 0;

  TaylorModel() = default;
  explicit TaylorModel(const Interval& constant)
      : value(Middle(constant)), error(Radius(constant, value)), size_(std::abs(value)) {}

  // The parameter j, which is in [low, high].
  static TaylorModel Parameter(int j, double low, double high) {
    const Interval range(low, high);
    TaylorModel model;
    model.value = Middle(range);
    model.slope[j] = Radius(range, model.value);
    model.size_ = std::abs(model.value) + model.slope[j];
    return model;
  }

  TaylorModel& operator+=(const TaylorModel& b) {
    value += b.value;
    for (int j = 0; j < N; ++j) slope[j] += b.slope[j];
    for (int j = 0; j < kCurves; ++j) curve[j] += b.curve[j];
    size_ += b.size_;
    error += b.error + kUlp * size_;
    return *this;
  }
  TaylorModel& operator-=(const TaylorModel& b) {
    value -= b.value;
    for (int j = 0; j < N; ++j) slope[j] -= b.slope[j];
    for (int j = 0; j < kCurves; ++j) curve[j] -= b.curve[j];
    size_ += b.size_;
    error += b.error + kUlp * size_;
    return *this;
  }
  TaylorModel& operator*=(const Interval& factor) {
    const double middle = Middle(factor), radius = Radius(factor, middle), size = std::abs(middle);
    value *= middle;
    for (double& a : slope) a *= middle;
    for (double& a : curve) a *= middle;
    error = (size + radius) * error + (radius + kUlp * size) * size_ + kUnderflow;
    size_ *= size;
    return *this;
  }
  friend TaylorModel operator+(TaylorModel a, const TaylorModel& b) { return a += b; }
  friend TaylorModel operator-(TaylorModel a, const TaylorModel& b) { return a -= b; }
  friend TaylorModel operator*(TaylorModel a, const Interval& b) { return a *= b; }
  friend TaylorModel operator*(const Interval& b, TaylorModel a) { return a *= b; }
  friend TaylorModel operator*(const TaylorModel& a, const TaylorModel& b) {
    TaylorModel out;
    out.value = a.value * b.value;
    for (int j = 0; j < N; ++j) out.slope[j] = a.value * b.slope[j] + b.value * a.slope[j];
    for (int j = 0, at = 0; j < N; ++j) {
      out.curve[at] = a.value * b.curve[at] + b.value * a.curve[at] + a.slope[j] * b.slope[j];
      ++at;
      for (int k = j + 1; k < N; ++k, ++at) {
        out.curve[at] =
            a.value * b.curve[at] + b.value * a.curve[at] + (a.slope[j] * b.slope[k] + a.slope[k] * b.slope[j]);
      }
    }
    const double slope_a = Sum(a.slope), slope_b = Sum(b.slope), curve_a = Sum(a.curve), curve_b = Sum(b.curve);
    const double size_a = std::abs(a.value) + slope_a + curve_a, size_b = std::abs(b.value) + slope_b + curve_b;
    out.size_ = size_a * size_b;
    // The terms of third and fourth order, then the errors of the factors, then rounding: no coefficient of the product
    // goes through more than five operations.
    out.error = slope_a * curve_b + curve_a * slope_b + curve_a * curve_b + a.error * (size_b + b.error) +
                b.error * size_a + 8 * kUlp * out.size_ + kUnderflow;
    return out;
  }

  // Upper bounds of the sum of the absolute values of all coefficients, and of the absolute value of the function.
  double size() const { return std::abs(value) + Sum(slope) + Sum(curve); }
  double Largest() const { return size() + error; }

 private:
  static double Middle(const Interval& a) { return 0.5 * (a.lower() + a.upper()); }
  static double Radius(const Interval& a, double middle) { return std::max(a.upper() - middle, middle - a.lower()); }
  template <std::size_t M>
  static double Sum(const std::array<double, M>& a) {
    double even = 0, odd = 0;
    for (std::size_t i = 0; i + 1 < M; i += 2) {
      even += std::abs(a[i]);
      odd += std::abs(a[i + 1]);
    }
    return M % 2 == 1 ? even + odd + std::abs(a[M - 1]) : even + odd;
  }

  double size_ = 0;  // at least size(): it is not computed again in each sum
};

template <int N>
TaylorModel<N> Square(const TaylorModel<N>& a) {
  return a * a;
}

// With a = value (1 + e), 1 / a differs from (1 - e + e^2) / value by at most |e|^3 / ((1 - |e|) |value|).
template <int N>
TaylorModel<N> Reciprocal(const TaylorModel<N>& a) {
  const Interval inverse = Interval(1.0) / Interval(a.value);
  TaylorModel<N> e = inverse * a;
  e -= TaylorModel<N>(Interval(1.0));
  const double most = e.Largest();
  TaylorModel<N> out = TaylorModel<N>(Interval(1.0)) - e + e * e;
  const double room = -(most - 1);
  out.error = room > 0 ? out.error + most * most * most / room : std::numeric_limits<double>::infinity();
  return inverse * out;
}

// A part of a box: ranges of all x_j.
template <int N>
struct BoxPart {
  std::array<double, N> low, high;
  double least = 0;  // of a function in this part, at least
  int widest = 0;    // the parameter by which the function changes most in it
};

// The time from one impact to the next, which is not negative in motions. Both are parameters.
template <int N>
struct WaitingTime {
  int from = 0, to = 0;
  TaylorModel<N> time;  // linear

  Interval EncloseDifference(const BoxPart<N>& part) const {
    const Interval range[] = {{part.low[from], part.high[from]}, {part.low[to], part.high[to]}};
    return Interval(time.value - time.error, time.value + time.error) + Interval(time.slope[from]) * range[0] +
           Interval(time.slope[to]) * range[1];
  }
};

// Bounds the function from below in that part of the box where no wait is negative.
template <int N>
void BoundPart(const TaylorModel<N>& f, const std::vector<WaitingTime<N>>& waits, BoxPart<N>* part) {
  // The polynomial around the middle of the part. Its coefficients are sums of those of f with factors below 2.
  std::array<double, N> middle, radius, slope = f.slope;
  double value = f.value, least = 0;
  for (int j = 0; j < N; ++j) {
    middle[j] = 0.5 * (part->low[j] + part->high[j]);
    radius[j] = std::max(part->high[j] - middle[j], middle[j] - part->low[j]);
  }
  std::array<double, N> change{};
  for (int j = 0, at = 0; j < N; ++j) {
    value += f.slope[j] * middle[j];
    for (int k = j; k < N; ++k, ++at) {
      const double curve = f.curve[at];
      value += curve * middle[j] * middle[k];
      slope[j] += curve * middle[k];
      slope[k] += curve * middle[j];
      if (k == j) continue;
      const double cross = std::abs(curve) * radius[j] * radius[k];
      least -= cross;
      change[j] += cross;
      change[k] += cross;
    }
  }
  // The function is at least as large as without a multiple of a wait. Its slopes become smaller by that.
  for (const WaitingTime<N>& wait : waits) {
    const double to = wait.time.slope[wait.to], from = -wait.time.slope[wait.from];
    const double multiple = std::min(slope[wait.to] / to, -slope[wait.from] / from);
    if (!(multiple > 0)) continue;
    BoxPart<N> centre = *part;
    centre.low[wait.from] = centre.high[wait.from] = middle[wait.from];
    centre.low[wait.to] = centre.high[wait.to] = middle[wait.to];
    value -= (Interval(multiple) * wait.EncloseDifference(centre)).upper();
    slope[wait.to] -= multiple * to;
    slope[wait.from] += multiple * from;
  }
  for (int j = 0, at = 0; j < N; at += N - j, ++j) {
    // The least of by_one |y| + by_square y^2 with by_one <= 0, |y| <= 1.
    const double by_one = -std::abs(slope[j]) * radius[j], by_square = f.curve[at] * radius[j] * radius[j];
    const bool inside = -by_one < 2 * by_square;
    least += inside ? -by_one * by_one / (4 * by_square) : by_one + by_square;
    change[j] += std::abs(by_one) + std::abs(by_square);
  }
  part->widest = static_cast<int>(std::max_element(change.begin(), change.end()) - change.begin());
  const double rounding = 8 * (N + 2) * (N + 2) * (kUlp * f.size() + kUnderflow);
  part->least = -(f.error + rounding - value - least);
}

}  // namespace saltus::global
