// Scenes of many discs, for benchmarks, tests and studies. The same seed gives the same scene everywhere.
#pragma once

#include <cstdint>

#include "saltus/physics/scene.h"

namespace saltus {

struct GasOptions {
  int discs = 100;         // 1 to 100 000
  double radius = 0.05;    // m
  double fraction = 0.2;   // of the box that discs cover; at most 0.35
  double speed = 1;        // m/s, root mean square
  double restitution = 1;  // of discs and walls
  double duration = 1;     // s
  int steps = 480;
};

// Discs of 1 kg in a square box of four walls, on a disturbed lattice, with normally distributed velocities; no two
// overlap. The loss is the mean squared distance of all discs from the middle, plus the effort of a force on the first
// disc, zero at the start. All velocities are free. Precondition: every option is in range.
Scene GasInABox(const GasOptions& options, std::uint64_t seed);

struct BreakOptions {
  int discs = 16;            // the cue ball included; 2 to 100 000
  double radius = 0.028575;  // m, and the mass in kg, of a pool ball
  double mass = 0.17;
  double gap = 1e-2;  // between neighbours in the rack, of the radius; at most 1
  double speed = 8;   // m/s, of the cue ball
  double restitution = 0.95;
  double duration = 0.25;  // s
  int steps = 1000;
};

// A cue ball on its way to a triangle of discs, which are disturbed by up to a quarter of their gap, so that no two
// impacts are simultaneous. No walls. The loss is the mean squared distance of all discs from the place of the first
// one in the rack, plus the effort of a force on the cue ball, zero at the start. The velocity of the cue ball is free.
// Precondition: as above.
Scene BilliardBreak(const BreakOptions& options, std::uint64_t seed);

}  // namespace saltus
