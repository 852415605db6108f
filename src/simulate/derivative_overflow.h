// The reason why derivatives of a simulated motion are not finite.
#pragma once

#include <span>
#include <string>

#include "saltus/simulate/simulator.h"

namespace saltus {

// Returns which step of the last rollout under `control` has derivatives that are not finite, and the remedy; or, if
// those of every step are finite, that their product overflows. Precondition: a gradient of that rollout is not finite.
std::string ReasonDerivativesOverflow(const Simulator& simulator, std::span<const double> control);

}  // namespace saltus
