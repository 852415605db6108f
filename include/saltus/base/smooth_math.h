// Elementary functions with a stated derivative where the textbook one does not exist, for scalars and Jets alike.
//
// All of them give the same value, to the last bit, for T and for Jets over T, so that a derivative pass always takes
// the branch that the value pass took.
#pragma once

#include <cmath>
#include <type_traits>

#include "saltus/base/scalar.h"

namespace saltus {

namespace internal {
// v / s for derivatives v. One quotient instead of many, but in single precision, whose derivatives
// are to have the bits of the published programs.
template <typename V, typename S>
auto Over(const V& v, const S& s) {
  if constexpr (std::is_same_v<S, float>) {
    return v / s;
  } else {
    return v * (S(1) / s);
  }
}
}  // namespace internal

// a / b. ceres::Jet multiplies with the reciprocal, which can differ from the scalar quotient in the last bit; this
// does not. Precondition: b != 0.
template <typename S>
S Divide(const S& a, const S& b) {
  return a / b;
}
template <typename S, int W>
ceres::Jet<S, W> Divide(const ceres::Jet<S, W>& a, const ceres::Jet<S, W>& b) {
  const S quotient = a.a / b.a;
  return ceres::Jet<S, W>(quotient, internal::Over(a.v - quotient * b.v, b.a));
}
template <typename S, int W>
ceres::Jet<S, W> Divide(const ceres::Jet<S, W>& a, const S& b) {
  return ceres::Jet<S, W>(a.a / b, internal::Over(a.v, b));
}
template <typename S, int W>
ceres::Jet<S, W> Divide(const S& a, const ceres::Jet<S, W>& b) {
  const S quotient = a / b.a;
  return ceres::Jet<S, W>(quotient, -(quotient / b.a) * b.v);
}

// sqrt(x) for x >= 0, with derivative 0 at x = 0 (the plain derivative is infinite there, and NaN for a constant).
template <typename S>
S SafeSqrt(const S& x) {
  return std::sqrt(x);
}
template <typename S, int W>
ceres::Jet<S, W> SafeSqrt(const ceres::Jet<S, W>& x) {
  if (x.a == S(0)) return ceres::Jet<S, W>(S(0));
  const S root = std::sqrt(x.a);
  return ceres::Jet<S, W>(root, internal::Over(x.v, S(2) * root));
}

// |x|, with derivative 0 at x = 0.
template <typename T>
T SafeAbs(const T& x) {
  if (x > T(0)) return x;
  if (x < T(0)) return -x;
  return T(0);
}

// The smaller (larger) of two, with the derivative of the one taken; at a tie that of the first.
template <typename T>
T MinOf(const T& a, const T& b) {
  return b < a ? b : a;
}
template <typename T>
T MaxOf(const T& a, const T& b) {
  return a < b ? b : a;
}

// The sign of x, 0 at 0; a constant, so it has no derivative.
template <typename T>
Base<T> SignOf(const T& x) {
  return static_cast<Base<T>>((x > T(0)) - (x < T(0)));
}

// a * b + c with a single rounding of the value.
template <typename S>
S FusedMultiplyAdd(const S& a, const S& b, const S& c) {
  return std::fma(a, b, c);
}
template <typename S, int W>
ceres::Jet<S, W> FusedMultiplyAdd(const S& a, const ceres::Jet<S, W>& b, const ceres::Jet<S, W>& c) {
  return ceres::Jet<S, W>(std::fma(a, b.a, c.a), a * b.v + c.v);
}
template <typename S, int W>
ceres::Jet<S, W> FusedMultiplyAdd(const ceres::Jet<S, W>& a, const ceres::Jet<S, W>& b, const ceres::Jet<S, W>& c) {
  return ceres::Jet<S, W>(std::fma(a.a, b.a, c.a), a.v * b.a + a.a * b.v + c.v);
}

}  // namespace saltus
