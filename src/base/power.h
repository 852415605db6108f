// Powers with constant exponents, with the same bits for scalars and Jets.
#pragma once

#include <cmath>

#include "saltus/base/scalar.h"

namespace saltus {

// x^n for x > 0.
template <typename S>
S Power(const S& x, const S& n) {
  return std::pow(x, n);
}
template <typename S, int W>
ceres::Jet<S, W> Power(const ceres::Jet<S, W>& x, const S& n) {
  const S power = std::pow(x.a, n);
  return ceres::Jet<S, W>(power, (n * power / x.a) * x.v);
}

}  // namespace saltus
