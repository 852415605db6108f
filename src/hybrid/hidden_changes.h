// Changes of the flow and of guards within steps of a motion that no stage of the steps sees, such as a pulse in time.
//
// Bounds of the functions over the times and states of a step (HybridFunctions::Bound) rule them out for most steps at
// once. Steps with wide bounds are divided until the bounds of the parts are not, or a change is seen.
#pragma once

#include <string>

#include "hybrid/motion_tape.h"

namespace saltus {

struct HiddenChange {
  std::string what;   // empty: none was found
  double length = 0;  // s: of the part of a step at whose end it was seen
};

// Returns the shortest change that was found. None is found in modes whose functions have no known bounds.
HiddenChange FindHiddenChange(const HybridSystem& system, const HybridInput& input, const MotionTape& tape);

}  // namespace saltus
