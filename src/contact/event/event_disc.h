// The motion of one disc between events of the event-driven model (event.h), and how two things approach each other.
//
// A disc has a constant acceleration from its last event on: p(s) = p + v s + a s^2 / 2, and where discs spin, its
// angle likewise. The gap of a pair is a polynomial in time, of degree 2 with a line and 4 with a disc or a circle.
#pragma once

#include "contact/event/event_roots.h"
#include "contact/thresholds.h"
#include "saltus/contact/contact_model.h"

namespace saltus::internal {

// An event of a step: when it happens, s since the start of the step, and its number in the order of the events.
template <typename T>
struct Instant {
  T time;
  int event = 0;
};

// The rotation of a disc; empty where discs do not spin.
template <typename T, int kRotation>
struct DiscTurn {};
template <typename T>
struct DiscTurn<T, kSpin> {
  T angle, speed, acceleration;  // rad, rad/s, rad/s^2

  // After s seconds.
  T AngleAfter(const T& s) const { return angle + s * (speed + (0.5 * s) * acceleration); }
  T SpeedAfter(const T& s) const { return speed + s * acceleration; }
};

// A disc since the last event that concerned it.
template <typename T, int kRotation = 0>
struct EventDisc {
  T t;                           // s since the start of the step, of its last event
  Vec2<T> p, v, a;               // at t; a holds from t on
  bool moved = false;            // an event has changed its motion
  bool reported = false;         // a touch of it has been reported
  bool dirty = false;            // its pairs are to be predicted again
  bool out = false;              // it lies in a pocket
  double kick = 0;               // m/s, changes of its velocity by impacts at the time of its last event
  int event = 0;                 // number of its last event
  int impacts = 0;               // once there are kManyImpacts in the step
  double sub_step_end = kNever;  // s, until when `a` holds if it moves around what it touches
  [[no_unique_address]] DiscTurn<T, kRotation> turn = {};

  Vec2<T> PositionAt(const T& time) const {
    const T s = time - t;
    return p + Scale(s, Vec2<T>(v + Scale(T(s * 0.5), a)));
  }
  Vec2<T> VelocityAt(const T& time) const { return v + Scale(T(time - t), a); }
};

// Velocity or acceleration of a's point of contact along the tangent, relative to b's. `along` is that of the centres,
// turning(i) the angular velocity or acceleration of disc i.
template <int kRotation, typename T, typename S, typename TurningOf>
T AlongSurface(const StepInput<S>& in, const Candidate& c, const T& along, const TurningOf& turning) {
  if constexpr (kRotation == kSpin) {
    const T at_a = along - in.bodies[c.a].radius * turning(c.a);
    return c.plane ? at_a : T(at_a - in.bodies[c.b].radius * turning(c.b));
  } else {
    return along;
  }
}

template <typename T>
Vec2d ValueOf(const Vec2<T>& a) {
  return {Value(a[0]), Value(a[1])};
}

// Position, velocity and constant acceleration, as values.
struct Motion {
  Vec2d p, v, a;
  Motion After(double s) const { return {p + s * (v + (0.5 * s) * a), v + s * a, a}; }
};

// The relative motion of a pair along its normal.
struct Approach {
  double gap;           // m
  double speed;         // m/s, rate of the gap; negative if it closes
  double acceleration;  // m/s^2, of the gap, including the turning of the normal
  GapPolynomial polynomial;

  bool Touching(double slow = kSlowSpeed) const { return gap <= kContactGap && speed <= slow && speed >= -slow; }
  bool PushedTogether() const { return acceleration < -kPushing; }
  // So slow and so curved that the pair separates before the gap falls below -kContactGap.
  bool Grazing() const { return speed * speed < 2 * acceleration * kContactGap; }
};

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

inline Approach MeasureApproach(const Motion& a, const Wall<double>& wall, double radius) {
  Approach out;
  if (wall.curved()) {
    const Motion center{wall.center, Vec2d(0, 0), Vec2d(0, 0)};
    out = MeasureApproach(a, center, wall.radius + wall.side * radius);
    if (wall.side > 0) return out;
    for (double* x : {&out.gap, &out.speed, &out.acceleration}) *x = -*x;
    for (double& c : out.polynomial.c) c = -c;
    return out;
  }
  out.gap = Dot(wall.normal, a.p) - wall.offset - radius;
  out.speed = Dot(wall.normal, a.v);
  out.acceleration = Dot(wall.normal, a.a);
  out.polynomial.c = {out.gap, out.speed, 0.5 * out.acceleration, 0, 0};
  return out;
}

}  // namespace saltus::internal
