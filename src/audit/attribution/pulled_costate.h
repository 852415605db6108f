// A costate pulled back through several steps of a simulator: what there is of their linearization where discs are
// many.
//
// The matrix of StepMap (step_map.h) takes time and memory with the square of the discs; its transpose times a vector
// is one rollout and two reverse sweeps.
#pragma once

#include <Eigen/Core>
#include <span>
#include <vector>

#include "saltus/simulate/simulator.h"

namespace saltus {

// A^T lambda over some discs, [p v] of each and [angle w] if the scene spins; what the positions and what the
// velocities at the end contribute.
struct PulledCostate {
  Eigen::VectorXd by_positions, by_velocities;
  Eigen::VectorXd Sum() const { return by_positions + by_velocities; }
};

// Through all steps of the simulator, from state `begin` under its scene's initial control. `lambda`: the numbers
// of each disc of `bodies`, those of the others are zero. Not a number if the rollout fails.
// Precondition: the simulator's discs have no rotation of their own, but that of a scene that spins.
PulledCostate PullBackCostate(Simulator* simulator, std::span<const double> begin, const std::vector<int>& bodies,
                              const Eigen::VectorXd& lambda);

}  // namespace saltus
