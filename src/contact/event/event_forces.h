// Forces of contacts that stay closed for a while: the smallest part of event.h that is not a template.
//
// Discs under given accelerations press against each other and against planes. With n, t the normal and tangent of a
// contact, b the relative acceleration of its two sides and kappa the acceleration at which the normal's own turning
// opens the gap, the forces f_n, f_t are such that
//
//   0 <= f_n  _|_  n.b + kappa >= 0            no pull, no acceleration into each other
//   |f_t| <= mu f_n, t.b = 0 unless at a bound  where the two do not slide
//   f_t = -mu f_n sign(v_t)                     where they do
//
// Projected Gauss-Seidel, in the order of the contacts, finds which contacts press, stick and slip; where it takes
// long, as in a high stack, the forces then come from one linear system; where it goes in circles, all possibilities
// are tried, if there are few contacts, or else they come by Lemke's method (lemke.h). Where all discs that touch
// slide, friction can wedge them in: then no forces satisfy this, only an impulse that ends the sliding does.
#pragma once

#include <span>

#include "saltus/scene/geometry.h"

namespace saltus {

struct PressingContact {
  // How a disc gives way to a force along the tangent by turning: not at all if it does not spin.
  struct Turns {
    double radius = 0;           // m
    double inverse_inertia = 0;  // 1/(kg m^2)
  };

  int a = 0;
  int b = -1;                   // -1: a plane
  Vec2d normal{0, 0};           // towards a
  double mass = 0;              // effective mass, kg
  double tangential_mass = 0;   // along the tangent, where discs that spin turn with it, kg; 0: the same
  double turning = 0;           // kappa, m/s^2
  int sliding = 0;              // sign of v_t; 0 if the two do not slide
  double normal_force = 0;      // N, result
  double tangential_force = 0;  // N, result; along Perpendicular(normal)
  Turns turns_a = {}, turns_b = {};
};

enum class Pressing {
  kSolved,
  kWedged,    // the discs wedge: it diverges, or none of all possibilities is one
  kUnsolved,  // forces were not found within the limit of iterations, or what is given is not finite
};

// Of the acceleration along the tangent at a contact, what comes from the turning of its discs; zero if `turning`,
// their angular accelerations, rad/s^2, is empty.
inline double RimAcceleration(const PressingContact& c, std::span<const double> turning) {
  if (turning.empty()) return 0;
  return c.turns_a.radius * turning[c.a] + (c.b >= 0 ? c.turns_b.radius * turning[c.b] : 0.0);
}

// Overwrites the forces, and `acceleration` (per disc, m/s^2) with the one under them; so `turning`, the angular
// accelerations (rad/s^2), which is empty if no disc spins. inverse_mass: per disc, 1/kg; 0 if it does not move. Unless
// solved, none is of use. If `hasty`, what many contacts do is guessed a few times only. Where discs spin, f_t acts and
// t.b is measured at the points of contact.
Pressing SolvePressingForces(double friction, std::span<const double> inverse_mass, std::span<Vec2d> acceleration,
                             std::span<PressingContact> contacts, std::span<double> turning = {}, bool hasty = false);

// How far a disc that rests and sticks is carried along its tangent, as a multiple of the height from which it is
// dropped on its contact, until it rests again. `pressing` (> 0) and `tangential` are the accelerations at which it
// flies, m/s^2; |tangential| < friction * pressing. Infinite for restitution 1: it does not come to rest.
double DriftOfBounces(double tangential, double pressing, double friction, double restitution);

}  // namespace saltus
