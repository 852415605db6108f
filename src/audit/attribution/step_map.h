// The linearization of several steps of a simulator, composed, over some of its discs: as a matrix (StepMap); or, where
// discs are many, as a costate that is pulled back (PulledCostate). Time and memory for the matrix grow with the square
// of the number of discs; its transpose times a vector takes one rollout and two reverse sweeps.
#pragma once

#include <Eigen/Core>
#include <functional>
#include <span>
#include <vector>

#include "saltus/simulate/simulator.h"

namespace saltus {

// The force on every disc (B x 2) in step k.
using ForceOfStep = std::function<void(int k, std::span<double> force)>;

struct StepMap {
  std::vector<double> end;         // state after the steps
  std::vector<StepTouch> touches;  // steps counted from the begin
  Eigen::MatrixXd A;  // d(end) / d(begin) over the given discs: [p v] of each, and [angle w] if the scene spins
};

// Numbers of a disc in the state of a scene: those above.
int NumbersOfDisc(const Scene& scene);

// Whether number j of a disc is a velocity or an angular velocity.
inline bool IsRate(Eigen::Index j) { return j == 2 || j == 3 || j == 5; }

// Puts lengths and turns on one scale: of each disc of `bodies` the factors of [p v], and of [angle w] if the scene
// spins: 1, `time`, the radius and the radius times `time`. Of costates they are those to divide by.
Eigen::VectorXd StateScales(const Scene& scene, const std::vector<int>& bodies, double time);

// `steps` steps from state `begin` (state_size() numbers) under force(0), force(1), ..., with the linearization over
// `bodies`, unless these are null. Rotation that is the model's own takes part in the composition, but not in A.
StepMap RunSteps(const Simulator& simulator, std::span<const double> begin, const ForceOfStep& force, int steps,
                 const std::vector<int>* bodies);

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
