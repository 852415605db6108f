// An impact by Newton's restitution and Coulomb's friction, its adjoint, and how it joins costates.
//
// The impulse is that of contact/impact.h, whose symbols these are.
//
// Adjoint (spec of the saltation matrix: v+ = A v-, and B dq for the turning of the normal by dq): with
// y = lambda_va / m_a - lambda_vb / m_b,
//
//   lambda_v- = lambda_v+ +- (dP/dw)^T y,   lambda_q- = lambda_q+ +- t (dP/dtheta . y) / |q_a - q_b|.
//
// T is double or a Jet; branches are taken on values. SI units.
#pragma once

#include <cmath>
#include <optional>

#include "contact/impact.h"
#include "saltus/physics/scene.h"

namespace saltus {

// The constants of a pair. Inverse masses are 0 for fixed discs and planes.
struct ImpactLaw {
  double inverse_mass_a = 0;
  double inverse_mass_b = 0;
  double restitution = 1;
  double friction = 0;
  double contact_distance = 0;  // m, distance of the centres at the impact, or of the centre to the plane
  bool plane = false;

  double EffectiveMass() const { return 1 / (inverse_mass_a + inverse_mass_b); }
};

inline double InverseMass(const Body& body) { return body.fixed ? 0.0 : 1 / body.mass; }

inline ImpactLaw MakeImpactLaw(const Scene& scene, const Candidate& c) {
  const Body& a = scene.bodies[c.a];
  return {.inverse_mass_a = InverseMass(a),
          .inverse_mass_b = c.plane ? 0.0 : InverseMass(scene.bodies[c.b]),
          .restitution = scene.contact.restitution,
          .friction = scene.contact.friction,
          .contact_distance = a.radius + (c.plane ? 0.0 : scene.bodies[c.b].radius),
          .plane = c.plane};
}

// The plane's boundary with a normal of unit length.
inline HalfPlane<double> MakeHalfPlane(const Plane& plane) {
  const Vec2d normal = plane.normal / plane.normal.norm();
  return {normal, Dot(normal, plane.point)};
}

// Precondition: |normal| = 1. With friction it slips or sticks by Coulomb's law, or as `mode` says.
template <typename T>
Impact<T> MakeImpact(const ImpactLaw& law, const Vec2<T>& normal, const Vec2<T>& w,
                     std::optional<ContactMode> mode = std::nullopt) {
  return MakeImpact<T>(normal, w, law.EffectiveMass(), 1 + law.restitution, law.friction, /*head_on=*/0, mode);
}

// What multiplies the costates of both bodies at an impact: lambda_v gains +-velocity, lambda_q gains +-position, with
// the sign + for a and - for b.
template <typename T>
struct CostateGain {
  Vec2<T> position;
  Vec2<T> velocity;
};

// `y` as above.
template <typename T>
CostateGain<T> ImpactAdjoint(const ImpactLaw& law, const Impact<T>& impact, const Vec2<T>& y) {
  const Vec2<T>& n = impact.normal;
  const Vec2<T> t = Perpendicular(n);
  const double m = law.EffectiveMass(), bounce = (1 + law.restitution) * m;
  const T yn = Dot(n, y), yt = Dot(t, y);
  const T& vn = impact.speed;
  const T& vt = impact.sliding;
  T along_normal = -bounce * yn, along_tangent(0), turning = -bounce * (vt * yn + vn * yt);
  if (impact.mode == ContactMode::kSlip) {
    const double drag = law.friction * SignOf(vt);
    along_normal += bounce * drag * yt;
    turning += bounce * drag * (vt * yt - vn * yn);
  } else if (impact.mode == ContactMode::kStick) {
    along_tangent = -m * yt;
    turning += m * (vn * yt + vt * yn);
  }
  CostateGain<T> gain;
  gain.velocity = Scale(along_normal, n) + Scale(along_tangent, t);
  gain.position = law.plane ? Vec2<T>(T(0), T(0)) : Scale(T(turning / law.contact_distance), t);
  return gain;
}

}  // namespace saltus
