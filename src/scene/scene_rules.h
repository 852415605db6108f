// The rules of Validate (saltus/scene/scene.h), for a scene in its present units.
#pragma once

#include <array>
#include <optional>
#include <span>

#include "saltus/scene/scene.h"

namespace saltus {

// The names of quantities in scene files, in the order of TerminalTerm::Quantity.
inline constexpr std::array kQuantities = {"position", "velocity", "angle", "angular_velocity"};

// The rules of scene files for pairs of materials, in the order of Combine.
inline constexpr std::array kCombines = {"mean", "product", "min", "max"};

// Returns the first broken rule of ValidateStructure. Unlike that function, it does not check natural units too.
std::optional<SceneError> BrokenRule(const Scene& scene);

// Returns the first overlap, beyond the tolerance, of a moving body with another or with a solid wall at the initial
// time, with its depth. Precondition: the scene has passed all other rules of Validate; its numbers are finite.
std::optional<SceneError> FindOverlap(const Scene& scene);
// Returns the first overlap at the positions of an initial state (InitialState).
std::optional<SceneError> FindOverlapAt(Scene scene, std::span<const double> initial);

}  // namespace saltus
