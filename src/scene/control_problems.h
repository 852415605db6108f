// Random control problems through impacts, numbered, for measuring solvers on hundreds of them.
#pragma once

#include <cstdint>
#include <string_view>

#include "saltus/scene/scene.h"

namespace saltus {

// pair           a disc that is pushed, and one that is to be somewhere at the end
// gravity        the same, and gravity
// wall           the same, and a wall beside their way
// box            the same in a box, and both move at the start
// chain          the same, and discs in between
// two_targets    one pushed disc, two that are to be somewhere
// two_pushed     two pushed discs, one that is to be somewhere
// bounce         one disc above the ground, which is to be somewhere at a given velocity
// friction       a pair, a wall and friction
// posts          a pair, and posts that do not move
inline constexpr std::string_view kControlKinds[] = {
    "pair", "gravity", "wall", "box", "chain", "two_targets", "two_pushed", "bounce", "friction", "posts"};
inline constexpr int kNumControlKinds = 10;

// The problem of that number, of kind number `seed` modulo 10: a valid scene of 120 steps with a guess that is sent
// about where it should be, which need not meet anything. Nothing but sums, products, quotients and square roots goes
// into it, and all numbers are rounded to 1e-4: it is the same on every machine.
Scene ControlProblem(std::uint64_t seed);

}  // namespace saltus
