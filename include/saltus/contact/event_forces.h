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
// Solved by projected Gauss-Seidel, in the order of the contacts. Where all discs that touch slide, friction can wedge
// them in: then no forces satisfy this, only an impulse that ends the sliding does.
#pragma once

#include <span>

#include "saltus/physics/geometry.h"

namespace saltus {

struct PressingContact {
  int a = 0;
  int b = -1;                   // -1: a plane
  Vec2d normal;                 // towards a
  double mass = 0;              // effective mass, kg
  double turning = 0;           // kappa, m/s^2
  int sliding = 0;              // sign of v_t; 0 if the two do not slide
  double normal_force = 0;      // N, result
  double tangential_force = 0;  // N, result; along Perpendicular(normal)
};

// Overwrites the forces, and `acceleration` (per disc, m/s^2) with the one under them. inverse_mass: per disc, 1/kg; 0
// if it does not move. False if the discs wedge; then neither is of use.
bool SolvePressingForces(double friction, std::span<const double> inverse_mass, std::span<Vec2d> acceleration,
                         std::span<PressingContact> contacts);

// Pseudo-inverse of a small square matrix, for equations of which some may follow from others. `matrix`: n x n, row by
// row; overwritten.
void PseudoInvert(int n, std::span<double> matrix);

}  // namespace saltus
