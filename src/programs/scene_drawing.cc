#include "programs/scene_drawing.h"

#include <algorithm>
#include <cmath>
#include <numbers>

#include "base/interrupt.h"
#include "saltus/control/control_rows.h"
#include "saltus/scene/walls.h"
#include "solve/control_guess.h"

namespace saltus {

namespace {

constexpr double kChord = 2 * std::numbers::pi / 180;

std::array<double, 2> Pair(const Vec2d& v) { return {v[0], v[1]}; }

Outline OutlineOf(const EdgeSegment& segment) { return {segment.name, {Pair(segment.from), Pair(segment.to)}}; }

Outline OutlineOf(const EdgePolygon& polygon) {
  const bool inside = polygon.solid == EdgePolygon::Solid::kInside;
  Outline outline{polygon.name, {}, inside ? Outline::Solid::kInside : Outline::Solid::kOutside};
  for (const Vec2d& point : polygon.points) outline.points.push_back(Pair(point));
  outline.points.push_back(outline.points.front());
  return outline;
}

Outline OutlineOf(const EdgeArc& arc) {
  Outline outline{arc.name, {}};
  const int chords = std::max(1, static_cast<int>(std::ceil((arc.to - arc.from) / kChord)));
  for (int i = 0; i <= chords; ++i) {
    const double angle = arc.from + (arc.to - arc.from) * i / chords;
    outline.points.push_back(
        {arc.center[0] + arc.radius * std::cos(angle), arc.center[1] + arc.radius * std::sin(angle)});
  }
  return outline;
}

Outline OutlineOf(const Pocket& pocket) {
  return OutlineOf(EdgeArc{pocket.name, pocket.position, pocket.radius, 0, 2 * std::numbers::pi});
}

// In the order of the scene; arcs as chords, two degrees each at most.
std::vector<Outline> OutlinesOf(const Scene& scene) {
  std::vector<Outline> outlines;
  for (const EdgeSegment& segment : scene.segments) outlines.push_back(OutlineOf(segment));
  for (const EdgePolygon& polygon : scene.polygons) outlines.push_back(OutlineOf(polygon));
  for (const EdgeArc& arc : scene.arcs) outlines.push_back(OutlineOf(arc));
  for (const Pocket& pocket : scene.pockets) outlines.push_back(OutlineOf(pocket));
  return outlines;
}

ReplayWall ToReplayWall(const WallPart& part) {
  using Kind = ReplayWall::Kind;
  const Wall<double>& wall = part.wall;
  if (wall.curved()) return {part.name, Pair(wall.center), {0, 1}, Kind::kCircle, wall.radius};
  if (part.table) return {part.name, {0, 0}, {0, 1}, Kind::kTable};
  const Vec2d point = part.extent.endless ? Vec2d(wall.offset * wall.normal) : part.from;
  return {part.name, Pair(point), Pair(wall.normal), part.extent.endless ? Kind::kHalfPlane : Kind::kSide};
}

}  // namespace

Panel ScenePanel(const Scene& scene, const std::string& title) {
  Panel panel{.title = title, .x = {.label = "x (m)"}, .y = {.label = "y (m)"}, .equal_aspect = true};
  for (const Body& body : scene.bodies) {
    panel.circles.push_back({Pair(body.position), body.radius, "#555555", 0.25});
  }
  for (const Plane& plane : scene.planes) {
    panel.half_planes.push_back({Pair(plane.point), Pair(plane.normal)});
  }
  panel.outlines = OutlinesOf(scene);
  for (const TerminalTerm& term : scene.objective.terminal) {
    if (term.component || term.quantity != TerminalTerm::Quantity::kPosition) continue;
    panel.circles.push_back({Pair(term.target), 0.03, "#000000", 1.0});
  }
  return panel;
}

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
  const Control& control = scene.control;
  for (size_t i = 0; i < control.bodies.size(); ++i) {
    ReplayDisc& disc = replay.discs[control.bodies[i]];
    if (!control.max.empty()) disc.max_component = control.max[i];
    if (!control.max_norm.empty()) disc.max_force = control.max_norm[i];
  }
  for (size_t i = 0; i < control.max_torque.size(); ++i) {
    replay.discs[control.turned[i]].max_torque = control.max_torque[i];
  }
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
                      .arcs = motion.arcs};
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
