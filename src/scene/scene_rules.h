// The rules of ValidateStructure (saltus/scene/scene.h), of a scene in the units that it has.
#pragma once

#include <optional>

#include "saltus/scene/scene.h"

namespace saltus {

// The first that is broken. ValidateStructure asks for them in natural units too, which this does not.
std::optional<SceneError> BrokenRule(const Scene& scene);

}  // namespace saltus
