// Position-based dynamics, one projection and one restitution pass a step, as in Warp's examples (Macklin 2022; Mueller
// et al. 2020).
//
// Predicted: v* = v + h (u/m + g), p* = p + h v*. With n and c = d - r_a - r_b at p* there is a contact iff c < 0.
// Then, for the pair (relative to b; split between a and b by inverse mass), E the displacement p* - p and E_t its
// tangential part,
//
//   delta = -c n - [|E_t| < mu |c|] |E_t| E_t / (|E_t| + 1e-6)          m, all contacts add to p*
//   p'    = p* + delta,     v_b = (p' - p) / h                          in every step, contact or not
//   q     = -(n . v*) - min(e n . v_b, 0)
//   y     = min(mu |(1 + e) n . v_b|, |v*_t|)                           0 if |v*_t| < 1e-6 m/s
//   v'    = v_b + q n - y dir                                           all contacts add
//
// Of discs that spin, ways and velocities along the tangent are those of the points of contact, what is along it is
// split by inverse inertia too, and angles and angular velocities follow as positions and velocities do.
//
// As published: v* and v_b stand in each other's place, so a disc separates with (1 - e) v_b - v* (which is restitution
// 1 only for e = 1); and dir is v*_t / |v*_t| between discs and at the first plane of the scene, but at every other
// plane it is that of the first plane if the disc touches and slides there in the same step, else 0.
// All but the tests is differentiated. Not differentiable where a contact appears and where friction changes branch.
// Velocities are differences of positions: in single precision they are multiples of an ulp of p, divided by h.
// Extended beyond the published programs: masses, fixed discs, friction between discs, more than two planes.
#pragma once

#include <memory_resource>
#include <vector>

#include "contact/models/disc_rotation.h"
#include "saltus/contact/contact_model.h"

namespace saltus {

template <int kTurn>
struct PbdWarpOf {
  static constexpr ModelTraits kTraits = {.name = "pbd_warp",
                                          .summary = "position-based dynamics, one projection and one restitution pass",
                                          .source = "Warp (Macklin 2022); Zhong, Han, Brikis 2022",
                                          .rebound = Rebound::kElasticOnly,
                                          .projects = true,
                                          .compared = true,
                                          .relative = true,
                                          .by_pair = true};
  static constexpr int kRotation = kTurn;
  static constexpr bool kLinearRotation = kTurn == kSpin;
  template <typename T>
  using State = BodyState<T, kRotation>;

  static std::string ReasonNotApplicable(const Scene& scene) {
    const bool slides = scene.HasEdges() && HasFriction(scene);
    return slides ? "friction with segments, polygons and arcs: its source has friction with planes only" : "";
  }

  template <typename T, typename H>
  State<T> Free(const StepInput<T, H>& in, int i, const State<T>& x) const {
    State<T> next;
    next.p = x.p + Scale(in.h, PredictedVelocity(in, i, x));
    next.v = VelocityBetween(in, x.p, next.p);
    if constexpr (kTurn == kSpin) {
      next.rotation[0] = x.rotation[0] + in.h * PredictedSpin(in, i, x);
      next.rotation[1] = Divide(T(next.rotation[0] - x.rotation[0]), in.h);
    }
    return next;
  }

  template <typename T>
  void Step(const StepInput<T>& in, std::span<const State<T>> x, std::span<State<T>> next) const {
    FreeFlight(*this, in, x, next);
    const std::pmr::vector<Contact<T>> contacts = FindContacts(in, x, std::span<const State<T>>(next));
    if (contacts.empty()) return;
    for (const Contact<T>& contact : contacts) {
      ApplyCorrection(in, contact, contact.correction, [&](int i, const Twist<T, kTurn>& way) {
        next[i].p += way.v;
        if constexpr (kTurn == kSpin) next[i].rotation[0] += way.w;
      });
    }
    for (std::size_t i = 0; i < x.size(); ++i) {
      next[i].v = VelocityBetween(in, x[i].p, next[i].p);
      if constexpr (kTurn == kSpin) next[i].rotation[1] = Divide(T(next[i].rotation[0] - x[i].rotation[0]), in.h);
    }
    CorrectVelocities<T>(in, contacts, x, next);
  }

 private:
  template <typename T>
  struct Contact {
    Candidate candidate;
    Vec2<T> normal;
    Vec2<T> correction;  // m, of the position of a relative to b
    bool held;           // by static friction
  };

  template <typename T, typename H>
  static Vec2<T> PredictedVelocity(const StepInput<T, H>& in, int i, const State<T>& x) {
    return x.v + Scale(in.h, in.Acceleration(i));
  }

  template <typename T, typename H>
  static T PredictedSpin(const StepInput<T, H>& in, int i, const State<T>& x) {
    return x.rotation[1] + in.h * in.AngularAcceleration(i);
  }

  template <typename T, typename H>
  static Vec2<T> VelocityBetween(const StepInput<T, H>& in, const Vec2<T>& from, const Vec2<T>& to) {
    return {Divide(T(to[0] - from[0]), in.h), Divide(T(to[1] - from[1]), in.h)};
  }

  // Splits a change of a relative to b by inverse mass, and along the tangent by inverse inertia too.
  template <typename T, typename Apply>
  static void ApplyCorrection(const StepInput<T>& in, const Contact<T>& contact, const Vec2<T>& change,
                              const Apply& apply) {
    const Candidate& c = contact.candidate;
    Vec2<T> impulse = Scale(in.EffectiveMass(c), change);
    if constexpr (kTurn == kSpin) {
      const Vec2<T> tangent = Perpendicular(contact.normal);
      impulse += Scale(T((in.TangentialMass(c) - in.EffectiveMass(c)) * Dot(tangent, change)), tangent);
    }
    PushContact<kTurn>(in, c, contact.normal, impulse, apply);
  }

  // Returns the contacts at the predicted positions p*; the velocities of `predicted` are not used.
  template <typename T>
  static std::pmr::vector<Contact<T>> FindContacts(const StepInput<T>& in, std::span<const State<T>> x,
                                                   std::span<const State<T>> predicted) {
    using S = Base<T>;
    std::pmr::vector<Contact<T>> contacts(in.scratch);
    for (const Candidate& c : in.candidates) {
      const Separation<T> at = SeparationAt(in, c, [&](int i) -> const Vec2<T>& { return predicted[i].p; });
      const T overlap = at.distance - in.ContactDistance(c);
      if (!(overlap < S(0))) continue;
      Vec2<T> moved = RelativeVelocity<T>(c, [&](int i) -> Vec2<T> { return predicted[i].p - x[i].p; });
      if constexpr (kTurn == kSpin) {
        const auto turned = [&](int i) -> T { return predicted[i].rotation[0] - x[i].rotation[0]; };
        moved += Scale(AlongByTurning(in, c, turned), Perpendicular(at.normal));
      }
      const Vec2<T> slid = moved - Scale(Dot(moved, at.normal), at.normal);
      const T length = Length(slid);
      const bool held = length < in.ContactOf(c).friction * SafeAbs(overlap);
      Vec2<T> correction = Scale(T(-overlap), at.normal);
      if (held) correction -= Scale(length, Quotient(slid, T(length + S(1e-6))));
      contacts.push_back({c, at.normal, correction, held});
    }
    return contacts;
  }

  // Restitution and friction; `next` holds p' and v_b, and then v'.
  template <typename T>
  static void CorrectVelocities(const StepInput<T>& in, std::span<const Contact<T>> contacts,
                                std::span<const State<T>> x, std::span<State<T>> next) {
    using S = Base<T>;
    std::pmr::vector<Vec2<T>> first_plane(x.size(), Vec2<T>(T(S(0)), T(S(0))), in.scratch);  // its dir, per disc
    for (const Contact<T>& contact : contacts) {
      const Candidate& c = contact.candidate;
      const Vec2<T>& n = contact.normal;
      Vec2<T> w = RelativeVelocity<T>(c, [&](int i) -> Vec2<T> { return PredictedVelocity(in, i, x[i]); });
      if constexpr (kTurn == kSpin) {
        w += Scale(AlongByTurning(in, c, [&](int i) -> T { return PredictedSpin(in, i, x[i]); }), Perpendicular(n));
      }
      const T projected =
          Dot(n, RelativeVelocity<T>(c, [&](int i) -> Vec2<T> { return VelocityBetween(in, x[i].p, next[i].p); }));
      const T s = Dot(n, w);
      Vec2<T> change = Scale(T(-s - MinOf(T(S(0)), T(in.ContactOf(c).restitution * projected))), n);

      const Vec2<T> sliding = w - Scale(s, n);
      const T speed = Length(sliding);
      bool slips = false;
      if (!(speed < S(1e-6))) {
        const T bound = in.ContactOf(c).friction * SafeAbs(T((in.ContactOf(c).restitution + S(1)) * projected));
        const Vec2<T> own = Quotient(sliding, speed);
        if (c.plane && c.b == 0) first_plane[c.a] = own;
        change -= Scale(MinOf(speed, bound), c.plane ? first_plane[c.a] : own);
        slips = bound < speed;
      }
      in.Report(c, ModeOf(in.ContactOf(c).friction > S(0), contact.held || !slips));
      ApplyCorrection(in, contact, change, [&](int i, const Twist<T, kTurn>& dv) { Kick(dv, &next[i]); });
    }
  }
};

struct PbdWarp : PbdWarpOf<0> {
  using Spinning = PbdWarpOf<kSpin>;
};

}  // namespace saltus
