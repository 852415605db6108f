// Contact impulses by convex optimisation, with and without time of impact (DiffCoSim; Zhong, Dey, Chakraborty 2021).
//
// The contact test is that of direct.h: with n, d' at p + h v and s = n . w there is one iff d' < r_a + r_b and s < 0.
// Each contact has a cone program of its own, with a = -(n . w, t . w) and friction coefficient mu:
//
//   f   = argmin |f - a|^2  over  f_n >= 0, |f_t| <= mu f_n         m/s, solved in closed form
//   P   = (1 + e) m_eff (f_n n + f_t t)             impulse on a, -P on b
//         Of discs that spin w_t is that of the points of contact, and the distance that of energy: with m_t the mass
//         along t, argmin (f_n - a_n)^2 + m_eff/m_t (f_t - m_t/m_eff a_t)^2
//   v'  = v + h (u/m + g) + P/m
//   p'  = p + h v  [+ min(tau - h, 0) P/m]           with time of impact
//   tau = (d' - r_a - r_b) / min(-1e-3, s)           time left after the impact
//
// As published: the position moves with the velocity before the step, so neither force nor impulse reaches it within
// the step; restitution multiplies the tangential impulse too, and a sliding contact has f_n > a_n.
// The frame (n, t) of two discs is a constant in P, not in tau. Not differentiable where a contact appears, at tau = h
// and between stick and slip. The published programs solve the cone program to 1e-4 only; this is its exact solution.
// Extended beyond them: masses, fixed discs, friction between discs.
#pragma once

#include "contact/models/disc_rotation.h"
#include "saltus/contact/contact_model.h"

namespace saltus {

template <bool kTimeOfImpact, int kTurn>
struct ConvexOf : ExplicitFlight<kTurn> {
  static constexpr ModelTraits kTraits = {
      .name = kTimeOfImpact ? "convex_toi" : "convex",
      .summary = kTimeOfImpact ? "impulse by a cone program, position corrected by the time of impact"
                               : "impulse by a cone program at the end of the step",
      .source = "DiffCoSim (Zhong, Dey, Chakraborty 2021); Zhong, Han, Brikis 2022",
      .published_jacobian = true,
      .compared = true,
      .relative = true,
      .by_pair = true};
  template <typename T>
  using State = BodyState<T, kTurn>;

  template <typename T>
  void Step(const StepInput<T>& in, std::span<const State<T>> x, std::span<State<T>> next) const {
    using S = Base<T>;
    FreeFlight(*this, in, x, next);
    for (const Candidate& c : in.candidates) {
      const auto predicted = [&](int i) -> Vec2<T> { return x[i].p + Scale(in.h, x[i].v); };
      const Separation<T> at = SeparationAt(in, c, predicted);
      const T overlap = at.distance - in.ContactDistance(c);
      if (!(overlap < S(0))) continue;
      const auto twist = [&](int i) { return TwistOf(x[i]); };
      const Vec2<T> w = RelativeVelocity<T>(c, [&](int i) -> Vec2<T> { return x[i].v; });
      const T s = Dot(at.normal, w);
      if (!(s < S(0))) continue;

      const Vec2<S> n(Value(at.normal[0]), Value(at.normal[1]));
      const Vec2<S> t = Perpendicular(n);
      const Vec2<T> frozen = n.template cast<T>();
      const Projection<T> f = ProjectOnCone<T>(-Dot(n, w),
                                               -Dot(t, ContactVelocity<kTurn>(in, c, frozen, twist)),
                                               in.ContactOf(c).friction,
                                               MassRatio(in, c));
      in.Report(c, f.mode);
      const T scale = (in.ContactOf(c).restitution + S(1)) * in.EffectiveMass(c);
      const Vec2<T> impulse = Scale(scale, Vec2<T>(Scale(f.normal, n) + Scale(f.tangential, t)));
      T lever = T(S(0));  // s, by how much the impulse moves the disc within this step
      if constexpr (kTimeOfImpact) {
        const T time_left = Divide(overlap, MinOf(T(S(-1e-3)), s));
        lever = MinOf(T(time_left - in.h), T(S(0)));
      }
      PushContact<kTurn>(
          in, c, frozen, impulse, [&](int i, const Twist<T, kTurn>& change) { Kick(change, lever, &next[i]); });
    }
  }

 private:
  template <typename T>
  struct Projection {
    T normal, tangential;  // m/s
    ContactMode mode;
  };

  // Returns m_eff / m_t, the ratio of the masses along normal and tangent.
  template <typename T>
  static auto MassRatio(const StepInput<T>& in, const Candidate& c) {
    if constexpr (kTurn == kSpin) {
      return T(Divide(in.EffectiveMass(c), in.TangentialMass(c)));
    } else {
      return Base<T>(1);
    }
  }

  // Returns the point of the cone |f_t| <= mu f_n where (f_n - a_n)^2 + ratio (f_t - a_t / ratio)^2 is least.
  // Precondition: a_n > 0.
  template <typename T, typename R>
  static Projection<T> ProjectOnCone(const T& a_n, const T& a_t, const T& mu, const R& ratio) {
    using S = Base<T>;
    const T size = SafeAbs(a_t), stuck = Divide(a_t, ratio);
    if (mu > S(0) && SafeAbs(stuck) <= mu * a_n) return {a_n, stuck, ContactMode::kStick};
    const T normal = Divide(T(a_n + mu * size), T(S(1) + mu * mu * ratio));
    return {normal, T(mu * SignOf(a_t) * normal), mu > S(0) ? ContactMode::kSlip : ContactMode::kFrictionless};
  }
};

template <bool kTimeOfImpact>
struct Convex : ConvexOf<kTimeOfImpact, 0> {
  using Spinning = ConvexOf<kTimeOfImpact, kSpin>;
};

}  // namespace saltus
