#include "programs/replay_scene.h"

#include <algorithm>

#include "base/interrupt.h"
#include "programs/outlines.h"
#include "saltus/control/control_rows.h"
#include "saltus/scene/walls.h"
#include "solve/control_guess.h"

namespace saltus {
namespace {

std::array<double, 2> Pair(const Vec2d& v) { return {v[0], v[1]}; }

ReplayWall ToReplayWall(const WallPart& part) {
  using Kind = ReplayWall::Kind;
  const Wall<double>& wall = part.wall;
  if (wall.curved()) return {part.name, Pair(wall.center), {0, 1}, Kind::kCircle, wall.radius};
  if (part.table) return {part.name, {0, 0}, {0, 1}, Kind::kTable};
  const Vec2d point = part.extent.endless ? Vec2d(wall.offset * wall.normal) : part.from;
  return {part.name, Pair(point), Pair(wall.normal), part.extent.endless ? Kind::kHalfPlane : Kind::kSide};
}

}  // namespace

void AddWalls(const Scene& scene, Replay* replay) {
  for (const WallPart& part : WallPartsOf(scene)) replay->walls.push_back(ToReplayWall(part));
  for (size_t i = 0; i < scene.planes.size(); ++i) replay->walls[i].point = Pair(scene.planes[i].point);
  replay->outlines = OutlinesOf(scene);
}

void SplitControl(const Scene& scene, const std::vector<double>& rows, ReplayMotion* motion) {
  const size_t columns = ControlColumns(scene);
  for (size_t i = 0; i + columns <= rows.size(); i += columns) {
    motion->control.insert(motion->control.end(), {rows[i], rows[i + 1]});
    if (columns > 2) motion->torques.push_back(rows[i + 2]);
  }
}

Replay ReplayOf(const Scene& scene) {
  Replay replay;
  for (const Body& body : scene.bodies) replay.discs.push_back({body.name, body.radius, body.fixed});
  AddWalls(scene, &replay);
  for (const TerminalTerm& term : scene.objective.terminal) {
    if (!term.component && term.quantity == TerminalTerm::Quantity::kPosition) {
      replay.targets.push_back(Pair(term.target));
    }
  }
  return replay;
}

MotionOptions ReplayOptions(const Scene& scene, std::size_t motions) {
  MotionOptions options;
  const std::size_t per_node = 4 * scene.bodies.size() * std::max<std::size_t>(motions, 1);
  options.most_nodes = std::clamp<std::size_t>(kMostReplayNumbers / per_node, 2, 4000);
  options.stop = InterruptGuard::GraceIsOver;
  return options;
}

ReplayMotion ToReplayMotion(const Scene& scene, const Motion& motion, const MotionInput& input,
                            const std::string& label, std::string_view style_of_model) {
  const ModelStyle& style = StyleOf(style_of_model);
  ReplayMotion replay{.label = label,
                      .remark = motion.failure,
                      .colour = std::string(style.colour),
                      .dash = style.dash,
                      .times = motion.times,
                      .states = motion.states,
                      .arcs = motion.arcs,
                      .touches = {},
                      .pushed = {},
                      .control = {},
                      .torques = {},
                      .ends = {}};
  for (size_t i = 0; i < motion.rotations.size(); i += 2) replay.angles.push_back(motion.rotations[i]);
  for (const TouchSpan& touch : motion.touches) {
    replay.touches.push_back(
        {touch.contact.a, touch.contact.b, touch.contact.plane, touch.begin, touch.end, Pair(touch.impulse)});
  }
  if (input.control.empty() || scene.control.bodies.empty()) return replay;
  // More intervals than a page can show are joined.
  ControlGuess control{input.control, input.durations};
  const size_t width = scene.control_width(), most = 4000;
  const double duration = DurationOf(control, scene);
  if (control.control.size() / width > most) {
    control.control = MeanOverSteps(control, scene.control_width(), most);
    control.durations.assign(most, duration / most);
  }
  replay.pushed = scene.control.bodies;
  double end = 0;
  for (const double length : LengthsOf(control, scene)) replay.ends.push_back(end += length);
  SplitControl(scene, RowsOfControl(scene, control.control), &replay);
  return replay;
}

}  // namespace saltus
