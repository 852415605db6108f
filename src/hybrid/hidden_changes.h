// Changes of the flow and of guards within steps of a motion that no stage of the steps sees, such as a pulse in time.
//
// Bounds of the functions over the times and states of a step (HybridFunctions::Bound) rule them out for most steps at
// once. Steps with wide bounds are divided until the bounds of the parts are not wide.
#pragma once

#include <string>
#include <vector>

#include "hybrid/motion_tape.h"

namespace saltus {

struct HiddenChanges {
  std::string what;   // that of the shortest change; empty: none was found
  double length = 0;  // s: of the part of a step at whose middle that one was seen
  // The ends of the parts of all steps with changes, and times beside each of these steps at distances that double, as
  // parts of the duration, in order. Steps between these times see the changes, and what they do nearby.
  std::vector<double> ends;
  int steps = 0;           // so many of the motion have changes
  double first = 0;        // s: when the first of these steps begins
  bool unbounded = false;  // whether the shortest change has no bounds, as one beside a pole
};

// Which changes are looked for. kHidden: those that steps may not see, by modes whose functions are flat beside them
// (HybridFunctions::MayHideChanges). kAll: also those that steps see and do not resolve, in all modes. kFirst: as kAll,
// but only those of the first step that has some, behind which the motion may be wrong.
enum class Changes { kHidden, kAll, kFirst };

// Finds changes that are larger than a relative tolerance of the states.
HiddenChanges FindHiddenChanges(const HybridSystem& system, const HybridInput& input, const MotionTape& tape,
                                double tolerance, Changes which);

}  // namespace saltus
