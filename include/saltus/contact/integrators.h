// Steps of free flight.
#pragma once

#include <span>

#include "saltus/contact/step_input.h"

namespace saltus {

// Computes a semi-implicit Euler step: first the velocity, then the position with the new velocity.
template <typename T, typename H>
BodyState<T, 0> SemiImplicitEuler(const H& h, const Vec2<T>& acceleration, const BodyState<T, 0>& x) {
  BodyState<T, 0> next;
  next.v = x.v + Scale(h, acceleration);
  next.p = x.p + Scale(h, next.v);
  return next;
}
// Computes the free flight of disc i by a semi-implicit Euler step.
template <typename T, typename H>
BodyState<T, 0> SemiImplicitEuler(const StepInput<T, H>& in, int i, const BodyState<T, 0>& x) {
  return SemiImplicitEuler<T>(in.h, in.Acceleration(i), x);
}

// Writes the free flight of every disc to `next`.
template <typename M, typename T>
void FreeFlight(const M& model, const StepInput<T>& in, std::span<const BodyState<T, M::kRotation>> x,
                std::span<BodyState<T, M::kRotation>> next) {
  for (int i = 0; i < static_cast<int>(x.size()); ++i) next[i] = model.Free(in, i, x[i]);
}

}  // namespace saltus
