// Impulses of a crowd of discs (event_crowd.h), of which any may depend on all others.
#pragma once

#include <span>

#include "saltus/scene/geometry.h"

namespace saltus {

// A direction along which disc a must not come closer to b than `apart` allows.
struct CrowdRow {
  int a = 0;
  int b = -1;  // -1: a plane
  Vec2d direction{0, 0};
  double apart = 0;    // m/s
  double impulse = 0;  // N s, result
};

// The impulses f >= 0 and the velocities under them with direction.(v_a - v_b) + apart >= 0, and = 0 where f > 0: the
// least kinetic energy of the change of velocity. Overwrites `velocity`, per disc. inverse_mass: per disc, 1/kg; 0 if
// it does not move. False if they are not found.
//
// Sweeps (projected Gauss-Seidel) suffice where few rows depend on each other. Where many do, an interior-point method
// (Mehrotra 1992) finds which of them press, in some tens of steps however many they are, and an augmented Lagrangian
// the last digits. Its matrices, of the velocities, are symmetric and positive definite, and as sparse as the contacts.
bool SolveCrowdImpulses(std::span<const double> inverse_mass, std::span<Vec2d> velocity, std::span<CrowdRow> rows);

}  // namespace saltus
