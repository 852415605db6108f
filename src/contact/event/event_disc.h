// The motion of one disc between events of the event-driven model (event.h), and how two things approach each other.
//
// A disc has a constant acceleration from its last event on: p(s) = p + v s + a s^2 / 2, and its angle, if it spins,
// is a quadratic too. The gap of a pair is then a polynomial in time, of degree 2 with a line and 4 with a disc or a
// circle. The positions of discs that roll or slide around each other with friction have three terms more
// (EventGroup::SetCurves).
#pragma once

#include <array>
#include <type_traits>

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

// The terms of degree 3 to 5 of a position or an angle, and their contributions to it and its first two derivatives.
template <typename V>
using Curve = std::array<V, 3>;
template <typename T, typename V>
V Combination(const Curve<V>& terms, const T& first, const T& second, const T& third) {
  if constexpr (std::is_same_v<T, V>) {
    return first * terms[0] + second * terms[1] + third * terms[2];
  } else {
    return Scale(first, terms[0]) + Scale(second, terms[1]) + Scale(third, terms[2]);
  }
}
template <typename T, typename V>
V ChangeOfPosition(const Curve<V>& terms, const T& s) {
  return Combination<T, V>(terms, T(s * s * s), T(s * s * s * s), T(s * s * s * s * s));
}
template <typename T, typename V>
V ChangeOfVelocity(const Curve<V>& terms, const T& s) {
  return Combination<T, V>(terms, T(3.0 * (s * s)), T(4.0 * (s * s * s)), T(5.0 * (s * s * s * s)));
}
template <typename T, typename V>
V ChangeOfAcceleration(const Curve<V>& terms, const T& s) {
  return Combination<T, V>(terms, T(6.0 * s), T(12.0 * (s * s)), T(20.0 * (s * s * s)));
}

// The rotation of a disc; empty where discs do not spin.
template <typename T, int kRotation>
struct DiscTurn {};
template <typename T>
struct DiscTurn<T, kSpin> {
  T angle, speed, acceleration;     // rad, rad/s, rad/s^2
  const Curve<T>* curve = nullptr;  // as EventDisc::curve

  // Returns the angle `s` seconds after the last event.
  T AngleAfter(const T& s) const {
    const T after = angle + s * (speed + (0.5 * s) * acceleration);
    return curve == nullptr ? after : T(after + ChangeOfPosition(*curve, s));
  }
  T SpeedAfter(const T& s) const {
    const T after = speed + s * acceleration;
    return curve == nullptr ? after : T(after + ChangeOfVelocity(*curve, s));
  }
  T AccelerationAfter(const T& s) const {
    return curve == nullptr ? acceleration : T(acceleration + ChangeOfAcceleration(*curve, s));
  }
};

// The state of a disc since its last event.
template <typename T, int kRotation = 0>
struct EventDisc {
  T t;                                    // s since the start of the step, of its last event
  Vec2<T> p, v, a;                        // at t; a holds from t on if there is no curve
  bool moved = false;                     // an event has changed its motion
  bool reported = false;                  // a touch of it has been reported
  bool dirty = false;                     // its pairs are to be predicted again
  bool out = false;                       // it lies in a pocket
  double kick = 0;                        // m/s, changes of its velocity by impacts at the time of its last event
  int event = 0;                          // number of its last event
  int impacts = 0;                        // once there are kManyImpacts in the step
  double sub_step_end = kNever;           // s, until when `a` holds if it moves around what it touches
  const Curve<Vec2<T>>* curve = nullptr;  // of its position, in the memory of the step
  [[no_unique_address]] DiscTurn<T, kRotation> turn = {};

  Vec2<T> PositionAt(const T& time) const {
    const T s = time - t;
    const Vec2<T> at = p + Scale(s, Vec2<T>(v + Scale(T(s * 0.5), a)));
    return curve == nullptr ? at : Vec2<T>(at + ChangeOfPosition(*curve, s));
  }
  Vec2<T> VelocityAt(const T& time) const {
    const T s = time - t;
    const Vec2<T> at = v + Scale(s, a);
    return curve == nullptr ? at : Vec2<T>(at + ChangeOfVelocity(*curve, s));
  }
  Vec2<T> AccelerationAt(const T& time) const {
    return curve == nullptr ? a : Vec2<T>(a + ChangeOfAcceleration(*curve, T(time - t)));
  }
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

// Position, velocity and acceleration of a disc as values, without derivatives.
struct Motion {
  Vec2d p, v, a;
  bool curved = false;      // the acceleration is not constant
  Curve<Vec2d> curve = {};  // not set unless it is

  Motion MotionAfter(double s) const {
    Motion after{p + s * (v + (0.5 * s) * a), v + s * a, a};
    if (curved) AddCurve(s, &after);
    return after;
  }
  // Returns the coefficients of the position as a polynomial in time, by ascending power.
  std::array<Vec2d, 6> Coefficients() const {
    const Vec2d none(0, 0);
    return {p, v, 0.5 * a, curved ? curve[0] : none, curved ? curve[1] : none, curved ? curve[2] : none};
  }

 private:
  [[gnu::noinline]] void AddCurve(double s, Motion* after) const {
    after->curved = true;
    after->curve = curve;
    after->p += ChangeOfPosition(curve, s);
    after->v += ChangeOfVelocity(curve, s);
    after->a += ChangeOfAcceleration(curve, s);
    after->curve[0] += 4 * s * curve[1] + 10 * s * s * curve[2];
    after->curve[1] += 5 * s * curve[2];
  }
};

// The relative motion of a pair along its normal.
struct Approach {
  double gap;           // m
  double speed;         // m/s, rate of the gap; negative if it closes
  double acceleration;  // m/s^2, of the gap, including the turning of the normal
  GapPolynomial polynomial;

  bool Touching(double slow = kSlowSpeed) const { return gap <= kContactGap && speed <= slow && speed >= -slow; }
  bool HasClosingForce() const { return acceleration < -kPushing; }
  // Whether the pair is so slow and so curved that it separates before the gap falls below -kContactGap.
  bool Grazing() const { return speed * speed < 2 * acceleration * kContactGap; }
};

// Adds the terms of degree 3 to 5 of two discs to their gap polynomial, whose degree becomes 10. Not inlined, because
// most motions have no such terms.
[[gnu::noinline]] inline void AddCurves(const Motion& a, const Motion& b, GapPolynomial* polynomial) {
  const auto of_a = a.Coefficients(), of_b = b.Coefficients();
  for (std::size_t i = 0; i < of_a.size(); ++i) {
    for (std::size_t j = 3; j < of_a.size(); ++j) {
      const double product = Dot(Vec2d(of_a[i] - of_b[i]), Vec2d(of_a[j] - of_b[j]));
      polynomial->c[i + j] += i < 3 ? 2 * product : product;
    }
  }
  polynomial->degree = 10;
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
  if (a.curved || b.curved) AddCurves(a, b, &out.polynomial);
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
  if (a.curved) {
    for (int k = 0; k < 3; ++k) out.polynomial.c[3 + k] = Dot(wall.normal, a.curve[k]);
    out.polynomial.degree = 5;
  }
  return out;
}

}  // namespace saltus::internal
