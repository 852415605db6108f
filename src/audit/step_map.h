// The linearization of several steps of a simulator, composed, over some of its discs.
#pragma once

#include <Eigen/Core>
#include <functional>
#include <span>
#include <vector>

#include "saltus/dynamics/simulator.h"

namespace saltus {

// The force on every disc (B x 2) in step k.
using ForceOfStep = std::function<void(int k, std::span<double> force)>;

struct StepMap {
  std::vector<double> end;         // state after the steps
  std::vector<StepTouch> touches;  // steps counted from the begin
  Eigen::MatrixXd A;               // d(end) / d(begin), 4 n x 4 n: [p v] of each given disc
};

// `steps` steps from state `begin` (state_size() numbers) under force(0), force(1), ... Rotation takes part in the
// composition, but not in A.
StepMap ComposeSteps(const Simulator& simulator, std::span<const double> begin, const ForceOfStep& force, int steps,
                     const std::vector<int>& bodies);

// The same without the linearization.
StepMap RunSteps(const Simulator& simulator, std::span<const double> begin, const ForceOfStep& force, int steps);

}  // namespace saltus
