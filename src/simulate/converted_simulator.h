// A simulator in other units than those in which the contact model computes.
#pragma once

#include <memory>

#include "saltus/simulate/simulator.h"

namespace saltus {

// Returns a simulator of `scene`, whose arguments and results are in the scene's units; `inner` simulates the same
// scene in other units. A rotation that only the model has is not converted.
std::unique_ptr<Simulator> ConvertUnits(const Scene& scene, std::unique_ptr<Simulator> inner);

}  // namespace saltus
