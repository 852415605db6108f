#include "tools/replay_scene.h"

#include <algorithm>

#include "solve/control_guess.h"

namespace saltus {
namespace {

std::array<double, 2> Pair(const Vec2d& v) { return {v[0], v[1]}; }

}  // namespace

Replay ReplayOf(const Scene& scene) {
  Replay replay;
  for (const Body& body : scene.bodies) replay.discs.push_back({body.name, body.radius, body.fixed});
  for (const Plane& plane : scene.planes) {
    replay.walls.push_back({plane.name, Pair(plane.point), Pair(plane.normal.normalized())});
  }
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
                      .ends = {}};
  if (scene.HasEdges())
    replay.remark += std::string(replay.remark.empty() ? "" : "; ") + "walls that end are not drawn";
  for (const TouchSpan& touch : motion.touches) {
    if (touch.contact.plane && touch.contact.b >= static_cast<int>(scene.planes.size())) continue;
    replay.touches.push_back(
        {touch.contact.a, touch.contact.b, touch.contact.plane, touch.begin, touch.end, Pair(touch.impulse)});
  }
  if (input.control.empty() || scene.control.bodies.empty()) return replay;
  // More intervals than a page can show are joined.
  ControlGuess control{input.control, input.durations};
  const size_t width = 2 * scene.control.bodies.size(), most = 4000;
  const double duration = DurationOf(control, scene);
  if (control.control.size() / width > most) {
    control.control = MeanOverSteps(control, scene.num_controlled(), most);
    control.durations.assign(most, duration / most);
  }
  replay.pushed = scene.control.bodies;
  double end = 0;
  for (const double length : LengthsOf(control, scene)) replay.ends.push_back(end += length);
  replay.control = std::move(control.control);
  return replay;
}

}  // namespace saltus
