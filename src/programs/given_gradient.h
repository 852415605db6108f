// A gradient from a JSON file, to be audited beside those of the contact models.
#pragma once

#include <string>

#include "saltus/audit/given.h"

namespace saltus {

// Keys: position, velocity, control and parameters, and of discs that spin angle and angular_velocity, as in every
// gradient that the programs print. Lists may end early,
// [x, y] may be null if it is not known, and parameters are not looked at. Besides: name (default: the path), tolerance
// (absolute, default 0) and intervals (equal parts of the horizon that rows of the control stand for; default: one a
// step). Or an object with such a gradient under the key gradient, as in the audits of saltus_audit --json: named, and
// its intervals known, by its contact model. Throws InputError.
GivenGradient ReadGivenGradient(const std::string& path, const Scene& scene);

}  // namespace saltus
