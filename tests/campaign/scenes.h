// Random scenes of the kinds that are hard for a simulator of contact: ties, chains, rest, sliding, stacks, corners.
#pragma once

#include <cstdint>
#include <string>

#include "contact/random_scene.h"
#include "saltus/scene/scene.h"

namespace saltus::campaign {

struct NamedScene {
  std::string kind;
  Scene scene;  // valid
};

// The scene of a seed, on every machine the same but for rounding in the standard library's functions: 1 to 8 discs, of
// which some may be fixed or pushed, up to 4 planes, 20 to 40 steps. Its loss is a random linear function of the final
// state of all discs that move.
NamedScene RandomScene(std::uint32_t seed);

// Returns a scene with segments, polygons and arcs, one in three on a table: 1 to 4 discs, none pushed.
NamedScene RandomEdgeScene(std::uint32_t seed);

// Returns a scene with events at the same time: discs in corners, on lattices, beside their mirror images, that strike
// walls on nodes, or that meet two things at once. 1 to 9 discs, none pushed, no rest at the start.
NamedScene RandomSceneAtOnce(std::uint32_t seed);

// Returns the scene with discs that spin, friction and a loss that depends on their spin; without a table, on which
// nothing spins.
NamedScene WithSpin(NamedScene scene, std::uint32_t seed);

// Gives a scene its loss, a random linear function of the final state, by the velocities of all discs that move.
void MeasureEnd(testing::RandomScenes* random, Scene* scene);

}  // namespace saltus::campaign
