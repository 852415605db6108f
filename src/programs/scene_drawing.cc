#include "programs/scene_drawing.h"

#include <glog/logging.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <numbers>

#include "base/interrupt.h"
#include "base/number_text.h"
#include "saltus/control/control_rows.h"
#include "saltus/scene/walls.h"
#include "scene/path_motion.h"
#include "solve/control_guess.h"

namespace saltus {

namespace {

constexpr double kChord = 2 * std::numbers::pi / 180;

// In the order of the scene; arcs as chords, two degrees each at most.
Json OutlinesOf(const Scene& scene) {
  Json outlines = Json::array();
  const auto add = [&](const std::string& name, const std::vector<Vec2d>& points, const char* solid = "neither") {
    outlines.push_back({{"name", name}, {"points", points}, {"solid", solid}});
  };
  for (const EdgeSegment& segment : scene.segments) add(segment.name, {segment.from, segment.to});
  for (const EdgePolygon& polygon : scene.polygons) {
    std::vector<Vec2d> points = polygon.points;
    points.push_back(polygon.points.front());
    add(polygon.name, points, polygon.solid == EdgePolygon::Solid::kInside ? "inside" : "outside");
  }
  const auto add_arc = [&](const EdgeArc& arc) {
    std::vector<Vec2d> points;
    const int chords = std::max(1, static_cast<int>(std::ceil((arc.to - arc.from) / kChord)));
    for (int i = 0; i <= chords; ++i) {
      const double angle = arc.from + (arc.to - arc.from) * i / chords;
      points.push_back(arc.center + arc.radius * Vec2d(std::cos(angle), std::sin(angle)));
    }
    add(arc.name, points);
  };
  for (const EdgeArc& arc : scene.arcs) add_arc(arc);
  for (const Pocket& pocket : scene.pockets) {
    add_arc({pocket.name, pocket.position, pocket.radius, 0, 2 * std::numbers::pi});
  }
  return outlines;
}

}  // namespace

Panel ScenePanel(const Scene& scene, const std::string& title) {
  Panel panel{.title = title, .x = {.label = "x (m)"}, .y = {.label = "y (m)"}, .equal_aspect = true};
  const auto add_circle = [&](const Vec2d& centre, double radius, const char* colour, double opacity) {
    panel.circles.push_back({{"centre", centre}, {"radius", radius}, {"colour", colour}, {"opacity", opacity}});
  };
  for (const Body& body : scene.bodies) add_circle(body.position, body.radius, "#555555", 0.25);
  for (const Plane& plane : scene.planes) {
    panel.half_planes.push_back({{"point", plane.point}, {"normal", plane.normal}});
  }
  panel.outlines = OutlinesOf(scene);
  for (const TerminalTerm& term : scene.objective.terminal) {
    if (term.component || term.region || term.quantity != TerminalTerm::Quantity::kPosition) continue;
    add_circle(term.target, 0.03, "#000000", 1.0);
  }
  return panel;
}

// ---- Replays

namespace {

constexpr size_t kMostIntervals = 4000;    // of a control; more are joined
constexpr double kPositionQuantum = 1e-7;  // of the drawing's size
constexpr double kOtherQuantum = 1e-6;     // of the largest velocity or force
constexpr double kAngleQuantum = 1e-5;     // rad
constexpr size_t kMostTouches = 20000;     // of a motion; more are not seen

// Packs numbers in rows of `columns`; column j has the quantum j modulo their number.
Json Pack(const std::vector<double>& numbers, size_t columns, const std::vector<double>& quanta) {
  std::vector<int64_t> differences;
  differences.reserve(numbers.size());
  for (size_t column = 0; column < columns; ++column) {
    const double quantum = quanta[column % quanta.size()];
    int64_t value = 0, slope = 0;
    for (size_t i = column; i < numbers.size(); i += columns) {
      // A number that is not finite is drawn at the position before it.
      const double multiple = numbers[i] / quantum;
      const int64_t next = std::abs(multiple) < 4e15 ? std::llround(multiple) : value;
      differences.push_back(next - value - slope);
      slope = next - value;
      value = next;
    }
  }
  return {{"quanta", quanta}, {"data", std::move(differences)}};
}

// Returns the largest of |numbers[i]| over i = first, first + 1 modulo `period`; 1 if all are 0.
double Largest(const std::vector<double>& numbers, size_t first, size_t period) {
  double largest = 0;
  for (size_t i = 0; i < numbers.size(); ++i) {
    if (i % period < first || i % period > first + 1 || !std::isfinite(numbers[i])) continue;
    largest = std::max(largest, std::abs(numbers[i]));
  }
  return largest > 0 ? largest : 1;
}

// Returns the extent of the positions of all motions, m.
double SizeOf(const Replay& replay) {
  double size = 0;
  for (size_t j = 0; j < 2; ++j) {
    double low = HUGE_VAL, high = -HUGE_VAL;
    for (const ReplayMotion& drawn : replay.motions) {
      const std::vector<double>& states = drawn.motion.states;
      for (size_t i = j; i < states.size(); i += 4) {
        if (!std::isfinite(states[i])) continue;
        low = std::min(low, states[i]);
        high = std::max(high, states[i]);
      }
    }
    if (high >= low) size = std::max(size, high - low);
  }
  for (const Body& body : replay.scene.bodies) size = std::max(size, body.radius);
  return size > 0 ? size : 1;
}

double Rounded(double value) { return std::isfinite(value) ? RoundedTo(6, value) : 0; }

Json TouchesToJson(const std::vector<TouchSpan>& touches) {
  Json list = Json::array();
  for (const auto& [contact, begin, end, impulse] : touches) {
    if (list.size() == kMostTouches) break;
    list.push_back({contact.a, contact.b, contact.plane ? 1 : 0, begin, end, Rounded(impulse[0]), Rounded(impulse[1])});
  }
  return list;
}

// Adds the discs that are pushed, the ends of the intervals, forces and torques.
void AddControl(const Scene& scene, const MotionInput& input, Json* json) {
  const size_t pushed = input.control.empty() ? 0 : scene.control.bodies.size();
  std::vector<double> ends, forces, torques;
  if (pushed > 0) {
    ControlGuess control{input.control, input.durations};
    const double duration = DurationOf(control, scene);
    if (control.control.size() / scene.control_width() > kMostIntervals) {
      control.control = MeanOverSteps(control, scene.control_width(), kMostIntervals);
      control.durations.assign(kMostIntervals, duration / kMostIntervals);
    }
    double end = 0;
    for (const double length : LengthsOf(control, scene)) ends.push_back(end += length);
    const std::vector<double> rows = RowsOfControl(scene, control.control);
    const size_t columns = ControlColumns(scene);
    for (size_t i = 0; i < rows.size(); i += columns) {
      forces.insert(forces.end(), {rows[i], rows[i + 1]});
      if (columns > 2) torques.push_back(rows[i + 2]);
    }
  }
  CHECK_EQ(forces.size(), ends.size() * pushed * 2);
  (*json)["pushed"] = pushed > 0 ? scene.control.bodies : std::vector<int>();
  (*json)["ends"] = ends;
  (*json)["control"] = Pack(forces, 2 * pushed, {kOtherQuantum * Largest(forces, 0, 2)});
  (*json)["torques"] = torques.empty() ? Json() : Pack(torques, pushed, {kOtherQuantum * Largest(torques, 0, 1)});
}

Json MotionToJson(const Scene& scene, const ReplayMotion& drawn, double size, double speed) {
  const Motion& motion = drawn.motion;
  const size_t discs = scene.bodies.size();
  CHECK(!motion.times.empty());
  CHECK_EQ(motion.states.size(), motion.times.size() * discs * 4);
  CHECK(motion.rotations.empty() || motion.rotations.size() == motion.times.size() * discs * kSpin);
  const double position = kPositionQuantum * size, velocity = kOtherQuantum * speed;
  std::vector<double> angles;
  for (size_t i = 0; i < motion.rotations.size(); i += kSpin) angles.push_back(motion.rotations[i]);
  Json json = {{"label", drawn.label},
               {"remark", drawn.remark},
               {"shown", drawn.shown},
               {"colour", drawn.colour},
               {"dash", drawn.dash},
               {"arcs", motion.arcs},
               {"times", motion.times},
               {"states", Pack(motion.states, 4 * discs, {position, position, velocity, velocity})},
               {"angles", angles.empty() ? Json() : Pack(angles, discs, {kAngleQuantum})},
               {"touches", TouchesToJson(motion.touches)}};
  AddControl(scene, drawn.input, &json);
  for (const ReplaySpread& spread : drawn.spreads) {
    CHECK_EQ(spread.covariances.size(), spread.times.size() * discs * 3);
    json["spreads"].push_back({{"label", spread.label}, {"times", spread.times}, {"covariances", spread.covariances}});
  }
  return json;
}

// Returns the discs, with the bounds of each component of the force on them, N, of the force's length, N, and of the
// torque, N m; 0 without a bound.
Json DiscsToJson(const Scene& scene) {
  Json discs = Json::array();
  for (const Body& body : scene.bodies) {
    discs.push_back({{"name", body.name}, {"radius", body.radius}, {"fixed", body.fixed}, {"bounds", {0.0, 0.0, 0.0}}});
  }
  const Control& control = scene.control;
  for (size_t i = 0; i < control.bodies.size(); ++i) {
    Json& bounds = discs[control.bodies[i]]["bounds"];
    if (!control.max.empty()) bounds[0] = control.max[i];
    if (!control.max_norm.empty()) bounds[1] = control.max_norm[i];
  }
  for (size_t i = 0; i < control.max_torque.size(); ++i)
    discs[control.torque_bodies[i]]["bounds"][2] = control.max_torque[i];
  return discs;
}

// Returns points of a prescribed motion with their times, so many for each of its cubics that lines between them show
// it.
Json PathToJson(const PrescribedMotion& motion) {
  constexpr int kParts = 32;
  const PathMotion path(motion);
  Json json = {{"times", Json::array()}, {"points", Json::array()}};
  for (size_t i = 0; i + 1 < motion.times.size(); ++i) {
    for (int part = 0; part < kParts + (i + 2 == motion.times.size()); ++part) {
      const double time = motion.times[i] + (motion.times[i + 1] - motion.times[i]) * part / kParts;
      json["times"].push_back(time);
      json["points"].push_back(path.SampleAt(time).position);
    }
  }
  return json;
}

// Returns the parts of WallPartsOf(). Half-planes are drawn; outlines show the others.
Json WallsToJson(const Scene& scene) {
  Json walls = Json::array();
  for (const WallPart& part : WallPartsOf(scene)) {
    const Wall<double>& wall = part.wall;
    const bool circle = wall.curved(), line = !circle && !part.table;
    Vec2d point = Vec2d::Zero();  // on the line, or the centre
    if (circle) point = wall.center;
    if (line) point = part.extent.endless ? Vec2d(wall.offset * wall.normal) : part.from;
    if (walls.size() < scene.planes.size()) point = scene.planes[walls.size()].point;
    walls.push_back({{"name", part.name},
                     {"kind",
                      circle                ? "circle"
                      : part.table          ? "table"
                      : part.extent.endless ? "half-plane"
                                            : "side"},
                     {"point", point},
                     {"normal", line ? Vec2d(wall.normal) : Vec2d(0, 1)},
                     {"radius", circle ? wall.radius : 0.0}});
    const size_t index = walls.size() - 1;
    if (index < scene.planes.size() && scene.planes[index].motion) {
      walls.back()["motion"] = PathToJson(*scene.planes[index].motion);
    }
  }
  return walls;
}

// Returns what is drawn of a scene beside its motions.
Json PlaceToJson(const Scene& scene) {
  return {{"discs", DiscsToJson(scene)}, {"walls", WallsToJson(scene)}, {"outlines", OutlinesOf(scene)}};
}

}  // namespace

ReplayMotion::ReplayMotion(Motion drawn, MotionInput from, std::string name, std::string_view style_of_model)
    : motion(std::move(drawn)),
      input(std::move(from)),
      label(std::move(name)),
      model(style_of_model),
      remark(motion.failure),
      colour(StyleOf(style_of_model).colour),
      dash(StyleOf(style_of_model).dash) {}

MotionOptions ReplayOptions(const Scene& scene, std::size_t motions) {
  MotionOptions options;
  const std::size_t per_node = 4 * scene.bodies.size() * std::max<std::size_t>(motions, 1);
  options.most_nodes = std::clamp<std::size_t>(kMostReplayNumbers / per_node, 2, 4000);
  options.stop = InterruptGuard::GraceIsOver;
  return options;
}

Json ReplayToJson(const Replay& replay) {
  const Scene& scene = replay.scene;
  CHECK(!scene.bodies.empty() && !replay.motions.empty());
  const Json place = PlaceToJson(scene);
  Json data = place;
  data.update({{"targets", Json::array()}, {"motions", Json::array()}});
  for (const TerminalTerm& term : scene.objective.terminal) {
    if (term.component || term.region || term.quantity != TerminalTerm::Quantity::kPosition) continue;
    data["targets"].push_back(term.target);
  }
  const double size = SizeOf(replay);
  double speed = 0;
  for (const ReplayMotion& drawn : replay.motions) speed = std::max(speed, Largest(drawn.motion.states, 2, 4));
  for (const ReplayMotion& drawn : replay.motions) {
    Json& motion = data["motions"].emplace_back(MotionToJson(scene, drawn, size, speed));
    if (!drawn.scene) continue;
    CHECK_EQ(drawn.scene->bodies.size(), scene.bodies.size());
    const Json own = PlaceToJson(*drawn.scene);
    if (own != place) motion.update(own);
  }
  return data;
}

}  // namespace saltus
