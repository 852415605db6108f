// Random scenes of the kinds that are hard for a simulator of contact: ties, chains, rest, sliding, stacks, corners.
#pragma once

#include <cstdint>
#include <string>

#include "saltus/physics/scene.h"

namespace saltus::campaign {

struct NamedScene {
  std::string kind;
  Scene scene;  // valid
};

// The scene of a seed, on every machine the same but for rounding in the standard library's functions: 1 to 8 discs, of
// which some may be fixed or pushed, up to 4 planes, 20 to 40 steps. Its loss is a random linear function of the final
// state of all discs that move.
NamedScene RandomScene(std::uint32_t seed);

}  // namespace saltus::campaign
