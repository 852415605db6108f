// A simulator that speaks other units than the one that does the work.
#pragma once

#include <memory>

#include "saltus/simulate/simulator.h"

namespace saltus {

// Of `scene`, in whose units all is taken and given, by `inner`, a simulator of the same scene in other units. What a
// model keeps of rotation stays as the model has it.
std::unique_ptr<Simulator> ConvertUnits(const Scene& scene, std::unique_ptr<Simulator> inner);

}  // namespace saltus
