// Velocity impulses with averaging, as Brax's mode `legacy_spring` (Brax 0.0.13). The source calls it compliant; there
// is no spring in it, but discs do overlap: the impulse comes after they do, and positions are never corrected.
//
// A step is two integrator steps of h = in.h / 2 under the same force, each
//
//   p <- p + h v,  then  v <- v + h (u/m + g),  then contacts at this (p, v), all from the same state:
//
//   v_c = velocity of a's point of contact relative to b's, vn = n . v_c
//   J   = -(1 + e) vn m_eff                                    iff depth > 0, vn < 0 and J > 0
//   v_t = v_c - vn n, k = |v_t|
//   F   = J n - min(k m_eff, mu J) v_t / (k + 1e-6)            the friction only if k > 0.01 m/s
//   dv  = F / m, dw = arm x F on a; the opposite on b          averaged: sum / (number of contacts + 1e-8)
//
// e and mu are the squares of the scene's values. Contacts, spin and averaging: brax_common.h. One number of rotation:
// the spin; in scenes with discs that spin angle and angular velocity, the angle with p. Everything is differentiated;
// ties of min count half. Not differentiable where a contact appears and at k = 0.01. Momentum is conserved unless a
// disc touches several things at once. A disc hit in the first integrator step can hit another in the second.
#pragma once

#include <algorithm>
#include <memory_resource>
#include <vector>

#include "contact/models/brax_common.h"

namespace saltus {

template <bool kSpins>
struct CompliantBraxIn {
  static constexpr ModelTraits kTraits = {.name = "compliant_brax",
                                          .summary = "velocity impulses averaged over contacts, two steps at a time",
                                          .source = "Brax 0.0.13, legacy_spring",
                                          .grid_steps = 2,
                                          .chains = true,
                                          .restitution_power = 2,
                                          .averages = true,
                                          .compared = true,
                                          .relative = true,
                                          .spins = true,
                                          .by_pair = true};
  static constexpr int kRotation = kSpins ? kSpin : 1;
  static constexpr bool kLinearRotation = kSpins;
  template <typename T>
  using State = BodyState<T, kRotation>;

  template <typename T, typename H>
  State<T> Free(const StepInput<T, H>& in, int i, const State<T>& x) const {
    return Integrate(in, i, Integrate(in, i, x));
  }

  template <typename T>
  void Step(const StepInput<T>& in, std::span<const State<T>> x, std::span<State<T>> next) const {
    std::copy(x.begin(), x.end(), next.begin());
    std::pmr::vector<char> reported(in.candidates.size(), 0, in.scratch);
    for (int half = 0; half < 2; ++half) {
      for (int i = 0; i < static_cast<int>(x.size()); ++i) next[i] = Integrate(in, i, next[i]);
      Collide(in, next, reported);
    }
  }

 private:
  template <typename T, typename H>
  static State<T> Integrate(const StepInput<T, H>& in, int i, const State<T>& x) {
    using S = Base<T>;
    const H h = in.h / S(2);
    State<T> next = x;
    next.p += Scale(h, x.v);
    if constexpr (kSpins) next.rotation[0] += h * x.rotation[1];
    next.v += Scale(h, in.Acceleration(i));
    if constexpr (kSpins) next.rotation[1] += h * in.AngularAcceleration(i);
    return next;
  }

  // Returns the spin with the sign of the source, positive clockwise.
  template <typename T>
  static T SpinOf(const State<T>& x) {
    if constexpr (kSpins) return -x.rotation[1];
    return x.rotation[0];
  }

  // Applies the impulses of all contacts in the present state of the discs.
  template <typename T>
  static void Collide(const StepInput<T>& in, std::span<State<T>> x, std::span<char> reported) {
    using S = Base<T>;
    brax::Averages<T> changes(static_cast<int>(x.size()), in.scratch);
    for (size_t i = 0; i < in.candidates.size(); ++i) {
      const Candidate& c = in.candidates[i];
      const brax::Contact<T> contact = brax::ContactAt(in, c, [&](int disc) -> Vec2<T> { return x[disc].p; });
      if (!(contact.depth > S(0))) continue;
      const auto velocity = [&](int disc) -> Vec2<T> {
        return x[disc].v + brax::SpinVelocity(SpinOf(x[disc]), Vec2<T>(contact.point - x[disc].p));
      };
      const Vec2<T> relative = RelativeVelocity<T>(c, velocity);
      const T approach = Dot(contact.normal, relative);
      if (!(approach < S(0))) continue;
      ContactMode mode;
      const T normal_impulse = NormalImpulse(in, c, approach);
      if (!(normal_impulse > S(0))) continue;
      const Vec2<T> tangential = relative - Scale(approach, contact.normal);
      const Vec2<T> impulse =
          Scale(normal_impulse, contact.normal) - Friction(in, c, normal_impulse, tangential, &mode);
      brax::AddPush<kSpins>(in, contact, x, impulse, impulse, &changes);
      if (!reported[i]) in.Report(c, mode);
      reported[i] = 1;
    }
    changes.ForEach(S(1e-8), [&](int disc, const Vec2<T>& dv, const T& dw) {
      x[disc].v += dv;
      if constexpr (kSpins) {
        x[disc].rotation[1] -= dw;
      } else {
        x[disc].rotation[0] += dw;
      }
    });
  }

  template <typename T>
  static T NormalImpulse(const StepInput<T>& in, const Candidate& c, const T& approach) {
    const T restitution = in.ContactOf(c).restitution * in.ContactOf(c).restitution;
    return Divide(T(-(restitution + Base<T>(1)) * approach), T(in.InverseMassA(c) + in.InverseMassB(c)));
  }

  // Returns the impulse against the tangential velocity `tangential`, and sets the mode of the contact.
  template <typename T>
  static Vec2<T> Friction(const StepInput<T>& in, const Candidate& c, const T& normal_impulse,
                          const Vec2<T>& tangential, ContactMode* mode) {
    using S = Base<T>;
    const T friction = in.ContactOf(c).friction * in.ContactOf(c).friction;
    const T speed = brax::Norm(tangential);
    *mode = friction > S(0) ? ContactMode::kStick : ContactMode::kFrictionless;
    if (!(speed > S(0.01))) return Vec2<T>::Zero();
    const T stopping = Divide(speed, T(in.InverseMassA(c) + in.InverseMassB(c)));
    const T limit = friction * normal_impulse;
    if (friction > S(0) && limit < stopping) *mode = ContactMode::kSlip;
    return Scale(brax::HalfTieMin(stopping, limit), brax::Direction(tangential, speed));
  }
};

struct CompliantBrax : CompliantBraxIn<false> {
  using Spinning = CompliantBraxIn<true>;
};

}  // namespace saltus
