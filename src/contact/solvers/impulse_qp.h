// Contact impulses of many coupled discs as a convex quadratic program.
#pragma once

#include <span>

#include "saltus/scene/geometry.h"

namespace saltus {

// A direction along which disc a may not come closer to b than `apart` allows.
struct ImpulseRow {
  int a = 0;
  int b = -1;  // -1: a wall
  Vec2d direction{0, 0};
  double apart = 0;    // m/s
  double impulse = 0;  // N s, result
};

// Finds impulses f and the velocities under them with
//
//   0 <= f  _|_  direction.(v_a - v_b) + apart >= 0,
//
// the conditions of the smallest kinetic energy of the change of velocity. Overwrites `velocity`, per disc.
// inverse_mass: per disc, 1/kg; 0 if it does not move. Returns false if they are not found.
//
// Projected Gauss-Seidel suffices where few rows depend on each other. Where many do, an interior-point method
// (Mehrotra 1992) finds the active rows, in some tens of steps whatever their number, and an augmented Lagrangian
// refines the result to rounding. The matrices of both, of the velocities, are symmetric, positive definite and as
// sparse as the contacts.
bool SolveImpulseQp(std::span<const double> inverse_mass, std::span<Vec2d> velocity, std::span<ImpulseRow> rows);

}  // namespace saltus
