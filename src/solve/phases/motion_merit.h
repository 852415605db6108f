// How good a real motion is, whatever its sequence of impacts, and better ones on the way to where a solve stands.
#pragma once

#include <optional>
#include <vector>

#include "solve/phases/phase_solution.h"

namespace saltus {

inline constexpr double kHardlyBetter = 1e-9;  // relative, of losses

// The loss, and what is left of hard constraints. Infinite if there is no motion, or one with other contacts.
double MeritOf(const Scene& scene, const Trial& trial);

// The trial with its forces moved into their bounds, simulated.
Trial WithinBounds(const Scene& scene, const std::vector<OwnTerm>& terms, Trial trial);

// The best motion on the way from one to another whose forces are known, if it is better than the first.
std::optional<Trial> WalkTo(const Scene& scene, const std::vector<OwnTerm>& terms, const Trial& to, const Trial& from);

}  // namespace saltus
