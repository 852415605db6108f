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

// Sets the force on every disc (B x 2) in step k.
using ForceOfStep = std::function<void(int k, std::span<double> force)>;

struct StepMap {
  std::vector<double> end;         // state after the steps
  std::vector<StepTouch> touches;  // steps counted from the begin
  Eigen::MatrixXd A;  // d(end) / d(begin) over the given discs: [p v] of each, and [angle w] if the scene spins
};

// Returns the number of entries of a disc in the state of a scene: 4, or 6 if it spins.
int NumbersOfDisc(const Scene& scene);

// Whether number j of a disc is a velocity or an angular velocity.
inline bool IsRate(Eigen::Index j) { return j == 2 || j == 3 || j == 5; }

// Returns factors that put lengths and angles on one scale, for each disc of `bodies`: 1 and `time` for [p v], and if
// the scene spins the radius and the radius times `time` for [angle w]. Costates are divided by them.
Eigen::VectorXd StateScales(const Scene& scene, const std::vector<int>& bodies, double time);

// Runs `steps` steps from state `begin` under force(0), force(1), ..., and composes their linearization over `bodies`,
// unless that is null. A rotation that only the model has takes part, but is not in A.
StepMap RunSteps(const Simulator& simulator, std::span<const double> begin, const ForceOfStep& force, int steps,
                 const std::vector<int>* bodies);

// The product A^T lambda over some discs ([p v] of each, and [angle w] if the scene spins), as the sum of the
// contributions of positions and of velocities at the end.
struct PulledCostate {
  Eigen::VectorXd by_positions, by_velocities;
  Eigen::VectorXd Sum() const { return by_positions + by_velocities; }
};

// Pulls a costate back through all steps of the simulator, from state `begin` under its scene's initial control.
// `lambda` has the numbers of each disc of `bodies`; those of other discs are zero. The result is NaN if the rollout
// fails. Precondition: discs have no rotation but that of a scene that spins.
PulledCostate PullBackCostate(Simulator* simulator, std::span<const double> begin, const std::vector<int>& bodies,
                              const Eigen::VectorXd& lambda);

}  // namespace saltus
