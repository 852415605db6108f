// One step of the event-driven model (event.h), as an object: the discs and pairs of the step and the queue of events.
//
// Every disc carries the time since which its acceleration is constant, and is moved on only when something happens to
// it; discs that never meet therefore do not influence each other's bits. All decisions are taken on values.
#pragma once

#include <glog/logging.h>

#include <algorithm>
#include <cmath>
#include <memory_resource>
#include <vector>

#include "saltus/contact/contact_model.h"
#include "saltus/contact/event_roots.h"

namespace saltus::internal {

// Position, velocity and constant acceleration of a disc, as values.
struct Motion {
  Vec2d p, v, a;
  Motion After(double s) const { return {p + s * (v + (0.5 * s) * a), v + s * a, a}; }
};

// How the two sides of a pair move relative to each other.
struct Approach {
  double gap;           // m
  double speed;         // m/s, of the gap; negative if closing
  double acceleration;  // m/s^2, of the gap, the turning of the normal included
  GapPolynomial polynomial;
};

inline Approach MeasureApproach(const Motion& a, const HalfPlane<double>& plane, double radius) {
  Approach out;
  out.gap = Dot(plane.normal, a.p) - plane.offset - radius;
  out.speed = Dot(plane.normal, a.v);
  out.acceleration = Dot(plane.normal, a.a);
  out.polynomial.c = {out.gap, out.speed, 0.5 * out.acceleration, 0, 0};
  return out;
}

inline Approach MeasureApproach(const Motion& a, const Motion& b, double radius) {
  const Separation<double> at = Separate<double>(a.p, b.p);
  const Vec2d d = a.p - b.p, w = a.v - b.v, q = a.a - b.a;
  const double sliding = Dot(Perpendicular(at.normal), w);
  Approach out;
  out.gap = at.distance - radius;
  out.speed = Dot(at.normal, w);
  out.acceleration = Dot(at.normal, q) + (at.distance > 0 ? sliding * sliding / at.distance : 0.0);
  out.polynomial.c = {
      out.gap * (at.distance + radius), 2 * Dot(d, w), Dot(w, w) + Dot(d, q), Dot(w, q), 0.25 * Dot(q, q)};
  return out;
}

template <typename T>
class EventStep {
 public:
  using State = BodyState<T, 0>;
  static_assert(std::is_same_v<Base<T>, double>, "the event-driven model computes in double");

  // See event.h for what these are.
  static constexpr double kNodeMargin = 1e-9;   // of the step
  static constexpr double kContactGap = 1e-11;  // m
  static constexpr double kSlowSpeed = 1e-6;    // m/s
  static constexpr double kStillSpeed = 1e-14;  // m/s
  static constexpr double kPushing = 1e-9;      // m/s^2
  static constexpr int kMaxEvents = 100000;

  EventStep(const StepInput<T>& in, std::span<const State> x)
      : in_(in), limit_(in.h * (1 - kNodeMargin)), discs_(in.scratch), pairs_(in.candidates.size(), in.scratch) {
    discs_.reserve(x.size());
    for (int i = 0; i < static_cast<int>(x.size()); ++i) {
      discs_.push_back({T(0.0), x[i].p, x[i].v, in.Acceleration(i)});
    }
  }

  // True if some pair may touch within the step.
  bool AnythingMayHappen() const {
    for (const Candidate& c : in_.candidates) {
      if (!StaysApart(ApproachAt(c, 0).polynomial, in_.h)) return true;
    }
    return false;
  }

  void Run() {
    for (int q = 0; q < num_pairs(); ++q) Predict(q);
    for (int count = 0; count < 2 * kMaxEvents; ++count) {
      inelastic_ = count >= kMaxEvents;
      const int q = NextPair();
      if (q < 0) return;
      Resolve(q);
      for (int other = 0; other < num_pairs(); ++other) {
        if (IsDirty(other)) Predict(other);
      }
      for (Disc& disc : discs_) disc.dirty = false;
    }
  }

  // The state of disc i at the end of the step; nothing to be said if no event concerned it.
  bool Moved(int i) const { return discs_[i].moved; }
  State End(int i) const {
    const T end(in_.h);
    return {PositionAt(i, end), VelocityAt(i, end)};
  }

 private:
  struct Disc {
    T t;              // s, since the start of the step
    Vec2<T> p, v, a;  // at t; a holds from t on
    bool moved = false;
    bool dirty = false;
    int order = 0;  // number of its last event
  };
  struct Pair {
    double next = kNever;  // s, its next event
  };

  int num_pairs() const { return static_cast<int>(pairs_.size()); }
  bool IsDirty(int q) const {
    const Candidate& c = in_.candidates[q];
    return discs_[c.a].dirty || (!c.plane && discs_[c.b].dirty);
  }
  int NextPair() const {
    int next = -1;
    double time = limit_;
    for (int q = 0; q < num_pairs(); ++q) {
      if (pairs_[q].next < time) {
        time = pairs_[q].next;
        next = q;
      }
    }
    return next;
  }

  Vec2<T> PositionAt(int i, const T& time) const {
    const Disc& disc = discs_[i];
    const T s = time - disc.t;
    return disc.p + Scale(s, Vec2<T>(disc.v + Scale(T(s * 0.5), disc.a)));
  }
  Vec2<T> VelocityAt(int i, const T& time) const {
    const Disc& disc = discs_[i];
    return disc.v + Scale(T(time - disc.t), disc.a);
  }
  Vec2<T> RelativeVelocityAt(const Candidate& c, const T& time) const {
    return RelativeVelocity<T>(c, [&](int i) { return VelocityAt(i, time); });
  }
  Separation<T> SeparationAtTime(const Candidate& c, const T& time) const {
    return SeparationAt(in_, c, [&](int i) { return PositionAt(i, time); });
  }

  Motion MotionAt(int i, double time) const {
    const Disc& disc = discs_[i];
    const auto value = [](const Vec2<T>& a) { return Vec2d(Value(a[0]), Value(a[1])); };
    return Motion{value(disc.p), value(disc.v), value(disc.a)}.After(time - Value(disc.t));
  }
  Approach ApproachAt(const Candidate& c, double time) const {
    const Motion a = MotionAt(c.a, time);
    if (c.plane) return MeasureApproach(a, in_.planes[c.b], in_.ContactDistance(c));
    return MeasureApproach(a, MotionAt(c.b, time), in_.ContactDistance(c));
  }

  // The last time at which something happened to the pair.
  const T& LastTime(const Candidate& c) const {
    if (c.plane || discs_[c.a].order >= discs_[c.b].order) return discs_[c.a].t;
    return discs_[c.b].t;
  }

  void Predict(int q, bool ignore_start = false) {
    const Candidate& c = in_.candidates[q];
    const double now = Value(LastTime(c));
    const Approach approach = ApproachAt(c, now);
    pairs_[q].next = now + FirstClosing(approach.polynomial, std::max(limit_ - now, 0.0), ignore_start);
  }

  void Resolve(int q) {
    const Candidate& c = in_.candidates[q];
    ++order_;
    Impact(c, ImpactTime(c, pairs_[q].next));
  }

  // The predicted time, corrected by one Newton step in T: its derivative is that of the impact time. A pair that
  // overlaps has no impact time; it meets at its last event.
  T ImpactTime(const Candidate& c, double predicted) const {
    const T time(predicted);
    const Separation<T> at = SeparationAtTime(c, time);
    const T gap = at.distance - in_.ContactDistance(c);
    if (Value(gap) < -kContactGap) return LastTime(c);
    const double speed = Value(Dot(at.normal, RelativeVelocityAt(c, time)));
    return time - Divide(gap, speed);
  }

  void MoveTo(int i, const T& time) {
    Disc& disc = discs_[i];
    const Vec2<T> p = PositionAt(i, time), v = VelocityAt(i, time);
    disc.p = p;
    disc.v = v;
    disc.t = time;
    disc.moved = disc.dirty = true;
    disc.order = order_;
  }

  void Impact(const Candidate& c, const T& time) {
    MoveTo(c.a, time);
    if (!c.plane) MoveTo(c.b, time);
    const Separation<T> at = SeparationAtTime(c, time);
    const Vec2<T> w = RelativeVelocityAt(c, time), tangent = Perpendicular(at.normal);
    const T speed = Dot(at.normal, w), sliding = Dot(tangent, w);
    const T& friction = in_.contact.friction;
    const T mass = in_.EffectiveMass(c);
    const T bounce = inelastic_ ? T(1.0) : T(in_.contact.restitution + 1.0);
    const T normal_impulse = -bounce * mass * speed;
    T tangential_impulse = -friction * SignOf(sliding) * normal_impulse;
    ContactMode mode = Value(friction) > 0 ? ContactMode::kSlip : ContactMode::kFrictionless;
    if (mode == ContactMode::kSlip && !(Value(mass) * std::abs(Value(sliding)) > std::abs(Value(tangential_impulse)))) {
      mode = ContactMode::kStick;
      tangential_impulse = -mass * sliding;
    }
    const Vec2<T> impulse = Scale(normal_impulse, at.normal) + Scale(tangential_impulse, tangent);
    ApplyImpulse(in_, c, impulse, [&](int i, const Vec2<T>& dv) { discs_[i].v += dv; });
    in_.Report(c, mode, std::clamp(Value(time), 0.0, in_.h));
  }

  const StepInput<T>& in_;
  double limit_;  // s, events after it are left to the next step
  std::pmr::vector<Disc> discs_;
  std::pmr::vector<Pair> pairs_;
  int order_ = 0;
  bool inelastic_ = false;
};

}  // namespace saltus::internal
