// A gradient from a JSON file, to be audited beside those of the contact models.
#pragma once

#include <string>

#include "saltus/audit/given.h"

namespace saltus {

// Keys: position, velocity, control, in the shapes of every gradient that the programs print; lists may end early, and
// [x, y] may be null. Besides: name (default: the path) and tolerance (absolute, default 0). Throws InputError.
GivenGradient ReadGivenGradient(const std::string& path, const Scene& scene);

}  // namespace saltus
