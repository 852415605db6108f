// How the discs of a scene move under a contact model: their states over time, and their contacts.
#pragma once

#include <cstddef>
#include <string>
#include <vector>

#include "saltus/scene/scene.h"
#include "saltus/simulate/registry.h"
#include "saltus/simulate/simulator.h"

namespace saltus {

// Two discs, or a disc and a plane, that touched: an impact, or for some steps in a row.
struct TouchSpan {
  Candidate contact;
  double begin = 0, end = 0;      // s; equal if an impact time is known
  Vec2d impulse = Vec2d::Zero();  // N s, on the first disc meanwhile, by all that touched it (a plane is never first)
};

struct Motion {
  std::vector<double> times;   // s, never falling; where velocities jump the instant stands twice, before and after
  std::vector<double> states;  // times.size() x B x 4
  // In scenes with discs that spin, angle and angular velocity: times.size() x B x 2; else empty.
  std::vector<double> rotations = {};
  // Between two times accelerations are constant: positions are the cubic that states at both ends determine.
  bool arcs = false;
  std::vector<TouchSpan> touches;  // by their beginnings
  std::string failure;             // why it ends early; empty if it does not
};

// An initial state and a control on intervals, as SolveReport has them.
struct MotionInput {
  std::vector<double> initial;    // as in simulator.h
  std::vector<double> control;    // K x C x 2
  std::vector<double> durations;  // s, of the K intervals; none: equally long
};

// The scene with its control as all that is free, and with the duration that the input has, if that is free; `price`
// is then what the objective charges for it.
Scene FixFinalTime(Scene scene, const MotionInput& input, double* price);

struct MotionOptions {
  Precision precision = Precision::kDouble;
  std::size_t most_bytes = std::size_t{1} << 30;  // of states
  // Where there are more nodes, every second, third, ... is kept; impacts too as long as these fit as often.
  std::size_t most_nodes = std::size_t{1} << 24;
  StopRequest stop = nullptr;  // where it asks for the end, the motion ends early, and its failure is kStopped
};

// Simulates under `contact`, which takes the mean of the control over each of its steps; its steps are the scene's.
Motion SimulateMotion(const Scene& scene, const Contact& contact, const MotionInput& input,
                      const MotionOptions& options = {});

// Simulates under exact dynamics, on the intervals of the control, with each impact's instant.
Motion SimulateExactMotion(const Scene& scene, const MotionInput& input, const MotionOptions& options = {});

// The states at the nodes of the control's intervals alone: without the instants in between, and of an instant that
// stands twice the first.
Motion StatesAtNodes(const Motion& motion, const std::vector<double>& nodes);

}  // namespace saltus
