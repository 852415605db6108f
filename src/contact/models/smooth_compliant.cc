#include "contact/models/smooth_compliant.h"

#include <algorithm>
#include <cmath>

namespace saltus {
namespace {

// Returns (ln((1 + x) / (1 - e x)) - (1 + e) x) / x^2, whose root is sought. It is regular at x = 0 (by its series).
double Condition(double e, double x) {
  if (std::abs(x) > 0.25) return (std::log1p(x) - std::log1p(-e * x) - (1 + e) * x) / (x * x);
  double sum = 0, sign = -1, power = 1, e_power = e * e;
  for (int k = 2; k < 30; ++k) {
    sum += power * (sign + e_power) / k;
    sign = -sign;
    power *= x;
    e_power *= e;
  }
  return sum;
}

}  // namespace

double HuntCrossley::ScaledDissipation(double restitution) {
  const double e = std::max(restitution, kLeastRestitution);
  if (e == 1) return 0;
  // The condition grows with x, from below zero at (1 - e) / e (for e < 1, where its minimum is) to infinity at 1 / e.
  // Above restitution 1 the root is small and negative.
  double low = e < 1 ? (1 - e) / e : -0.9, high = e < 1 ? 1 / e : 0;
  for (int i = 0; i < 200 && high - low > 0; ++i) {
    const double middle = 0.5 * (low + high);
    if (middle <= low || middle >= high) break;
    (Condition(e, middle) < 0 ? low : high) = middle;
  }
  return high;
}

}  // namespace saltus
