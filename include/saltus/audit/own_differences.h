// Whether a model's gradient is the derivative of its own loss, at the scene's own steps.
//
// The loss is followed along a few directions, each a sum of all initial positions, velocities or forces with signs
// that are fixed but arbitrary, by differences of decreasing width to either side. A gradient that is no derivative of
// the steps (detached values, a forgotten dependence) agrees with none of them. This says nothing of whether the steps
// are right, which is what the width sweep and the exact gradient are for.
#pragma once

#include <string_view>

#include "saltus/audit/refinement.h"

namespace saltus {

enum class Agreement {
  kAgrees,    // with differences on at least one side, in every direction
  kDiffers,   // in some direction the differences of both sides settle on another slope
  kUndecided  // they do not settle
};

struct OwnDifferences {
  Agreement agreement = Agreement::kUndecided;
  // Of the direction that differs most, or else of the last one.
  Quantity quantity = Quantity::kPosition;
  double gradient = 0, difference = 0;
};

// Undecided where the model cannot take the scene. What was stopped is of no use.
OwnDifferences CompareWithOwnDifferences(std::string_view contact, const Scene& scene,
                                         const StopRequest& stop = nullptr);

}  // namespace saltus
