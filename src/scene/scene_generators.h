// Scenes of many discs, for benchmarks, tests and studies. The same seed gives the same scene everywhere.
#pragma once

#include <cstdint>

#include "saltus/scene/scene.h"

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

struct PileOptions {
  int discs = 100;           // 1 to 100 000
  double radius = 0.1;       // m, of the mean disc, whose mass is 1 kg
  double friction = 0.3;     // of discs, ground and walls
  double restitution = 0.3;  // likewise
  double duration = 3;       // s
  int steps = 1000;
};

// Discs of one density, whose radii differ by up to a tenth, fall between two walls to the ground and come to rest: at
// first in about as many rows as columns, every other row above the gaps of the one below, a little disturbed. The loss
// is as of the others, from the middle of the ground; the velocity of the last disc, which lies on top, is free.
// Precondition: as above.
Scene FallingPile(const PileOptions& options, std::uint64_t seed);

}  // namespace saltus
