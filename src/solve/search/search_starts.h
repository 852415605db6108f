// Where a search begins that does not rely on its initial guess: constant forces that send pushed discs somewhere.
#pragma once

#include <cstdint>
#include <optional>
#include <vector>

#include "saltus/scene/scene.h"
#include "saltus/solve/solver.h"

namespace saltus {

// One force per pushed disc, N. Number 0 is no force at all. The others send each disc, from where it drifts to, at
// another disc, at a target or at a place drawn at random, to be there within the horizon. The same number and seed
// give the same forces on every machine.
std::vector<Vec2d> SearchStart(const Scene& scene, std::uint64_t seed, int number);

// A control near one on the same intervals: each pushed disc gets a random force more, linear in time, of up to a
// tenth, three tenths or all of its mean force, by turns. Numbers and seeds as above.
std::vector<double> ControlAround(const Scene& scene, const ControlGuess& control, std::uint64_t seed, int number);

// The scene that begins so: with these forces, or where velocities or positions are to be found, with velocities that
// send the free discs to such places, or at such places. Nothing if there is nothing to be found.
std::optional<Scene> BeginAtRandom(Scene scene, std::uint64_t seed, int number);

}  // namespace saltus
