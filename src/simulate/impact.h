// An impact by Newton's restitution and Coulomb's friction, its adjoint, and how it joins costates.
//
// The impulse is that of contact/law/impact.h, whose symbols these are.
//
// Adjoint (spec of the saltation matrix: v+ = A v-, and B dq for the turning of the normal by dq): with
// y = lambda_va / m_a - lambda_vb / m_b,
//
//   lambda_v- = lambda_v+ +- (dP/dw)^T y,   lambda_q- = lambda_q+ +- t (dP/dtheta . y) / |q_a - q_b|.
//
// Of discs that spin, p_t turns them too: what it changes has the costate y.t - r_a lambda_wa / I_a - r_b lambda_wb /
// I_b, while y.t alone is that of the turning of p_n n + p_t t; and where they stick, lambda_w- = lambda_w+ + r m'
// times the former, with m' the mass of a stick. Angles have no part in an impact.
//
// T is double or a Jet; branches are taken on values. SI units.
#pragma once

#include <array>
#include <optional>

#include "contact/law/impact.h"
#include "saltus/scene/materials.h"
#include "saltus/scene/scene.h"

namespace saltus {

// The constants of a pair. Inverse masses are 0 for fixed discs and planes, inverse moments of inertia also for discs
// that cannot spin.
struct ImpactConstants {
  double inverse_mass_a = 0;
  double inverse_mass_b = 0;
  double restitution = 1;
  double friction = 0;
  double contact_distance = 0;  // m, distance of the centres at the impact, or of the centre to the plane
  bool plane = false;
  std::array<double, 2> radius = {0, 0};           // m, of a and b, if they spin
  std::array<double, 2> inverse_inertia = {0, 0};  // 1/(kg m^2)

  bool Spins() const { return inverse_inertia[0] > 0 || inverse_inertia[1] > 0; }
  double EffectiveMass() const { return 1 / (inverse_mass_a + inverse_mass_b); }
  // Returns the effective mass of a sticking impact along the tangent, kg.
  double StickMass() const {
    const double turning = radius[0] * radius[0] * inverse_inertia[0] + radius[1] * radius[1] * inverse_inertia[1];
    return 1 / (inverse_mass_a + inverse_mass_b + turning);
  }
  // Returns the largest |v_t| that friction can stop, as a multiple of |v_n|.
  double MaxStickRatio() const {
    const double drag = friction * (1 + restitution);
    return Spins() ? drag * EffectiveMass() / StickMass() : drag;
  }
};

inline double InverseMass(const Body& body) { return body.fixed ? 0.0 : 1 / body.mass; }

inline ImpactConstants MakeImpactConstants(const Scene& scene, const Candidate& c) {
  const Body& a = scene.bodies[c.a];
  PairContact contact{scene.contact.restitution, scene.contact.friction};
  if (!scene.materials.empty()) {
    contact = ContactBetween(scene, a.material, c.plane ? scene.planes[c.b].material : scene.bodies[c.b].material);
  }
  ImpactConstants law{.inverse_mass_a = InverseMass(a),
                      .inverse_mass_b = c.plane ? 0.0 : InverseMass(scene.bodies[c.b]),
                      .restitution = contact.restitution,
                      .friction = contact.friction,
                      .contact_distance = a.radius + (c.plane ? 0.0 : scene.bodies[c.b].radius),
                      .plane = c.plane};
  for (int side = 0; side < (c.plane ? 1 : 2); ++side) {
    const Body& body = scene.bodies[side == 0 ? c.a : c.b];
    if (!body.Spins()) continue;
    law.radius[side] = body.radius;
    law.inverse_inertia[side] = 1 / body.MomentOfInertia();
  }
  return law;
}

// Returns the half-plane with a normal of unit length.
inline HalfPlane<double> MakeHalfPlane(const Plane& plane) {
  const Vec2d normal = plane.normal / plane.normal.norm();
  return {normal, Dot(normal, plane.point)};
}

// Returns distance and normal of a pair when disc i of the scene is at positions[i].
template <typename Positions>
Separation<double> SeparationOf(const Scene& scene, const Candidate& c, const Positions& positions) {
  if (c.plane) return Separate<double>(positions[c.a], MakeHalfPlane(scene.planes[c.b]));
  return Separate<double>(positions[c.a], positions[c.b]);
}

// Returns the impact with the mode by Coulomb's law, or in `mode` if it is given. Precondition: |normal| = 1.
template <typename T>
Impact<T> MakeImpact(const ImpactConstants& law, const Vec2<T>& normal, const Vec2<T>& w,
                     std::optional<ContactMode> mode = std::nullopt) {
  return MakeImpact<T>(normal, w, law.EffectiveMass(), 1 + law.restitution, law.friction, /*head_on=*/0, mode);
}

// Returns r_a x_a + r_b x_b for numbers x of both discs, such as angular velocities.
template <typename T>
T RimVelocity(const ImpactConstants& law, const std::array<T, 2>& of) {
  return T(law.radius[0] * of[0] + law.radius[1] * of[1]);
}

// Returns the impact of discs with the angular velocities `spin`, rad/s.
template <typename T>
Impact<T> MakeImpact(const ImpactConstants& law, const Vec2<T>& normal, const Vec2<T>& w, const std::array<T, 2>& spin,
                     std::optional<ContactMode> mode = std::nullopt) {
  if (!law.Spins()) return MakeImpact<T>(law, normal, w, mode);
  const T speed = Dot(normal, w), sliding = Dot(Perpendicular(normal), w) - RimVelocity(law, spin);
  return MakeImpact<T>(normal,
                       speed,
                       sliding,
                       law.EffectiveMass(),
                       law.StickMass(),
                       1 + law.restitution,
                       law.friction,
                       /*head_on=*/0,
                       mode);
}

// Returns the change of the angular velocity of a (side 0) or b by an impact, rad/s.
template <typename T>
T SpinGain(const ImpactConstants& law, int side, const Impact<T>& impact) {
  return T(-law.radius[side] * law.inverse_inertia[side] * impact.tangential);
}

// The changes of the costates of both bodies at an impact, backwards: lambda_v gains +-velocity, lambda_q +-position,
// with + for a and - for b; lambda_w gains the radius times `spin`.
template <typename T>
struct CostateGain {
  Vec2<T> position;
  Vec2<T> velocity;
  T spin = T(0.0);
};

// Returns the adjoint of an impact. `y` as above; `spin`: angular velocities before, `costate`: the lambda_w after it.
template <typename T>
CostateGain<T> ImpactAdjoint(const ImpactConstants& law, const Impact<T>& impact, const Vec2<T>& y,
                             const std::array<T, 2>& spin = {T(0.0), T(0.0)},
                             const std::array<T, 2>& costate = {T(0.0), T(0.0)}) {
  const Vec2<T>& n = impact.normal;
  const Vec2<T> t = Perpendicular(n);
  const double bounce = (1 + law.restitution) * law.EffectiveMass(), m = law.StickMass();
  const T yn = Dot(n, y), yt = Dot(t, y);
  const T& vn = impact.speed;
  const T& vt = impact.sliding;
  T y_drag = yt, w_t = vt;  // the costate of p_t, and t.w
  if (law.Spins()) {
    y_drag -= RimVelocity<T>(law, {T(law.inverse_inertia[0] * costate[0]), T(law.inverse_inertia[1] * costate[1])});
    w_t += RimVelocity(law, spin);
  }
  T along_normal = -bounce * yn, along_tangent(0), turning = -bounce * (w_t * yn + vn * yt);
  if (impact.mode == ContactMode::kSlip) {
    const double drag = law.friction * SignOf(vt);
    along_normal += bounce * drag * y_drag;
    turning += bounce * drag * (w_t * y_drag - vn * yn);
  } else if (impact.mode == ContactMode::kStick) {
    along_tangent = -m * y_drag;
    turning += m * (vn * y_drag + vt * yn);
  }
  CostateGain<T> gain;
  gain.velocity = Scale(along_normal, n) + Scale(along_tangent, t);
  gain.spin = -along_tangent;
  gain.position = law.plane ? Vec2<T>(T(0), T(0)) : Scale(T(turning / law.contact_distance), t);
  return gain;
}

}  // namespace saltus
