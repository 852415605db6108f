// What the event-driven model (event.h) keeps of a disc and of a pair of things within a step.
#pragma once

#include "base/time_grid.h"
#include "contact/event/event_roots.h"
#include "saltus/contact/contact_model.h"

namespace saltus::internal {

// The thresholds that event.h states, besides kNodeMargin (time_grid.h): multiples of the scene's natural length, speed
// and acceleration (scene/units.h).
inline constexpr double kRoundingGap = 1e-14;
inline constexpr double kContactGap = 1e-10;
inline constexpr double kSlowSpeed = 1e-6;
inline constexpr double kSharpSpeed = 1e-9;  // slower impacts have a time without derivative
inline constexpr double kStillSpeed = 1e-14;
inline constexpr double kStickSpeed = 1e-9;
inline constexpr double kHeadOn = 1e-9;    // of the closing speed
inline constexpr double kPushing = 1e-11;  // acceleration
inline constexpr double kLargestDrift = 3e-11;
inline constexpr double kArcEnd = 1e-6;          // of the length of an arc
inline constexpr int kMostCuts = 8;              // of arcs on end, where a contact opens or begins to slide
inline constexpr double kLargestGain = 1e-9;     // of the energy in a step, ...
inline constexpr double kLargestOverlap = 1e-9;  // ... beyond which it fails
// How far beyond its end an edge still counts (walls.h), and a disc that slides along it leaves it: lengths.
inline constexpr double kSeam = 1e-12;
inline constexpr int kMaxEvents = 100000;
// After so many impacts in a step, of a pair within a pile without friction that meets more than kCrowdedImpacts times
// again, the largest speed at which it does not bounce doubles with each time, up to kLargestSlowSpeed.
inline constexpr int kManyImpacts = 2000;
inline constexpr int kCrowdedImpacts = 32;
inline constexpr double kLargestSlowSpeed = 1e-2;
// A step is taken at once (event_crowd.h) if it would fail, with at least kFewestCrowd discs; or if a pair within a
// pile meets more than kCrowdedImpacts times, from kCrowd discs on, of fewer with friction after kManyImpacts; or, of
// so many, if kCrowd contacts or more that last are settled together more than kMostSettled times. These bounds are of
// numbers that are no larger if pairs that do not touch are left out, as they are where derivatives are taken.
inline constexpr std::size_t kFewestCrowd = 5;
inline constexpr std::size_t kCrowd = 32;
inline constexpr int kMostSettled = 2;

// How a disc turns; nothing where discs do not spin.
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
  T t;              // s, since the start of the step
  Vec2<T> p, v, a;  // at t; a holds from t on
  bool moved = false, reported = false;
  bool dirty = false;
  bool out = false;  // in a pocket
  int order = 0;     // number of its last event
  int impacts = 0;
  double arc_end = kNever;  // s, until when `a` is to hold, for discs that move around each other
  [[no_unique_address]] DiscTurn<T, kRotation> turn = {};

  Vec2<T> PositionAt(const T& time) const {
    const T s = time - t;
    return p + Scale(s, Vec2<T>(v + Scale(T(s * 0.5), a)));
  }
  Vec2<T> VelocityAt(const T& time) const { return v + Scale(T(time - t), a); }
};

// What a's point of contact does along the tangent relative to b's, given what the centres do, `along`, and how disc i
// turns, turning(i): the same of velocities and of accelerations.
template <int kRotation, typename T, typename S, typename TurningOf>
T AlongSurface(const StepInput<S>& in, const Candidate& c, const T& along, const TurningOf& turning) {
  if constexpr (kRotation == kSpin) {
    const T at_a = along - in.bodies[c.a].radius * turning(c.a);
    return c.plane ? at_a : T(at_a - in.bodies[c.b].radius * turning(c.b));
  } else {
    return along;
  }
}

// Position, velocity and constant acceleration, as values.
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

  bool Touching(double slow = kSlowSpeed) const { return gap <= kContactGap && speed <= slow && speed >= -slow; }
  bool Pushing() const { return acceleration < -kPushing; }
  // So slow and so curved that it parts again before the gap could become negative by more than kContactGap.
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
