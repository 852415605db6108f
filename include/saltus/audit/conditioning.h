// How much of a gradient rounding leaves.
//
// Where discs meet again and again, each impact magnifies what was there before: after a few dozen of them the last
// bits of the initial state, and the rounding of every step since, may decide the leading digits of the derivative. A
// gradient that differs from the exact one by no more than the exact one differs from itself is not wrong: nobody can
// tell.
#pragma once

#include <optional>

#include "saltus/physics/scene.h"

namespace saltus {

struct Conditioning {
  // Relative change of the exact gradient by the initial state, per relative change of that state in its last bits; the
  // largest of a few.
  double condition = 0;
  // By how much the exact gradient differs from itself, relative, computed with other numbers of steps, which change
  // nothing but the rounding, and from the other initial states; the largest of a few.
  double rounding = 0;
};

// Of the event-driven model; nothing where that one cannot take the scene or fails.
std::optional<Conditioning> MeasureConditioning(const Scene& scene);

}  // namespace saltus
