// Properties that every simulation by exact events must have, whatever the scene.
#pragma once

#include <map>
#include <string>

#include "saltus/scene/scene.h"

namespace saltus::campaign {

// How much of what was met in a scene: numbers by what they count. Keys that begin with kFailure count failures, those
// with kRefusal rollouts that the model refuses.
using Counts = std::map<std::string, int64_t>;
inline constexpr char kFailure[] = "FAILED ", kRefusal[] = "refused: ";

// Simulates the scene with the contact model `event`, and checks that
//   - every state is finite; a rollout that the model refuses is counted by its reason,
//   - nothing overlaps by more than 1e-9 of the scene's size,
//   - energy, that of gravity and of the constant forces included, never grows by more than 1e-9 of its scale,
//   - without planes and fixed discs forces alone change the momentum, and the angular momentum where there are none;
// and with `gradient`, that the gradient agrees with differences of the loss, along a random direction each of initial
// positions, velocities, angular velocities and the control. Differences are one-sided, on both sides, at four widths
// h, h/2, h/4, h/8, and extrapolated; where extrapolations disagree, other events happen within the difference, and
// nothing is compared on that side. Neither is a side on which discs would overlap at the start. Where a derivative
// exists from one side only (one_sided_derivatives.h), the direction is to that side. Differences that disagree are
// taken again, at 0.3 h; and, as slow impacts or a chaotic motion let a derivative hold very near only, at a very small
// h. A gradient so large that not even these show it is left out. Where contact lasts, velocities below the model's
// threshold are cut off, and what was moved takes its time to come to rest: there h and the tolerances are larger, and
// widths h, h/4, h/16, h/64.
//
// A gradient that disagrees is a failure, unless several impacts of one disc at the same time, or a grazing one, leave
// the derivative undefined: such are counted by that reason.
Counts Check(const Scene& scene, std::uint32_t seed, bool gradient);

// Compares every entry of the gradient by the initial state with differences of the loss on both sides. It must agree
// with both, or be named one-sided (one_sided_derivatives.h, audit/gradient/step_study.h) as the differences are; what
// is named must not agree with both. Scenes in which something rests or grazes, or in which the order of impacts
// decides the motion, are left out and counted.
Counts CheckAtOnce(const Scene& scene);

}  // namespace saltus::campaign
