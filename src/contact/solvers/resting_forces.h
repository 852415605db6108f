// Forces of contacts that stay closed, at one instant.
//
// Discs under given accelerations touch each other and walls. With n, t the normal and tangent of a contact, b the
// relative acceleration of its two sides and kappa the acceleration at which the turning of the normal opens the gap,
// the forces f_n, f_t satisfy
//
//   0 <= f_n  _|_  n.b + kappa >= 0             no pull, no acceleration into each other (Signorini)
//   |f_t| <= mu f_n, t.b = 0 unless at a bound  where the two do not slide (Coulomb)
//   f_t = -mu f_n sign(v_t)                     where they slide
//
// SolveRestingForces tries, in this order:
//
//   1. of more than kMostDenseRows contacts: block pivoting from the hypothesis that all contacts are active,
//   2. projected Gauss-Seidel over the contacts, in their order,
//   3. after 32, 64, 128, ... sweeps: the linear system of the contact modes that the sweeps have reached,
//   4. after kLongSweeps: block pivoting from these modes; then all combinations of modes, if there are at most
//      kMostHypotheses; else Lemke's method (complementarity.h), refined by block pivoting.
//
// Where all discs that touch slide, friction can jam them (Painleve's paradox): no forces satisfy the conditions, only
// an impulse that ends the sliding does.
#pragma once

#include <span>

#include "contact/solvers/contact_system.h"
#include "saltus/scene/geometry.h"

namespace saltus {

struct RestingContact {
  // How a disc yields to a force along the tangent by turning: not at all if it does not spin.
  struct Turns {
    double radius = 0;           // m
    double inverse_inertia = 0;  // 1/(kg m^2)
  };

  int a = 0;
  int b = -1;                   // -1: a wall
  Vec2d normal{0, 0};           // towards a
  double friction = 0;          // mu
  double mass = 0;              // effective mass, kg
  double tangential_mass = 0;   // along the tangent, where discs that spin turn with it, kg; 0: the same
  double turning = 0;           // kappa, m/s^2
  int sliding = 0;              // sign of v_t; 0 if the two do not slide
  double normal_force = 0;      // N, result
  double tangential_force = 0;  // N, result; along Perpendicular(normal)
  Turns turns_a = {}, turns_b = {};
};

enum class RestingForces {
  kFound,
  kJammed,    // the sweeps diverge, or no combination of contact modes satisfies the conditions, and some slide
  kNotFound,  // not within the limits of iterations, or the input is not finite
};

// Returns the part of the tangential acceleration at a contact that comes from the angular accelerations of its discs,
// `turning`, rad/s^2; 0 if `turning` is empty.
inline double RimAcceleration(const RestingContact& c, std::span<const double> turning) {
  if (turning.empty()) return 0;
  return c.turns_a.radius * turning[c.a] + (c.b >= 0 ? c.turns_b.radius * turning[c.b] : 0.0);
}

// Overwrites the forces of the contacts, the accelerations of the discs, `acceleration` (m/s^2), and the angular ones,
// `turning` (rad/s^2; empty if no disc spins), with those under the forces. All of these are unspecified unless forces
// are found. inverse_mass: per disc, 1/kg; 0 if it does not move. With `iteration_limited`, only a few pivots are tried
// for many contacts. Where discs spin, f_t acts and t.b is measured at the points of contact. `cache`, if given, keeps
// factorizations.
RestingForces SolveRestingForces(std::span<const double> inverse_mass, std::span<Vec2d> acceleration,
                                 std::span<RestingContact> contacts, std::span<double> turning = {},
                                 bool iteration_limited = false, ContactSystem::Cache* cache = nullptr);

}  // namespace saltus
