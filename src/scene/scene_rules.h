// The rules of Validate (saltus/scene/scene.h), of a scene in the units that it has.
#pragma once

#include <array>
#include <optional>
#include <span>

#include "saltus/scene/scene.h"

namespace saltus {

// Of quantities in scene files, in the order of TerminalTerm::Quantity.
inline constexpr std::array kQuantities = {"position", "velocity", "angle", "angular_velocity"};

// The first of those of ValidateStructure that is broken. That asks for them in natural units too, which this does not.
std::optional<SceneError> BrokenRule(const Scene& scene);

// The first overlap at the start of a body that moves, with another or with what is solid, beyond the tolerance, with
// how deep it is. Precondition: the scene has passed all other rules of Validate; its numbers are finite.
std::optional<SceneError> FindOverlap(const Scene& scene);
// The same with the positions of an initial state (InitialState).
std::optional<SceneError> FindOverlapAt(Scene scene, std::span<const double> initial);

}  // namespace saltus
