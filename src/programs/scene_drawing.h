// Scenes as figures, and motions of discs that a reader can play in a page.
//
// The data of a replay are JSON. Numbers are multiples of a quantum (of positions 1e-7 of the drawing's size, of
// velocities and forces 1e-6 of the largest, of angles 1e-5 rad); each column is written as its second differences,
// which free flight makes 0 or nearly so: two bytes a number where discs fly, at most 6 or so where they do not. Times
// are written in full.
#pragma once

#include <cstddef>
#include <optional>
#include <string>
#include <type_traits>
#include <vector>

#include "output/figure.h"
#include "programs/json_output.h"
#include "saltus/scene/scene.h"
#include "solve/motion.h"

namespace saltus {

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
    visit("motion", thing.motion);
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
  std::optional<Scene> scene = {};  // whose discs and walls are drawn with this motion, if not those of the replay
};

// The discs, walls and targets of a scene, and motions of these discs, or of as many others with the same names.
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
