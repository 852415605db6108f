// Kong, Payne, Council, Johnson 2021 (hybrid iLQR): a ball whose vertical force is controlled bounces once.
#pragma once

#include "problems/hybrid/bouncing_ball.h"

namespace saltus {

// From rest at 4 m to rest at 1 m in 1 s, with an effort of 1/32 int u^2 dt and a weight of 100 on the misses. With a
// control that is continuous in time the least loss is 2.195888610303352; on 50 equal intervals it
// is 2.197662650662964, with the impact on the node at 0.7 s, where the loss has a kink.
inline HybridProblem ControlledBallProblem() {
  HybridProblem problem{
      .system = HybridSystem(BouncingBall()),
      .guess = {.initial = {4, 0}, .parameters = {9.8, 0.7}, .duration = 1, .num_intervals = 50},
      .terms = {MakeTerminalCost(0, 1.0, 100.0, 2), MakeTerminalCost(1, 0.0, 100.0, 2), MakeEffortCost(1.0 / 32, 1)}};
  problem.free.control = true;
  return problem;
}

}  // namespace saltus
