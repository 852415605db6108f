// Scenes as figures, and motions of discs that a reader can play in a page.
//
// The data of a replay are JSON. Numbers are multiples of a quantum (of positions 1e-7 of the drawing's size, of
// velocities and forces 1e-6 of the largest, of angles 1e-5 rad); each column is written as its second differences,
// which free flight makes 0 or nearly so: two bytes a number where discs fly, at most 6 or so where they do not. Times
// are written in full.
#pragma once

#include <cstddef>
#include <string>
#include <type_traits>
#include <vector>

#include "output/figure.h"
#include "programs/json_output.h"
#include "saltus/scene/scene.h"
#include "saltus/simulate/registry.h"
#include "saltus/simulate/simulator.h"

namespace saltus {

// How the discs of a scene move under a contact model: their states over time, and their contacts. For files and
// replays.

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
Scene WithFixedTime(Scene scene, const MotionInput& input, double* price);

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
Motion AtNodes(const Motion& motion, const std::vector<double>& nodes);

// Calls visit(key, field) for the fields of a disc or a wall that documents with states have.
template <typename Thing, typename Visit>
void VisitDrawnFields(Thing& thing, const Visit& visit) {
  using T = std::remove_const_t<Thing>;
  visit("name", thing.name);
  if constexpr (std::is_same_v<T, Body>) {
    visit("radius", thing.radius);
    visit("fixed", thing.fixed);
  } else if constexpr (std::is_same_v<T, Plane>) {
    visit("point", thing.point);
    visit("normal", thing.normal);
  } else if constexpr (std::is_same_v<T, Pocket>) {
    visit("position", thing.position);
    visit("radius", thing.radius);
  } else if constexpr (std::is_same_v<T, EdgePolygon>) {
    visit("points", thing.points);
    visit("solid", thing.solid);
  } else {
    if constexpr (std::is_same_v<T, EdgeArc>) {
      visit("center", thing.center);
      visit("radius", thing.radius);
    }
    visit("from", thing.from);
    visit("to", thing.to);
  }
}

// Calls visit(key, noun, list) for the discs and the walls of a scene, by their keys in scene files.
template <typename SceneOrConst, typename Visit>
void VisitDrawn(SceneOrConst& scene, const Visit& visit) {
  visit("bodies", "disc", scene.bodies);
  visit("planes", "plane", scene.planes);
  visit("pockets", "pocket", scene.pockets);
  visit("segments", "segment", scene.segments);
  visit("polygons", "polygon", scene.polygons);
  visit("arcs", "arc", scene.arcs);
}

// Draws discs at their start, walls and targets.
Panel ScenePanel(const Scene& scene, const std::string& title);

// The covariance of positions about a motion.
struct ReplaySpread {
  std::string label;                // "closed loop"
  std::vector<double> times;        // s, rising
  std::vector<double> covariances;  // times.size() x discs x 3: of x, of x and y, of y, m^2
};

struct ReplayMotion {
  // Takes the remark from the motion, and the style from the name of a contact model (palette.h).
  ReplayMotion(Motion drawn, MotionInput from, std::string name, std::string_view style_of_model);

  Motion motion;      // with one state at least
  MotionInput input;  // what it was simulated from: its control, which may be empty, is drawn too
  std::string label;
  std::string model;   // whose style it has
  std::string remark;  // may be empty
  bool shown = true;   // at first; the reader may change it
  std::string colour;
  Dash dash = Dash::kSolid;
  std::vector<ReplaySpread> spreads = {};
};

// The discs, walls and targets of a scene, and motions of these discs.
struct Replay {
  Scene scene;
  std::vector<ReplayMotion> motions = {};
};

// The most numbers of states that fit into a page: about 5 MB.
inline constexpr std::size_t kMostReplayNumbers = std::size_t{1} << 21;

// Returns how many nodes each of `motions` motions may have in a page.
MotionOptions ReplayOptions(const Scene& scene, std::size_t motions);

// Preconditions: ValidateStructure(replay.scene) finds nothing; at least one disc and one motion.
Json ReplayToJson(const Replay& replay);

}  // namespace saltus
