// Direct velocity impulses, with and without time of impact (DiffTaichi; Hu et al. 2020, billiards and rigid bodies).
//
// A contact is predicted from the velocity at the start of the step, forces left out: with n, d' the normal and
// distance at p + h v, and s = n . w the normal relative velocity, there is one iff d' < r_a + r_b and s < 0. Then
//
//   P   = -(1 + e) m_eff s n                       impulse on a, -P on b
//   v'  = v + h (u/m + g) + P/m
//   p'  = p + h v'  [+ min(tau - h, 0) P/m]         with time of impact: the impulse acts from the impact on
//   tau = (d' - r_a - r_b) / min(-1e-3, s)          time left after the impact
//
// Everything is differentiated. Not differentiable where a contact appears (d' = r_a + r_b, s = 0) and at tau = h.
// Friction is not defined. Momentum is conserved; normal velocities separate with restitution e exactly.
#pragma once

#include "contact/models/disc_rotation.h"
#include "saltus/contact/contact_model.h"

namespace saltus {

template <bool kTimeOfImpact>
struct DirectRule : SemiImplicitFlight<0> {
  static constexpr ModelTraits kTraits = {
      .name = kTimeOfImpact ? "direct_toi" : "direct",
      .summary = kTimeOfImpact ? "direct velocity impulse, position corrected by the time of impact"
                               : "direct velocity impulse at the end of the step",
      .source = "DiffTaichi (Hu et al. 2020); Zhong, Han, Brikis 2022",
      .friction = false,
      .compared = true,
      .relative = true,
      .by_pair = true};
  template <typename T>
  using State = BodyState<T, 0>;

  template <typename T>
  void Step(const StepInput<T>& in, std::span<const State<T>> x, std::span<State<T>> next) const {
    using S = Base<T>;
    FreeFlight(*this, in, x, next);
    for (const Candidate& c : in.candidates) {
      const auto predicted = [&](int i) -> Vec2<T> { return x[i].p + Scale(in.h, x[i].v); };
      const Separation<T> at = SeparationAt(in, c, predicted);
      const T overlap = at.distance - in.ContactDistance(c);
      if (!(overlap < S(0))) continue;
      const T s = Dot(at.normal, RelativeVelocity<T>(c, [&](int i) -> Vec2<T> { return x[i].v; }));
      if (!(s < S(0))) continue;
      in.Report(c);

      const Vec2<T> impulse = Scale(T(-(in.ContactOf(c).restitution + S(1)) * in.EffectiveMass(c) * s), at.normal);
      T lever = T(in.h);  // s, for how long the impulse moves the disc within this step
      if constexpr (kTimeOfImpact) {
        const T time_left = Divide(overlap, MinOf(T(S(-1e-3)), s));
        lever += MinOf(T(time_left - in.h), T(S(0)));
      }
      ApplyImpulse(in, c, impulse, [&](int i, const Vec2<T>& dv) {
        next[i].v += dv;
        next[i].p += Scale(lever, dv);
      });
    }
  }
};

template <bool kTimeOfImpact>
struct Direct : DirectRule<kTimeOfImpact> {
  using Spinning = SpinsFreely<DirectRule<kTimeOfImpact>>;
};

}  // namespace saltus
