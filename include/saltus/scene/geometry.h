// Planar vectors, and the gap and normal of two discs or of a disc and a wall, for all contact models.
#pragma once

#include <Eigen/Core>

#include "saltus/base/scalar.h"
#include "saltus/base/smooth_math.h"

namespace saltus {

// [x, y]. Not aligned, so that an array of body states is a flat array of scalars.
template <typename T>
using Vec2 = Eigen::Matrix<T, 2, 1, Eigen::DontAlign>;
using Vec2d = Vec2<double>;

// Returns the scalar product a . b; one of the two may have the base scalar (double beside Jets).
template <typename A, typename B>
auto Dot(const Vec2<A>& a, const Vec2<B>& b) -> decltype(a[0] * b[0]) {
  return a[0] * b[0] + a[1] * b[1];
}

// Returns a rotated counter-clockwise by a quarter turn. Perpendicular(normal) is the tangent t of a contact everywhere
// in the library, except in rigid_bodies.h.
template <typename T>
Vec2<T> Perpendicular(const Vec2<T>& a) {
  return Vec2<T>(-a[1], a[0]);
}

// Returns |a|, with derivative 0 at a = 0.
template <typename T>
T Length(const Vec2<T>& a) {
  return SafeSqrt(T(a[0] * a[0] + a[1] * a[1]));
}

// Returns s * a; s and the entries of a may differ in type (base scalar times Jet and the reverse).
template <typename A, typename B>
auto Scale(const A& s, const Vec2<B>& a) -> Vec2<decltype(s * a[0])> {
  return {s * a[0], s * a[1]};
}

// Returns a / s, with the bits of the scalar quotient in each entry.
template <typename T>
Vec2<T> Quotient(const Vec2<T>& a, const T& s) {
  return Vec2<T>(Divide(a[0], s), Divide(a[1], s));
}

// The half-plane { x : normal . x >= offset }, |normal| = 1.
template <typename S>
struct HalfPlane {
  Vec2<S> normal;
  S offset;  // m
};

// One side of a straight line or of a circle, which may be a point. A disc with centre x touches it where Separate() is
// the radius of the disc.
template <typename S>
struct Wall {
  Vec2<S> normal = Vec2<S>::Zero();  // of a line, |normal| = 1; discs are where normal . x >= offset
  S offset = S(0);                   // m
  int side = 0;                      // 0: a line; 1: discs are outside a circle, -1: inside
  int material = 0;                  // 0: none; else 1 + the index into Scene::materials (as BodyConstants has it)
  Vec2<S> center = Vec2<S>::Zero();  // m, of the circle
  S radius = S(0);                   // m; 0: a point

  bool curved() const { return side != 0; }
};

// Distance and normal of a disc relative to another disc or to a wall.
template <typename T>
struct Separation {
  T distance;      // m, between the centres, or from the centre to the wall; negative behind it
  Vec2<T> normal;  // unit vector towards the first disc, `a`; constant for a line, (1, 0) for coinciding centres
};

// Returns the separation of a disc with centre `a` from a disc with centre `b`. Radii are not subtracted: the gap is
// `distance` less both radii.
template <typename T>
Separation<T> Separate(const Vec2<T>& a, const Vec2<T>& b) {
  const Vec2<T> d = a - b;
  const T distance = Length(d);
  if (distance == T(0)) return {distance, Vec2<T>(T(1), T(0))};
  return {distance, Quotient(d, distance)};
}

// Returns the separation of a disc with centre `a` from a half-plane.
template <typename T>
Separation<T> Separate(const Vec2<T>& a, const HalfPlane<Base<T>>& plane) {
  return {Dot(plane.normal, a) - plane.offset, plane.normal.template cast<T>()};
}

// Returns the separation of a disc with centre `a` from a wall; within an arc the normal points towards its centre.
template <typename T>
Separation<T> Separate(const Vec2<T>& a, const Wall<Base<T>>& wall) {
  using S = Base<T>;
  if (!wall.curved()) return {Dot(wall.normal, a) - wall.offset, wall.normal.template cast<T>()};
  const Separation<T> center = Separate<T>(a, Vec2<T>(wall.center.template cast<T>()));
  const S side = S(wall.side);
  return {side * (center.distance - wall.radius), Scale(side, center.normal)};
}

}  // namespace saltus
