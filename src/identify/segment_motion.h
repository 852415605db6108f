// The motion of a segment at its samples, with derivatives by what is identified.
//
// Forward sensitivities: each unknown has a column of state derivatives, which flights move by a constant Jacobian and
// steps with contact by their linearization. A sample between two nodes of the time grid has the state of the model's
// own step of that length.
#pragma once

#include <Eigen/Core>
#include <string>
#include <vector>

#include "identify/fit.h"

namespace saltus {

// The measurements, and the parameters that they depend on.
struct MotionRequest {
  const std::vector<Sample>* samples = nullptr;
  std::vector<Unknown> unknowns;
  std::vector<int> free_bodies;    // whose initial states are unknown: columns px py vx vy of each, after `unknowns`
  const ImpactLaw* law = nullptr;  // of all impacts, where it is learned; those of its parameters are among `unknowns`
  const EventFunctions* events = nullptr;  // of the planes, likewise; not with a law

  int num_columns() const { return static_cast<int>(unknowns.size() + 4 * free_bodies.size()); }
};

// The state of a pair before an impact.
struct ImpactState {
  Candidate candidate;
  Vec2d position[2], velocity[2];  // of its discs; with a plane, of the first
};

// The motion of one segment at its samples.
struct MotionAtSamples {
  bool ok = false;
  std::string reason;
  std::vector<Eigen::Vector4d> state;       // px py vx vy of each sample's disc
  std::vector<Eigen::MatrixXd> derivative;  // 4 x columns, if asked for
  std::vector<StepTouch> touches;           // of the whole segment, up to its last sample
  std::vector<Vec2d> impact_speeds;         // with a law, of the first impact of each step: of approach and of sliding
  std::vector<ImpactState> impacts;         // with event functions, of the first impact of each step
};

// `scene` has the values of the unknowns and the scene's time step. A law, or event functions, take the place of the
// contact model.
MotionAtSamples MoveThrough(const Contact& contact, const Scene& scene, const Segment& segment,
                            const MotionRequest& request, bool with_derivatives);

}  // namespace saltus
