// Extended position-based dynamics in small steps, with a velocity pass (Macklin et al. 2016, 2019; Mueller et al.
// 2020, "Detailed Rigid Body Simulation with Extended Position Based Dynamics").
//
// Each of the substeps of h_s = h / substeps, one contact after the other, in the order of candidates:
//
//   v* = v + h_s (u/m + g),   p = q + h_s v*                           q: positions before the substep
//   positions, if the gap c at p is negative, with n and t at p:
//     lambda = -c / (1/m_eff + compliance / h_s^2)                     p += lambda n / m on a, - on b
//     l_t    = -m_eff t . (p - q)_rel, if |l_t| < mu lambda            p += l_t t / m: static friction
//   v = (p - q) / h_s
//   velocities, for the same contacts, with v_n, v_t of v and v*_n of v*:
//     p_n    = m_eff (target - v_n),   target = -e v*_n if v*_n < 0, else v*_n     e = 0 if |v*_n| <= 2 |g| h_s
//     p_t    = -sgn(v_t) min(mu bound, m_eff |v_t|)                    bound = p_n + lambda / h_s, N s
//
// Of discs that spin, ways and velocities along t are those of the points of contact, m_eff there is the mass along t
// (impact.h), and angles and angular velocities follow as positions and velocities do.
//
// The published target is max(-e v*_n, 0), which stops a disc that still overlaps on its way out; and the published
// bound of friction is lambda / h_s alone, the depth of one substep instead of the impulse of the bounce.
//
// Everything is differentiated. Without compliance a disc ends at the surface, so nothing of its normal position
// survives an impact: its gradient is that of a projection. Momentum is conserved.
#pragma once

#include <algorithm>
#include <memory_resource>
#include <vector>

#include "contact/models/disc_rotation.h"
#include "saltus/contact/contact_model.h"

namespace saltus {

template <int kTurn>
struct XpbdOf : SubstepFlight<kTurn, 10> {
  using Flight = SubstepFlight<kTurn, 10>;
  using Flight::substeps, Flight::SubstepLength;
  static constexpr ModelTraits kTraits = {.name = "xpbd",
                                          .summary = "extended position-based dynamics in substeps",
                                          .source = "Macklin et al. 2016, 2019; Mueller et al. 2020",
                                          .chains = true,
                                          .projects = true,
                                          .sequential = true,
                                          .relative = true,
                                          .by_pair = true};
  template <typename T>
  using State = BodyState<T, kTurn>;

  double compliance = 0;  // m/N
  bool published_bound = false;
  template <typename Visit>
  void VisitOptions(const Visit& visit) {
    visit(ModelOption{"compliance", "compliance of contacts, m/N", 0, 1}, compliance);
    visit(ModelOption{"substeps", "substeps of a step", 1, 1e4}, substeps);
    visit(ModelOption{"published_bound", "1: the position pass alone bounds the friction", 0, 1}, published_bound);
  }

  template <typename T>
  void Step(const StepInput<T>& in, std::span<const State<T>> x, std::span<State<T>> next) const {
    using S = Base<T>;
    const S h = SubstepLength(in);
    std::copy(x.begin(), x.end(), next.begin());
    std::pmr::vector<State<T>> old(x.size(), in.scratch);        // q
    std::pmr::vector<State<T>> predicted(x.size(), in.scratch);  // v*, and q + h_s v*
    std::pmr::vector<Contact<T>> contacts(in.scratch);
    std::pmr::vector<char> reported(in.candidates.size(), 0, in.scratch);
    for (int substep = 0; substep < substeps; ++substep) {
      std::copy(next.begin(), next.end(), old.begin());
      for (std::size_t i = 0; i < x.size(); ++i) {
        Accelerate(h, AccelerationOf<kTurn>(in, static_cast<int>(i)), &next[i]);
        Drift(h, &next[i]);
        predicted[i] = next[i];
      }
      contacts.clear();
      ProjectPositions<T>(in, old, next, &contacts);
      if (contacts.empty()) continue;
      for (std::size_t i = 0; i < x.size(); ++i) {
        next[i].v +=
            Vec2<T>(Divide(T(next[i].p[0] - predicted[i].p[0]), h), Divide(T(next[i].p[1] - predicted[i].p[1]), h));
        if constexpr (kTurn == kSpin) {
          next[i].rotation[1] += Divide(T(next[i].rotation[0] - predicted[i].rotation[0]), h);
        }
      }
      for (const Contact<T>& contact : contacts) {
        const ContactMode mode = CorrectVelocities<T>(in, contact, predicted, next);
        char& known = reported[contact.index];
        if (!known) in.Report(in.candidates[contact.index], mode);
        known = 1;
      }
    }
  }

 private:
  template <typename T>
  struct Contact {
    int index;  // of the candidate
    Vec2<T> normal;
    T multiplier;  // lambda, kg m
    bool held;     // by static friction
  };

  // Returns the displacement (and rotation) of a disc from one state to another.
  template <typename T>
  static Twist<T, kTurn> Displacement(const State<T>& from, const State<T>& to) {
    if constexpr (kTurn == kSpin) {
      return {to.p - from.p, to.rotation[0] - from.rotation[0]};
    } else {
      return {to.p - from.p};
    }
  }

  template <typename T>
  void ProjectPositions(const StepInput<T>& in, std::span<const State<T>> old, std::span<State<T>> x,
                        std::pmr::vector<Contact<T>>* contacts) const {
    using S = Base<T>;
    const S h = SubstepLength(in);
    for (std::size_t i = 0; i < in.candidates.size(); ++i) {
      const Candidate& c = in.candidates[i];
      const Separation<T> at = SeparationAt(in, c, [&](int disc) -> const Vec2<T>& { return x[disc].p; });
      const T gap = at.distance - in.ContactDistance(c);
      if (!(gap < S(0))) continue;
      const T mobility = in.InverseMassA(c) + in.InverseMassB(c) + S(compliance) / (h * h);
      const T multiplier = Divide(T(-gap), mobility);
      const auto move = [&](int disc, const Twist<T, kTurn>& change) {
        x[disc].p += change.v;
        if constexpr (kTurn == kSpin) x[disc].rotation[0] += change.w;
      };
      ApplyImpulse(in, c, Scale(multiplier, at.normal), [&](int disc, const Vec2<T>& change) { x[disc].p += change; });
      bool held = false;
      if (in.ContactOf(c).friction > S(0)) {
        const Vec2<T> tangent = Perpendicular(at.normal);
        const Vec2<T> slid =
            ContactVelocity<kTurn>(in, c, at.normal, [&](int disc) { return Displacement(old[disc], x[disc]); });
        const T resist = -Dot(tangent, slid) * SlidingMass<kTurn>(in, c);
        held = SafeAbs(resist) < in.ContactOf(c).friction * multiplier;
        if (held) PushContact<kTurn>(in, c, at.normal, Scale(resist, tangent), move);
      }
      contacts->push_back({static_cast<int>(i), at.normal, multiplier, held});
    }
  }

  template <typename T>
  ContactMode CorrectVelocities(const StepInput<T>& in, const Contact<T>& contact, std::span<const State<T>> predicted,
                                std::span<State<T>> x) const {
    using S = Base<T>;
    const S h = SubstepLength(in);
    const Candidate& c = in.candidates[contact.index];
    const Vec2<T>& n = contact.normal;
    const T mass = in.EffectiveMass(c);
    const Vec2<T> w = ContactVelocity<kTurn>(in, c, n, [&](int i) { return TwistOf(x[i]); });
    const T approach = Dot(n, RelativeVelocity<T>(c, [&](int i) -> const Vec2<T>& { return predicted[i].v; }));
    T target = approach;
    if (approach < S(0)) {
      const S slow = S(2) * std::sqrt(Dot(in.gravity, in.gravity)) * h;
      target = -approach > slow ? T(-in.ContactOf(c).restitution * approach) : T(S(0));
    }
    const T normal_impulse = mass * (target - Dot(n, w));
    Vec2<T> impulse = Scale(normal_impulse, n);
    ContactMode mode = ContactMode::kFrictionless;
    if (in.ContactOf(c).friction > S(0)) {
      const Vec2<T> tangent = Perpendicular(n);
      const T sliding = Dot(tangent, w);
      T bound = Divide(contact.multiplier, h);
      if (!published_bound) bound += normal_impulse;
      const T largest = in.ContactOf(c).friction * MaxOf(T(S(0)), bound);
      const T stopping = SlidingMass<kTurn>(in, c) * SafeAbs(sliding);
      impulse -= Scale(T(SignOf(sliding) * MinOf(largest, stopping)), tangent);
      mode = contact.held || stopping < largest ? ContactMode::kStick : ContactMode::kSlip;
    }
    PushContact<kTurn>(in, c, n, impulse, [&](int i, const auto& change) { Kick(change, &x[i]); });
    return mode;
  }
};

struct Xpbd : XpbdOf<0> {
  using Spinning = XpbdOf<kSpin>;
};

}  // namespace saltus
