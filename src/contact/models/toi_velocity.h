// Direct velocity impulses from the velocities at the time of impact (Zhong, Han, Dey, Brikis 2023, TOI-Velocity).
//
// With a_i = u_i/m_i + g held over the step, v' = v + h a and n', d' the normal and distance at p + h v', there is a
// contact iff d' < r_a + r_b and s' = n' . w' < 0. Then
//
//   tau = (d' - r_a - r_b) / min(-1e-3, s')          time left after the impact
//   b   = max(h - tau, 0)                            time of the impact, since the start of the step
//   n   = normal at p + b v'
//   s   = n . (relative velocity of v + b a)         at the impact, not at the end of the step
//   P   = -(1 + e) m_eff s n                         impulse on a, -P on b
//   v+  = v' + P/m
//   p+  = p + h v+ - b P/m
//
// Everything is differentiated. Not differentiable where a contact appears (d' = r_a + r_b, s' = 0) and at tau = h.
// Friction is not defined. Momentum is conserved. Where only the force within the step brings the two together, s can
// be positive; P, as published, then pulls.
// Extended beyond the published script, which uses direct.h at planes: planes by the same rule, masses, fixed discs.
#pragma once

#include "contact/models/disc_rotation.h"
#include "saltus/contact/contact_model.h"

namespace saltus {

struct ToiVelocityRule : SemiImplicitFlight<0> {
  static constexpr ModelTraits kTraits = {.name = "toi_velocity",
                                          .summary = "direct velocity impulse, velocities and position at the impact",
                                          .source = "Zhong, Han, Dey, Brikis 2023",
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
    const auto end_velocity = [&](int i) -> Vec2<T> { return VelocityAfter(in, T(in.h), i, x[i]); };
    for (const Candidate& c : in.candidates) {
      // Returns the position of disc i after a time at which it has moved with its velocity at the end of the step.
      const auto position_after = [&](const T& time) {
        return [&](int i) -> Vec2<T> { return x[i].p + Scale(time, end_velocity(i)); };
      };
      const Separation<T> end = SeparationAt(in, c, position_after(T(in.h)));
      const T overlap = end.distance - in.ContactDistance(c);
      if (!(overlap < S(0))) continue;
      const T end_speed = Dot(end.normal, RelativeVelocity<T>(c, end_velocity));
      if (!(end_speed < S(0))) continue;

      const T time_left = Divide(overlap, MinOf(T(S(-1e-3)), end_speed));
      const T impact = MaxOf(T(in.h - time_left), T(S(0)));
      in.Report(c, ContactMode::kFrictionless, Value(impact));
      const Vec2<T> n = SeparationAt(in, c, position_after(impact)).normal;
      const T s = Dot(n, RelativeVelocity<T>(c, [&](int i) -> Vec2<T> { return VelocityAfter(in, impact, i, x[i]); }));
      const Vec2<T> impulse = Scale(T(-(in.ContactOf(c).restitution + S(1)) * in.EffectiveMass(c) * s), n);
      const T lever = in.h - impact;
      ApplyImpulse(in, c, impulse, [&](int i, const Vec2<T>& dv) {
        next[i].v += dv;
        next[i].p += Scale(lever, dv);
      });
    }
  }

 private:
  template <typename T>
  static Vec2<T> VelocityAfter(const StepInput<T>& in, const T& time, int i, const State<T>& x) {
    return x.v + Scale(time, in.Acceleration(i));
  }
};

struct ToiVelocity : ToiVelocityRule {
  using Spinning = SpinsFreely<ToiVelocityRule>;
};

}  // namespace saltus
