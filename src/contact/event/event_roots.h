// When a gap closes: the first zero crossing of a polynomial in time, downwards.
//
// Under constant acceleration the distance of a disc to a plane is a quadratic in time, and the squared distance of two
// discs a quartic (a quadratic if both accelerate alike). None of its zeros may be missed or found twice, so the time
// axis is cut at the extrema, whose cut points in turn come from the derivative: on each piece the polynomial is
// monotone, and the signs at its ends decide. Within a piece: Newton's method, safeguarded by bisection.
#pragma once

#include <array>
#include <limits>

namespace saltus {

// g(s) = sum_k c[k] s^k; s in s. g > 0 apart, g < 0 overlapping.
struct GapPolynomial {
  std::array<double, 5> c{};

  double operator()(double s) const { return c[0] + s * (c[1] + s * (c[2] + s * (c[3] + s * c[4]))); }
};

// g(from + s) as a polynomial in s.
inline GapPolynomial ShiftedTo(GapPolynomial g, double from) {
  for (int k = 0; k < 4; ++k) {
    for (int j = 3; j >= k; --j) g.c[j] += from * g.c[j + 1];
  }
  return g;
}

inline constexpr double kNever = std::numeric_limits<double>::infinity();

// A cheap sufficient test: true only if g > 0 on all of [0, horizon].
inline bool StaysApart(const GapPolynomial& g, double horizon) {
  double least = 0;
  for (int k = 4; k > 0; --k) least = (least + (g.c[k] < 0 ? g.c[k] : 0.0)) * horizon;
  return g.c[0] + least > 0;
}

// The first s in [0, horizon] with g(s) <= 0 and g falling there, kNever if there is none. Where g has a local maximum
// at or below zero, that is the maximum.
// With `ignore_start`, a g that already falls from g(0) <= 0 is let fall until it has turned.
// Precondition: finite coefficients, horizon >= 0.
double FirstClosing(const GapPolynomial& g, double horizon, bool ignore_start = false);

}  // namespace saltus
