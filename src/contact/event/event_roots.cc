#include "contact/event/event_roots.h"

#include <algorithm>
#include <cmath>

namespace saltus {
namespace {

// Returns b^2 - 4 a c with the rounding error of the product corrected by fma (Kahan).
double Discriminant(double a, double b, double c) {
  const double product = 4 * a * c;
  const double error = std::fma(4 * a, c, -product);
  return std::fma(b, b, -product) - error;
}

// Returns the first s in [0, horizon] at which c + b s + a s^2 closes, kNever if there is none.
double FirstClosingOfQuadratic(double a, double b, double c, double horizon, bool ignore_start) {
  double s = kNever;
  if (c > 0) {
    if (b >= 0 && a >= 0) return kNever;
    const double discriminant = Discriminant(a, b, c);
    if (discriminant < 0) return kNever;
    const double root = std::sqrt(discriminant);
    s = b < 0 ? 2 * c / (root - b) : (-b - root) / (2 * a);
  } else if (!ignore_start && (b < 0 || (b == 0 && a < 0))) {
    return 0;
  } else if (b > 0 && a < 0) {
    s = (-b - std::sqrt(std::max(Discriminant(a, b, c), 0.0))) / (2 * a);
  }
  return s <= horizon ? s : kNever;
}

struct Roots {
  std::array<double, GapPolynomial::kLargestDegree> s;
  int count = 0;
};

double Evaluate(const double* c, int degree, double s) {
  double sum = c[degree];
  for (int k = degree - 1; k >= 0; --k) sum = sum * s + c[k];
  return sum;
}

double EvaluateDerivative(const double* c, int degree, double s) {
  double sum = degree * c[degree];
  for (int k = degree - 1; k > 0; --k) sum = sum * s + k * c[k];
  return sum;
}

// Returns the zero of a polynomial that is monotone on [low, high] and has opposite signs at the ends.
double RootOfPiece(const double* c, int degree, double low, double high) {
  const bool falling = Evaluate(c, degree, low) > 0;
  double s = 0.5 * (low + high);
  for (int iteration = 0; iteration < 200; ++iteration) {
    const double value = Evaluate(c, degree, s);
    if (value == 0) return s;
    (falling == (value > 0) ? low : high) = s;
    double next = s - value / EvaluateDerivative(c, degree, s);
    if (!(next > low && next < high)) next = 0.5 * (low + high);
    if (next == s || next == low || next == high) return next;
    s = next;
  }
  return s;
}

// Returns where the sign of a polynomial of `degree` < kLargestDegree changes strictly inside (0, horizon), in order.
Roots SignChanges(const double* c, int degree, double horizon) {
  while (degree > 0 && c[degree] == 0) --degree;
  Roots roots;
  if (degree == 0) return roots;
  if (degree == 1) {
    const double s = -c[0] / c[1];
    if (s > 0 && s < horizon) roots.s[roots.count++] = s;
    return roots;
  }
  std::array<double, GapPolynomial::kLargestDegree> derivative{};
  for (int k = 1; k <= degree; ++k) derivative[k - 1] = k * c[k];
  Roots cuts = SignChanges(derivative.data(), degree - 1, horizon);
  double low = 0, value = c[0];
  for (int i = 0; i <= cuts.count; ++i) {
    const double high = i < cuts.count ? cuts.s[i] : horizon;
    const double next = Evaluate(c, degree, high);
    if ((value > 0) != (next > 0)) roots.s[roots.count++] = RootOfPiece(c, degree, low, high);
    low = high;
    value = next;
  }
  return roots;
}

double FirstClosingOfAny(const GapPolynomial& g, double horizon, bool ignore_start) {
  std::array<double, GapPolynomial::kLargestDegree> derivative;
  for (int k = 1; k <= g.degree; ++k) derivative[k - 1] = k * g.c[k];
  const Roots extrema = SignChanges(derivative.data(), g.degree - 1, horizon);
  double low = 0, value = g.c[0];
  for (int i = 0; i <= extrema.count; ++i) {
    const double high = i < extrema.count ? extrema.s[i] : horizon;
    const double next = g(high);
    if (value > 0 && next <= 0) return RootOfPiece(g.c.data(), g.degree, low, high);
    if (value <= 0 && next < value && !(ignore_start && i == 0)) return low;
    low = high;
    value = next;
  }
  return kNever;
}

}  // namespace

double FirstClosing(const GapPolynomial& g, double horizon, bool ignore_start) {
  if (StaysApart(g, horizon)) return kNever;
  if (g.degree == 4 && g.c[3] == 0 && g.c[4] == 0) {
    return FirstClosingOfQuadratic(g.c[2], g.c[1], g.c[0], horizon, ignore_start);
  }
  return FirstClosingOfAny(g, horizon, ignore_start);
}

}  // namespace saltus
