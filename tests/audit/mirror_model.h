// A contact model as a user of the library would add it: this header, and nothing else.
//
// Forces act as in Euler's symplectic method. Where discs overlap at the end of a step, position and velocity are
// mirrored:  relative normal position and velocity, r_a + r_b - d and s, become -e times themselves. That is exact if
// nothing accelerates the two towards each other.
#pragma once

#include "saltus/contact/contact_model.h"

namespace saltus {

struct Mirror {
  static constexpr ModelTraits kTraits = {.name = "mirror",
                                          .summary = "position and velocity mirrored at the contact",
                                          .source = "an example",
                                          .friction = false};
  static constexpr int kRotation = 0;
  template <typename T>
  using State = BodyState<T, kRotation>;

  template <typename T>
  State<T> Free(const StepInput<T>& in, int i, const State<T>& x) const {
    State<T> next;
    next.v = x.v + Scale(in.h, in.Acceleration(i));
    next.p = x.p + Scale(in.h, next.v);
    return next;
  }

  template <typename T>
  void Step(const StepInput<T>& in, std::span<const State<T>> x, std::span<State<T>> next) const {
    FreeFlight(*this, in, x, next);
    for (const Candidate& c : in.candidates) {
      const Separation<T> at = SeparationAt(in, c, [&](int i) -> const Vec2<T>& { return next[i].p; });
      const T overlap = at.distance - in.ContactDistance(c);
      const T s = Dot(at.normal, RelativeVelocity<T>(c, [&](int i) -> const Vec2<T>& { return next[i].v; }));
      if (!(overlap < Base<T>(0)) || !(s < Base<T>(0))) continue;
      in.Report(c);
      const T factor = -(in.contact.restitution + Base<T>(1)) * in.EffectiveMass(c);
      const Vec2<T> impulse = Scale(T(factor * s), at.normal), shift = Scale(T(factor * overlap), at.normal);
      ApplyImpulse(in, c, impulse, [&](int i, const Vec2<T>& dv) { next[i].v += dv; });
      ApplyImpulse(in, c, shift, [&](int i, const Vec2<T>& dp) { next[i].p += dp; });
    }
  }
};

}  // namespace saltus
