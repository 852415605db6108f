// The time at which a gap closes: the first downward zero crossing of a polynomial in time.
//
// Under constant acceleration the distance of a disc to a plane is a quadratic in time, and the squared distance of two
// discs a quartic (a quadratic if both accelerate alike); of discs that roll, of degree 5 and 10. None of its zeros may
// be missed or found twice, so the time axis is cut at the extrema, whose cut points in turn come from the derivative:
// on each piece the polynomial is monotone, and the signs at its ends decide. Within a piece: Newton's method,
// safeguarded by bisection.
#pragma once

#include <array>
#include <cmath>
#include <limits>

namespace saltus {

// g(s) = sum_k c[k] s^k; s in s. g > 0 apart, g < 0 overlapping. Coefficients beyond `degree` are zero.
struct GapPolynomial {
  static constexpr int kLargestDegree = 10;
  std::array<double, kLargestDegree + 1> c{};
  int degree = 4;

  double operator()(double s) const {
    double sum = c[degree];
    for (int k = degree - 1; k >= 0; --k) sum = c[k] + s * sum;
    return sum;
  }
};

// g(from + s) as a polynomial in s.
inline GapPolynomial ShiftedTo(GapPolynomial g, double from) {
  for (int k = 0; k < g.degree; ++k) {
    for (int j = g.degree - 1; j >= k; --j) g.c[j] += from * g.c[j + 1];
  }
  return g;
}

inline constexpr double kNever = std::numeric_limits<double>::infinity();

// Whether g > 0 on all of [0, horizon], by a cheap test that is sufficient but not necessary.
inline bool StaysApart(const GapPolynomial& g, double horizon) {
  double least = 0;
  for (int k = g.degree; k > 0; --k) least = (least + (g.c[k] < 0 ? g.c[k] : 0.0)) * horizon;
  return g.c[0] + least > 0;
}

// Returns a zero of a function between two arguments at which it has opposite signs, to rounding or with a magnitude of
// at most `tolerance` (Illinois method). The last call of the function is at the zero that is returned.
template <typename Function>
double FindZero(double low, double at_low, double high, double at_high, double tolerance, const Function& function) {
  constexpr int kMostIterations = 100;
  double s = high;
  for (int iteration = 0; iteration < kMostIterations; ++iteration) {
    s = low + (high - low) * (at_low / (at_low - at_high));
    const double value = function(s);
    if (std::abs(value) <= tolerance || s == low || s == high) break;
    if ((value > 0) == (at_high > 0)) {
      at_low *= 0.5;
    } else {
      low = high;
      at_low = at_high;
    }
    high = s;
    at_high = value;
  }
  return s;
}

// Returns the first s in [0, horizon] with g(s) <= 0 at which g falls, kNever if there is none. A local maximum of g at
// or below zero counts as such an s. With `ignore_start`, a g that already falls from g(0) <= 0 may go on falling
// until it has turned.
// Precondition: finite coefficients, horizon >= 0.
double FirstClosing(const GapPolynomial& g, double horizon, bool ignore_start = false);

}  // namespace saltus
