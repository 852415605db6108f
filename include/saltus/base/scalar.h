// The closed set of scalar types that the contact models are instantiated with.
//
// A model is written once, templated on T. T is one of
//
//   double, float                    values
//   ceres::Jet<double, kJetWidth>,
//   ceres::Jet<float, kJetWidth>     values with derivatives
//
// float exists because some published gradients are results of single-precision arithmetic and cannot be reproduced in
// double (see data/published.csv, column `precision`).
#pragma once

#include <ceres/jet.h>

// Marks functions of Jets into which all calls are inlined, because a call costs more than the arithmetic of the Jets.
// It is empty under the address sanitizer, whose checks in so large a function take minutes to compile.
#if defined(__SANITIZE_ADDRESS__)
#define SALTUS_FLATTEN
#else
#define SALTUS_FLATTEN [[gnu::flatten]]
#endif

namespace saltus {

// Derivatives are computed in passes of this many directions. Six is one disc's position, velocity and force, so a disc
// that hits a plane needs a single pass.
inline constexpr int kJetWidth = 6;

template <typename S>
using StepJet = ceres::Jet<S, kJetWidth>;

namespace internal {
template <typename T>
struct BaseScalar {
  using type = T;
};
template <typename S, int W>
struct BaseScalar<ceres::Jet<S, W>> {
  using type = S;
};
}  // namespace internal

// The floating-point type of T: Base<double> and Base<Jet<double, W>> are both double.
template <typename T>
using Base = typename internal::BaseScalar<T>::type;

// Returns the value of x without derivatives, on which iterations inside a contact model run.
template <typename T>
const T& Value(const T& x) {
  return x;
}
template <typename S, int W>
const S& Value(const ceres::Jet<S, W>& x) {
  return x.a;
}

}  // namespace saltus
