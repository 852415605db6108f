// The units that belong to a scene: those in which its lengths, times, masses and losses are about 1.
//
// What decides when something touches, rests, has converged or is right is a number, and a number that stands for a
// length means another thing in a scene of millimetres than in one of kilometres. So everything that has such
// thresholds works on the scene in its natural units, and what it finds is converted back:
//
//   length   the extent of the discs and of the targets of positions, or the largest distance of a disc from a plane
//   mass     the largest of a pushed disc; of any that moves, if none is pushed
//   time     length / speed, with the speed the largest of length / duration, the given speeds, and what the given
//            forces and gravity make over that length
//   loss     the largest of its terms for a miss by that length or speed, a force that matters in the duration, or the
//            duration
//
// each rounded to the nearest power of two. Multiplied by powers of two, floating-point numbers keep all their bits:
// two scenes that differ in their units (by powers of two) are the same scene, bit by bit, in natural units. (The
// exponent is found without a logarithm, whose rounding might decide.) The origin is a multiple of 64 lengths, zero for
// scenes around [0, 0]: subtracting it is exact, and coordinates far from the origin have lost all that can be lost.
//
// Contact models whose constants have units by their source compute in SI units, with the origin of the natural ones;
// the simulator converts (simulate/registry.h).
#pragma once

#include <vector>

#include "saltus/scene/scene.h"

namespace saltus {

// Conversion factors: a number in the units `from`, times the factor of its kind, is the number in the units `to`.
struct UnitFactors {
  UnitFactors(const Units& from, const Units& to);
  double length, time, mass, loss, speed, acceleration, force;
  double rate, moment_of_inertia;  // of angular velocities, 1/time; mass length^2

  // The factor of changes of a parameter, and of a quantity that a term has a target for, or of its changes.
  double of(const SceneParameter& parameter) const;
  double of(TerminalTerm::Quantity quantity) const;
};

// Returns the scene in other units. Precondition: `scene` is valid in SI units.
Scene ToUnits(const Scene& scene, const Units& units);

// Returns the scene in its natural units, unchanged if it has these already. Precondition: it is valid in SI units.
Scene ToNaturalUnits(const Scene& scene);

// Returns the scene in its present units, with the origin of its natural ones, which is near the discs.
Scene NearOrigin(const Scene& scene);

// Returns the natural units of a scene; if it is not valid, its present units.
Units NaturalUnits(const Scene& scene);

// Converts a position.
Vec2d ConvertPosition(const Vec2d& position, const Units& from, const Units& to);

// Converts states of the discs, p_x p_y v_x v_y of each.
std::vector<double> ConvertStates(std::vector<double> states, const Units& from, const Units& to);
// Converts an initial state of `bodies` discs: their states, then their rotations, if any disc spins.
std::vector<double> ConvertInitial(std::vector<double> initial, int bodies, const Units& from, const Units& to);

// Converts the value of a parameter.
double ConvertParameter(const SceneParameter& parameter, double value, const Units& from, const Units& to);

double ConvertLoss(double loss, const Units& from, const Units& to);

std::vector<double> Multiplied(std::vector<double> numbers, double factor);

}  // namespace saltus
