// The impulse of an impact, by Newton's restitution and Coulomb's friction: of the event-driven model, of optimal
// control and of the audit. (The closed forms of exact/ have one of their own, to check it.)
//
// Discs a and b (or disc a and a plane) meet with unit normal n towards a, tangent t = n turned by a quarter, relative
// velocity w = v_a - v_b, v_n = n.w < 0, v_t = t.w and effective mass m = 1 / (1/m_a + 1/m_b). The impulse on a is
//
//   P = p_n n + p_t t,   p_n = -(1 + e) m v_n,   p_t = 0                       frictionless
//                                                     -mu sign(v_t) p_n        slip
//                                                     -m v_t                   stick
//
// Of discs that spin, v_t is that of the points of contact, v_t = t.w - r_a w_a - r_b w_b, with w_a and w_b their
// angular velocities, and the mass of a stick 1 / (1/m_a + 1/m_b + r_a^2/I_a + r_b^2/I_b); p_t changes w_a by -r_a
// p_t/I_a, and w_b by -r_b p_t/I_b. The arms are along n, so that neither part of the impulse changes the other's
// velocity.
//
// T is double or a Jet, P either as well; branches are taken on values. SI units, or any others that fit.
#pragma once

#include <cmath>
#include <optional>

#include "saltus/contact/step_input.h"
#include "saltus/scene/geometry.h"

namespace saltus {

template <typename T>
struct Impact {
  Vec2<T> normal;  // towards a
  T speed;         // v_n, m/s
  T sliding;       // v_t, m/s
  ContactMode mode = ContactMode::kFrictionless;
  Vec2<T> impulse;        // on a, N s
  T tangential = T(0.0);  // its part along t
};

// The normal and the tangential part of an impulse, p_n and p_t, N s.
template <typename T>
struct ImpulseParts {
  T normal, tangential;
};

// Returns the impulse in a given mode, sliding in the direction `sign`; it is linear in the velocities. `bounce` is
// 1 + e. Without friction p_t has no value, but its derivative with respect to friction.
template <typename T, typename P>
ImpulseParts<T> ImpulseInMode(ContactMode mode, const T& speed, const T& sliding, double sign, const P& mass,
                              const P& stick_mass, const P& bounce, const P& friction) {
  const T normal = -bounce * mass * speed;
  if (mode == ContactMode::kStick) return {normal, T(-stick_mass * sliding)};
  return {normal, T(-friction * sign * normal)};
}

// Returns the impulse of an impact, with the mode by Coulomb's law unless `mode` is given. `sliding` is v_t,
// `stick_mass` the effective mass along t. An impact whose |v_t| is at most `head_on` times its |v_n| has no direction
// of sliding. Precondition: |normal| = 1.
template <typename T, typename P>
Impact<T> MakeImpact(const Vec2<T>& normal, const T& speed, const T& sliding, const P& mass, const P& stick_mass,
                     const P& bounce, const P& friction, double head_on = 0,
                     std::optional<ContactMode> mode = std::nullopt) {
  const Vec2<T> tangent = Perpendicular(normal);
  Impact<T> impact{normal, speed, sliding, ContactMode::kFrictionless, Vec2<T>::Zero()};
  if (Value(friction) > 0) impact.mode = ContactMode::kSlip;
  const bool no_direction = impact.mode == ContactMode::kFrictionless &&
                            std::abs(Value(impact.sliding)) <= head_on * std::abs(Value(impact.speed));
  const double sign = no_direction ? 0.0 : SignOf(impact.sliding);
  ImpulseParts<T> parts =
      ImpulseInMode(impact.mode, impact.speed, impact.sliding, sign, mass, stick_mass, bounce, friction);
  const bool slips = mode ? *mode == ContactMode::kSlip
                          : Value(stick_mass) * std::abs(Value(impact.sliding)) > std::abs(Value(parts.tangential));
  if (impact.mode == ContactMode::kSlip && !slips) {
    impact.mode = ContactMode::kStick;
    parts = ImpulseInMode(impact.mode, impact.speed, impact.sliding, sign, mass, stick_mass, bounce, friction);
  }
  impact.tangential = parts.tangential;
  impact.impulse = Scale(parts.normal, normal) + Scale(parts.tangential, tangent);
  return impact;
}

// Returns the impulse for discs that do not spin, given the relative velocity w.
template <typename T, typename P>
Impact<T> MakeImpact(const Vec2<T>& normal, const Vec2<T>& w, const P& mass, const P& bounce, const P& friction,
                     double head_on = 0, std::optional<ContactMode> mode = std::nullopt) {
  const T speed = Dot(normal, w), sliding = Dot(Perpendicular(normal), w);
  return MakeImpact<T>(normal, speed, sliding, mass, mass, bounce, friction, head_on, mode);
}

}  // namespace saltus
