// Elementary functions of scalars and Jets, with a stated derivative where the derivative does not exist.
//
// Their values for T and for Jets over T have the same bits, so that a derivative pass takes the branches of the value
// pass.
#pragma once

#include <cmath>
#include <type_traits>

#include "saltus/base/scalar.h"

namespace saltus {

namespace internal {
// Returns v / s for derivatives v: in double precision as the product with 1 / s, in single precision by a quotient for
// each entry, so that derivatives have the bits of the published programs.
template <typename V, typename S>
auto DivideDerivatives(const V& v, const S& s) {
  if constexpr (std::is_same_v<S, float>) {
    return v / s;
  } else {
    return v * (S(1) / s);
  }
}
}  // namespace internal

// Returns a / b with the bits of the scalar quotient; ceres::Jet multiplies by the reciprocal, which can differ in the
// last bit. Precondition: b != 0.
template <typename S>
S Divide(const S& a, const S& b) {
  return a / b;
}
template <typename S, int W>
ceres::Jet<S, W> Divide(const ceres::Jet<S, W>& a, const ceres::Jet<S, W>& b) {
  const S quotient = a.a / b.a;
  return ceres::Jet<S, W>(quotient, internal::DivideDerivatives(a.v - quotient * b.v, b.a));
}
template <typename S, int W>
ceres::Jet<S, W> Divide(const ceres::Jet<S, W>& a, const S& b) {
  return ceres::Jet<S, W>(a.a / b, internal::DivideDerivatives(a.v, b));
}
template <typename S, int W>
ceres::Jet<S, W> Divide(const S& a, const ceres::Jet<S, W>& b) {
  const S quotient = a / b.a;
  return ceres::Jet<S, W>(quotient, -(quotient / b.a) * b.v);
}

// Returns sqrt(x) for x >= 0, with derivative 0 at x = 0 (that of ceres::Jet is infinite there, and NaN for a
// constant).
template <typename S>
S SafeSqrt(const S& x) {
  return std::sqrt(x);
}
template <typename S, int W>
ceres::Jet<S, W> SafeSqrt(const ceres::Jet<S, W>& x) {
  if (x.a == S(0)) return ceres::Jet<S, W>(S(0));
  const S root = std::sqrt(x.a);
  return ceres::Jet<S, W>(root, internal::DivideDerivatives(x.v, S(2) * root));
}

// Returns |x|, with derivative 0 at x = 0.
template <typename T>
T SafeAbs(const T& x) {
  if (x > T(0)) return x;
  if (x < T(0)) return -x;
  return T(0);
}

// Return the smaller (larger) of two, with its derivative; if they are equal, with that of the first.
template <typename T>
T MinOf(const T& a, const T& b) {
  return b < a ? b : a;
}
template <typename T>
T MaxOf(const T& a, const T& b) {
  return a < b ? b : a;
}

// Returns the sign of x, 0 at 0, as a constant without derivatives.
template <typename T>
Base<T> SignOf(const T& x) {
  return static_cast<Base<T>>((x > T(0)) - (x < T(0)));
}

// Returns a * b + c with a single rounding of the value.
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
