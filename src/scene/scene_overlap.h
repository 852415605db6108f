// Whether the bodies of a scene overlap at the start, with each other or with what is solid.
#pragma once

#include <optional>

#include "saltus/scene/scene.h"

namespace saltus {

// The first overlap of a body that moves beyond the tolerance, with how deep it is. Precondition: the scene has passed
// all other rules of Validate; its numbers are finite.
std::optional<SceneError> FindOverlap(const Scene& scene);

}  // namespace saltus
