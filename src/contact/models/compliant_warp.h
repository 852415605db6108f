// Springs and dampers that resist overlap, with Coulomb friction, as the forces of Warp's examples (Macklin 2022).
//
// With n, the gap g_n = d - r_a - r_b and the relative velocity w = s n + w_t (of discs that spin, that of the points
// of contact, where F acts) at the start of the step there is a contact iff g_n < 0. Then
//
//   f_n = k_n g_n + k_d min(s, 0)                             N, <= 0
//   F   = -f_n n - mu |f_n| w_t / |w_t|                       force on a, -F on b; no friction if |w_t| <= 1e-6 m/s
//   v'  = v + h (F/m + u/m + g)
//   p'  = p + h v'
//
// Everything is differentiated. Not differentiable where a contact appears (if k_d is not 0 the force jumps there), at
// s = 0 and where sliding stops: friction is not regularised. Momentum is conserved; restitution is not read.
// Extended beyond the published programs: masses, fixed discs, and damping and friction between discs.
#pragma once

#include <memory_resource>
#include <vector>

#include "contact/models/disc_rotation.h"
#include "saltus/contact/contact_model.h"

namespace saltus {

template <int kTurn>
struct CompliantWarpOf : SemiImplicitFlight<kTurn> {
  static constexpr ModelTraits kTraits = {.name = "compliant_warp",
                                          .summary = "spring, damper and Coulomb friction at the start of the step",
                                          .source = "Warp (Macklin 2022); Zhong, Han, Brikis 2022",
                                          .compliant = true,
                                          .rebound = Rebound::kEmergent,
                                          .compared = true,
                                          .relative = true,
                                          .by_pair = true};
  static constexpr int kTapedFrom = 12;  // discs
  template <typename T>
  using State = BodyState<T, kTurn>;

  template <typename T>
  void Step(const StepInput<T>& in, std::span<const State<T>> x, std::span<State<T>> next) const {
    using S = Base<T>;
    std::pmr::vector<Twist<T, kTurn>> acceleration(in.scratch);
    acceleration.reserve(x.size());
    for (int i = 0; i < static_cast<int>(x.size()); ++i) acceleration.push_back(AccelerationOf<kTurn>(in, i));

    for (const Candidate& c : in.candidates) {
      const Separation<T> at = SeparationAt(in, c, [&](int i) -> const Vec2<T>& { return x[i].p; });
      const T gap = at.distance - in.ContactDistance(c);
      if (!(gap < S(0))) continue;
      const Vec2<T> w = ContactVelocity<kTurn>(in, c, at.normal, [&](int i) { return TwistOf(x[i]); });
      const T s = Dot(at.normal, w);
      const T normal_force = in.contact.stiffness * gap + in.contact.damping * MinOf(T(S(0)), s);
      Vec2<T> force = Scale(T(-normal_force), at.normal);
      const Vec2<T> sliding = w - Scale(s, at.normal);
      const T speed = Length(sliding);
      const bool slides = speed > S(1e-6);
      if (slides) force -= Scale(T(in.ContactOf(c).friction * SafeAbs(normal_force)), Quotient(sliding, speed));
      in.Report(c, ModeOf(in.ContactOf(c).friction > S(0), !slides));
      PushContact<kTurn>(in, c, at.normal, force, [&](int i, const auto& change) { acceleration[i] += change; });
    }
    for (std::size_t i = 0; i < x.size(); ++i) next[i] = SemiImplicitEuler(in.h, acceleration[i], x[i]);
  }
};

struct CompliantWarp : CompliantWarpOf<0> {
  using Spinning = CompliantWarpOf<kSpin>;
};

}  // namespace saltus
