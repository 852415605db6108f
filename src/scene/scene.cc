#include "saltus/scene/scene.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <numbers>
#include <set>
#include <string_view>
#include <unordered_map>

#include "base/number_text.h"
#include "saltus/scene/materials.h"
#include "saltus/scene/scene_parameter.h"
#include "scene/polygon.h"
#include "scene/scene_rules.h"
#include "scene/units.h"

namespace saltus {
namespace {

constexpr std::size_t kLongestName = 100;  // names become parts of file names

struct Range {
  double low, high;
  const char* expected;
};
struct Ranges {
  Range any, positive, above_zero, not_negative;
};
constexpr double kLeast = std::numeric_limits<double>::min();
constexpr Ranges kGivenRanges{
    {-kLargestMagnitude, kLargestMagnitude, "a finite number of magnitude at most 1e24"},
    {kSmallestPositive, kLargestMagnitude, "a positive number, 1e-24 to 1e24"},
    // The duration of a part of a horizon may be shorter than that of a whole one.
    {kLeast, kLargestMagnitude, "a positive number, up to 1e24"},
    {0, kLargestMagnitude, "a number >= 0 and at most 1e24"},
};
// Limits in converted units. Products of four such numbers do not overflow.
constexpr double kLargestConverted = 1e72;
constexpr Ranges kConvertedRanges{
    {-kLargestConverted, kLargestConverted, "a finite number of magnitude at most 1e72"},
    {1 / kLargestConverted, kLargestConverted, "a positive number, 1e-72 to 1e72"},
    {kLeast, kLargestConverted, "a positive number, up to 1e72"},
    {0, kLargestConverted, "a number >= 0 and at most 1e72"},
};
constexpr Range kFraction{0, 1, "a number from 0 to 1"};

// The path of a number in the scene file; its text is made only when it is needed.
struct Key {
  const char* list = "";
  std::optional<std::size_t> index = std::nullopt;
  const char* field = nullptr;
  std::optional<int> component = std::nullopt;

  std::string ToString() const {
    std::string path = list;
    if (index) path += '[' + std::to_string(*index) + ']';
    if (field) path += std::string(".") + field;
    if (component) path += '[' + std::to_string(*component) + ']';
    return path;
  }
};

Key KeyAt(const char* list, std::size_t index, const char* field = nullptr) { return {list, index, field}; }

bool IsConverted(const Scene& scene) {
  Units given;
  given.natural = scene.units.natural;
  return scene.units != given;
}

// Returns a name as it may stand in a message; a name in a file can have any characters and any length.
std::string Quoted(const std::string& name) {
  std::string text = name.substr(0, kLongestName);
  std::replace_if(
      text.begin(), text.end(), [](char c) { return c < ' ' || c > '~'; }, '?');
  return '"' + text + (name.size() > kLongestName ? "...\"" : "\"");
}

// Checks rules in order and keeps the first one that is broken.
class Rules {
 public:
  // With `structure_only`, checks the rules of ValidateStructure only.
  Rules(const Scene& scene, bool structure_only)
      : scene_(scene), all_(!structure_only), in_(IsConverted(scene) ? kConvertedRanges : kGivenRanges) {}

  std::optional<SceneError> Check() {
    CheckTime();
    CheckBodies();
    CheckPlanes();
    CheckSegments();
    CheckPolygons();
    CheckArcs();
    CheckPockets();
    CheckTable();
    CheckForces();
    CheckContact();
    CheckMaterials();
    CheckControl();
    CheckObjective();
    CheckFree();
    CheckFreeSpin();
    CheckDesign();
    CheckNoContact();
    return error_;
  }

 private:
  // Checks one rule. `message` makes the text, which is too costly to make for every number of a scene.
  template <typename Message>
  void Expect(bool holds, const Key& key, const Message& message) {
    if (!holds && !error_) error_ = SceneError{key.ToString(), message()};
  }
  void Expect(bool holds, const Key& key, const char* message) {
    Expect(holds, key, [&] { return std::string(message); });
  }

  void Number(const Key& key, double value, const Range& range) {
    Expect(value >= range.low && value <= range.high, key, [&] {
      return "found " + ToText(value) + ", expected " + range.expected;
    });
  }

  void Vector(const Key& key, const Vec2d& value) {
    for (int j = 0; j < 2; ++j) Number({key.list, key.index, key.field, j}, value[j], in_.any);
  }

  enum class Capitals { kNone, kAllowed };
  void Name(const Key& key, const std::string& name, std::string_view others, Capitals capitals = Capitals::kAllowed) {
    const bool with_capitals = capitals == Capitals::kAllowed;
    const auto ok = [&](char c) {
      return (c >= 'a' && c <= 'z') || (with_capitals && c >= 'A' && c <= 'Z') || (c >= '0' && c <= '9') ||
             others.find(c) != std::string_view::npos;
    };
    Expect(!name.empty() && name.size() <= kLongestName && std::all_of(name.begin(), name.end(), ok), key, [&] {
      return "found " + Quoted(name) + ", expected a name of 1 to 100 characters out of a-z, " +
             (with_capitals ? "A-Z, " : "") + "0-9 and " + std::string(others);
    });
  }

  // Checks the name of a body or plane, which must be unique.
  void UniqueName(const Key& key, const std::string& name) {
    if (!all_) return;
    Name(key, name, "_-.");
    const auto [other, is_new] = names_.emplace(name, key);
    Expect(is_new, key, [&, &other = other] {
      return "found " + name + ", which is " + other->second.ToString() + " too; expected a unique name";
    });
  }

  // Checks a list of bodies: each moves, and none is listed twice.
  void Movable(const char* list, const std::vector<int>& bodies) {
    if (bodies.empty()) return;
    std::vector<bool> seen(scene_.bodies.size(), false);
    for (std::size_t i = 0; i < bodies.size(); ++i) {
      if (!BodyIndex(KeyAt(list, i), bodies[i])) return;
      const Body& body = scene_.bodies[bodies[i]];
      Expect(!body.fixed, KeyAt(list, i), [&] {
        return "found " + body.name + ", which is fixed; expected a body that moves";
      });
      Expect(
          !seen[bodies[i]], KeyAt(list, i), [&] { return "found " + body.name + " twice; expected each body once"; });
      seen[bodies[i]] = true;
    }
  }

  bool BodyIndex(const Key& key, int body) {
    const bool in_range = body >= 0 && body < scene_.num_bodies();
    Expect(in_range, key, [&] {
      return "found body number " + std::to_string(body) + ", expected one of the scene's bodies";
    });
    return in_range;
  }

  void CheckTime() {
    if (all_) Name({"name"}, scene_.name, "_", Capitals::kNone);
    Number({"duration"}, scene_.duration, all_ ? in_.positive : in_.above_zero);
    Expect(scene_.steps >= 1 && scene_.steps <= kMaxSteps, {"steps"}, [&] {
      return "found " + std::to_string(scene_.steps) + ", expected a whole number from 1 to " +
             std::to_string(kMaxSteps);
    });
    Vector({"gravity"}, scene_.gravity);
  }

  void CheckBodies() {
    Expect(!scene_.bodies.empty(), {"bodies"}, "found none, expected at least one body");
    for (std::size_t i = 0; i < scene_.bodies.size() && !error_; ++i) {
      const Body& body = scene_.bodies[i];
      UniqueName(KeyAt("bodies", i, "name"), body.name);
      Number(KeyAt("bodies", i, "radius"), body.radius, in_.positive);
      if (!body.fixed) Number(KeyAt("bodies", i, "mass"), body.mass, in_.positive);
      Vector(KeyAt("bodies", i, "position"), body.position);
      Vector(KeyAt("bodies", i, "velocity"), body.velocity);
      if (body.path) {
        Expect(
            body.fixed, KeyAt("bodies", i, "path"), "found a path of a body that moves freely, expected a fixed body");
        CheckPath("bodies", i, "path", *body.path);
      }
      if (body.fixed)
        Expect(body.velocity.isZero(0), KeyAt("bodies", i, "velocity"), "expected [0, 0]: the body is fixed");
      CheckSpin(i);
    }
  }

  void CheckSpin(std::size_t i) {
    const Body& body = scene_.bodies[i];
    if (body.inertia.kind == Inertia::Kind::kGiven)
      Number(KeyAt("bodies", i, "inertia"), body.inertia.moment, in_.positive);
    Expect(!body.Spins() || !body.fixed,
           KeyAt("bodies", i, "inertia"),
           "found an inertia, expected none: the body is fixed");
    Number(KeyAt("bodies", i, "angle"), body.angle, in_.any);
    Number(KeyAt("bodies", i, "angular_velocity"), body.angular_velocity, in_.any);
    if (body.Spins()) return;
    constexpr char kNoInertia[] = "expected 0, or inertia: solid or a number in kg m^2: without inertia it cannot spin";
    Expect(body.angle == 0, KeyAt("bodies", i, "angle"), kNoInertia);
    Expect(body.angular_velocity == 0, KeyAt("bodies", i, "angular_velocity"), kNoInertia);
  }

  void CheckPath(const char* list, std::size_t i, const char* field, const PrescribedMotion& path) {
    const Key key = KeyAt(list, i, field);
    Expect(path.times.size() >= 2 && path.times.size() == path.positions.size(), key, [&] {
      return "found " + std::to_string(path.times.size()) + " times and " + std::to_string(path.positions.size()) +
             " positions, expected at least two, and a position for each time";
    });
    for (std::size_t k = 0; k < path.times.size() && !error_; ++k) {
      const Key row{list, i, field, static_cast<int>(k)};
      Number(row, path.times[k], in_.any);
      for (int j = 0; j < 2; ++j) Number(row, path.positions[k][j], in_.any);
      Expect(k == 0 || path.times[k] > path.times[k - 1], row, "expected times that rise");
    }
    if (error_) return;
    const std::optional<FreeDuration>& free = scene_.objective.duration;
    const double end = free ? std::max(free->max, scene_.duration) : scene_.duration;
    constexpr double kRounding = 1e-12;  // of the duration, which may be a sum of intervals
    const bool covers = path.times.front() <= kRounding * end && path.times.back() >= (1 - kRounding) * end;
    Expect(covers, key, [&] {
      return "found times from " + ToText(path.times.front()) + " to " + ToText(path.times.back()) +
             ", expected them to cover the motion, from 0 to " + ToText(end);
    });
  }

  void CheckPlanes() {
    for (std::size_t i = 0; i < scene_.planes.size() && !error_; ++i) {
      const Plane& plane = scene_.planes[i];
      UniqueName(KeyAt("planes", i, "name"), plane.name);
      Vector(KeyAt("planes", i, "point"), plane.point);
      if (plane.motion) CheckPath("planes", i, "motion", *plane.motion);
      Vector(KeyAt("planes", i, "normal"), plane.normal);
      const double length = std::hypot(plane.normal[0], plane.normal[1]);
      Expect(length >= kSmallestPositive, KeyAt("planes", i, "normal"), [&] {
        return "found a vector of length " + ToText(length) + ", expected one of length at least 1e-24";
      });
    }
  }

  void CheckSegments() {
    for (std::size_t i = 0; i < scene_.segments.size() && !error_; ++i) {
      const EdgeSegment& segment = scene_.segments[i];
      UniqueName(KeyAt("segments", i, "name"), segment.name);
      Vector(KeyAt("segments", i, "from"), segment.from);
      Vector(KeyAt("segments", i, "to"), segment.to);
      Expect((segment.to - segment.from).norm() >= in_.positive.low,
             KeyAt("segments", i, "to"),
             "found the point where it begins, expected another: a segment has a length");
    }
  }

  void CheckPolygons() {
    for (std::size_t i = 0; i < scene_.polygons.size() && !error_; ++i) {
      const EdgePolygon& polygon = scene_.polygons[i];
      UniqueName(KeyAt("polygons", i, "name"), polygon.name);
      for (std::size_t k = 0; k < polygon.points.size(); ++k) {
        for (int j = 0; j < 2; ++j) {
          Number({"polygons", i, "points", static_cast<int>(k)}, polygon.points[k][j], in_.any);
        }
      }
      if (error_) return;
      const std::string wrong = ValidatePolygon(polygon.points, all_);
      Expect(wrong.empty(), KeyAt("polygons", i, "points"), [&] { return wrong; });
    }
  }

  void CheckArcs() {
    for (std::size_t i = 0; i < scene_.arcs.size() && !error_; ++i) {
      const EdgeArc& arc = scene_.arcs[i];
      UniqueName(KeyAt("arcs", i, "name"), arc.name);
      Vector(KeyAt("arcs", i, "center"), arc.center);
      Number(KeyAt("arcs", i, "radius"), arc.radius, in_.positive);
      Number(KeyAt("arcs", i, "from"), arc.from, in_.any);
      const double turn = arc.to - arc.from;
      Expect(turn > 0 && turn <= 2 * std::numbers::pi * (1 + 1e-9), KeyAt("arcs", i, "to"), [&] {
        return "found " + ToText(arc.to) + " rad, expected more than from, by at most a full turn";
      });
    }
  }

  void CheckPockets() {
    for (std::size_t i = 0; i < scene_.pockets.size() && !error_; ++i) {
      const Pocket& pocket = scene_.pockets[i];
      UniqueName(KeyAt("pockets", i, "name"), pocket.name);
      Vector(KeyAt("pockets", i, "position"), pocket.position);
      Number(KeyAt("pockets", i, "radius"), pocket.radius, in_.positive);
    }
  }

  void CheckTable() {
    if (!scene_.table) return;
    Number({"table.friction"}, scene_.table->friction, in_.not_negative);
    Number({"table.gravity"}, scene_.table->gravity, in_.not_negative);
  }

  void CheckForces() {
    const auto movable = [&](const Key& key, int body) {
      if (!BodyIndex(key, body)) return;
      Expect(!scene_.bodies[body].fixed, key, [&] {
        return "found " + scene_.bodies[body].name + ", which is fixed; expected a body that moves";
      });
    };
    std::set<int> dragged;
    for (std::size_t i = 0; i < scene_.forces.size() && !error_; ++i) {
      if (const auto* drag = std::get_if<Drag>(&scene_.forces[i])) {
        movable(KeyAt("forces", i, "drag.body"), drag->body);
        const bool is_new = dragged.insert(drag->body).second;
        Expect(is_new, KeyAt("forces", i, "drag.body"), "found it again, expected the drag of each body once");
        Number(KeyAt("forces", i, "drag.linear"), drag->linear, in_.not_negative);
        continue;
      }
      const auto& spring = std::get<Spring>(scene_.forces[i]);
      movable(KeyAt("forces", i, "spring.body"), spring.body);
      if (spring.to != -1) BodyIndex(KeyAt("forces", i, "spring.to"), spring.to);
      Expect(spring.to != spring.body, KeyAt("forces", i, "spring.to"), "found the body itself, expected another body");
      Vector(KeyAt("forces", i, "spring.to"), spring.point);
      Number(KeyAt("forces", i, "spring.stiffness"), spring.stiffness, in_.not_negative);
      Number(KeyAt("forces", i, "spring.length"), spring.length, in_.not_negative);
      Number(KeyAt("forces", i, "spring.damping"), spring.damping, in_.not_negative);
    }
    constexpr char kAlone[] =
        "found drag or springs in a scene with a table or pockets, whose discs stop on exact arcs; "
        "expected one of the two";
    Expect(scene_.forces.empty() || (!scene_.table && scene_.pockets.empty()), {"forces"}, kAlone);
  }

  void CheckContact() {
    Number({"contact.restitution"}, scene_.contact.restitution, kFraction);
    Number({"contact.friction"}, scene_.contact.friction, in_.not_negative);
    Number({"contact.stiffness"}, scene_.contact.stiffness, in_.not_negative);
    Number({"contact.damping"}, scene_.contact.damping, in_.not_negative);
  }

  void CheckMaterials() {
    std::set<std::string> names;
    for (const Material& material : scene_.materials) {
      if (all_) {
        Name({"materials"}, material.name, "_.");
        Expect(names.insert(material.name).second, {"materials"}, [&] {
          return "found " + material.name + " twice, expected each material once";
        });
        Expect(material.name != kNoMaterial,
               {"materials"},
               "found the name default, expected another: it is that of what has no material");
      }
      const std::string key = "materials." + material.name, e = key + ".restitution", mu = key + ".friction";
      Number({e.c_str()}, material.contact.restitution, kFraction);
      Number({mu.c_str()}, material.contact.friction, in_.not_negative);
    }
    std::map<std::pair<int, int>, std::size_t> known;
    for (std::size_t i = 0; i < scene_.pairs.size() && !error_; ++i) {
      const MaterialPair& pair = scene_.pairs[i];
      for (const int material : {pair.a, pair.b}) MaterialIndex(KeyAt("pairs", i, "between"), material);
      const auto [first, is_new] = known.emplace(std::minmax(pair.a, pair.b), i);
      Expect(is_new, KeyAt("pairs", i, "between"), [&, &first = first] {
        return "found the pair of pairs[" + std::to_string(first->second) + "] again, expected each pair once";
      });
      Expect(pair.restitution || pair.friction, KeyAt("pairs", i), "expected restitution, friction or both");
      Number(KeyAt("pairs", i, "restitution"), pair.restitution.value_or(0), kFraction);
      Number(KeyAt("pairs", i, "friction"), pair.friction.value_or(0), in_.not_negative);
    }
    MaterialsOf("bodies", scene_.bodies);
    MaterialsOf("planes", scene_.planes);
    MaterialsOf("segments", scene_.segments);
    MaterialsOf("polygons", scene_.polygons);
    MaterialsOf("arcs", scene_.arcs);
  }
  void MaterialIndex(const Key& key, int material) {
    Expect(material >= -1 && material < static_cast<int>(scene_.materials.size()), key, [&] {
      return "found material number " + std::to_string(material) + ", expected one of the scene's materials";
    });
  }
  template <typename Thing>
  void MaterialsOf(const char* list, const std::vector<Thing>& things) {
    for (std::size_t i = 0; i < things.size(); ++i) MaterialIndex(KeyAt(list, i, "material"), things[i].material);
  }

  void CheckControl() {
    const Control& control = scene_.control;
    Movable("control.bodies", control.bodies);
    Expect(control.initial.size() == control.bodies.size(), {"control.initial"}, [&] {
      return "found " + std::to_string(control.initial.size()) + " forces, expected one for each of the " +
             std::to_string(control.bodies.size()) + " controlled bodies";
    });
    for (std::size_t i = 0; i < control.initial.size(); ++i) Vector(KeyAt("control.initial", i), control.initial[i]);
    Bounds("control.max", control.max, control.bodies, " controlled bodies");
    Bounds("control.max_norm", control.max_norm, control.bodies, " controlled bodies");
    CheckTorques();
    if (!all_) return;
    Expect(scene_.optimize != Optimize::kControl || !control.bodies.empty(),
           {"optimize"},
           "found control, expected velocity, position or none: no body is controlled");
  }

  void CheckTorques() {
    const Control& control = scene_.control;
    Movable("control.torque", control.torque_bodies);
    for (std::size_t i = 0; i < control.torque_bodies.size() && !error_; ++i) {
      const Body& body = scene_.bodies[control.torque_bodies[i]];
      const auto& bodies = control.bodies;
      Expect(std::find(bodies.begin(), bodies.end(), control.torque_bodies[i]) != bodies.end(),
             KeyAt("control.torque", i),
             [&] { return "found " + body.name + ", expected one of control.bodies"; });
      Expect(body.Spins(), KeyAt("control.torque", i), [&] {
        return "found " + body.name + ", which has no inertia; expected a body that spins";
      });
    }
    Expect(control.initial_torque.size() == control.torque_bodies.size(), {"control.initial"}, [&] {
      return "found " + std::to_string(control.initial_torque.size()) + " torques, expected one for each of the " +
             std::to_string(control.torque_bodies.size()) + " bodies in control.torque";
    });
    for (std::size_t i = 0; i < control.initial_torque.size(); ++i) {
      Number(KeyAt("control.initial", i), control.initial_torque[i], in_.any);
    }
    Bounds("control.max_torque", control.max_torque, control.torque_bodies, " bodies in control.torque");
  }

  // Checks bounds: none, or one for each of these bodies.
  void Bounds(const char* key, const std::vector<double>& bounds, const std::vector<int>& bodies, const char* which) {
    Expect(bounds.empty() || bounds.size() == bodies.size(), {key}, [&] {
      return "found " + std::to_string(bounds.size()) + " bounds, expected one number, or one for each of the " +
             std::to_string(bodies.size()) + which;
    });
    for (std::size_t i = 0; i < bounds.size(); ++i) Number(KeyAt(key, i), bounds[i], in_.positive);
  }

  void PositionOrVelocity(const Key& key, TerminalTerm::Quantity quantity) {
    using Quantity = TerminalTerm::Quantity;
    Expect(quantity == Quantity::kPosition || quantity == Quantity::kVelocity, key, [&] {
      return std::string("found ") + kQuantities[static_cast<std::size_t>(quantity)] +
             ", expected position or velocity: rotation is read at the final time only, by objective.terminal";
    });
  }

  void CheckRunning() {
    for (std::size_t i = 0; i < scene_.objective.running.size(); ++i) {
      const RunningTerm& term = scene_.objective.running[i];
      BodyIndex(KeyAt("objective.running", i, "body"), term.body);
      PositionOrVelocity(KeyAt("objective.running", i, "quantity"), term.quantity);
      const Key target = KeyAt("objective.running", i, "target");
      Expect(!term.times.empty() && term.times.size() == term.targets.size(), target, "expected rows [time, x, y]");
      for (std::size_t k = 0; k < term.times.size() && !error_; ++k) {
        const Key row{target.list, target.index, target.field, static_cast<int>(k)};
        Number(row, term.times[k], in_.any);
        for (int j = 0; j < 2; ++j) Number(row, term.targets[k][j], in_.any);
        Expect(k == 0 || term.times[k] > term.times[k - 1], row, "expected times that rise from row to row");
      }
      Number(KeyAt("objective.running", i, "weight"), term.weight, in_.not_negative);
    }
  }

  void CheckVia() {
    for (std::size_t i = 0; i < scene_.objective.via.size(); ++i) {
      const ViaTerm& term = scene_.objective.via[i];
      BodyIndex(KeyAt("objective.via", i, "body"), term.body);
      PositionOrVelocity(KeyAt("objective.via", i, "quantity"), term.quantity);
      Vector(KeyAt("objective.via", i, "target"), term.target);
      Number(KeyAt("objective.via", i, "weight"), term.weight, in_.not_negative);
      Expect(term.time > 0 && term.time < scene_.duration, KeyAt("objective.via", i, "time"), [&] {
        return "found " + ToText(term.time) + ", expected a time strictly between 0 and the duration, " +
               ToText(scene_.duration) + ": terms at its end belong in objective.terminal";
      });
    }
  }

  void CheckFreeDuration() {
    if (!scene_.objective.duration) return;
    const FreeDuration& duration = *scene_.objective.duration;
    Number({"objective.duration.min"}, duration.min, in_.positive);
    Number({"objective.duration.max"}, duration.max, in_.positive);
    Expect(duration.min <= duration.max, {"objective.duration.max"}, "found a number below min, expected min or more");
    Number({"objective.duration.weight"}, duration.weight, in_.not_negative);
    for (std::size_t i = 0; i < scene_.objective.via.size(); ++i) {
      const double time = scene_.objective.via[i].time;
      Expect(time < duration.max, KeyAt("objective.via", i, "time"), [&] {
        return "found " + ToText(time) + ", expected a time before objective.duration.max, " + ToText(duration.max);
      });
    }
  }

  void CheckNoContact() {
    for (std::size_t i = 0; i < scene_.no_contact.size(); ++i) {
      const NoContact& pair = scene_.no_contact[i];
      const Key key = KeyAt("no_contact", i);
      BodyIndex(key, pair.a);
      if (pair.plane) {
        Expect(
            pair.b >= 0 && pair.b < static_cast<int>(scene_.planes.size()), key, "expected one of the scene's planes");
      } else {
        BodyIndex(key, pair.b);
        Expect(pair.a < pair.b, key, "expected two different bodies, in the order of their indices");
      }
      if (!all_ || error_) continue;
      const bool moves = !scene_.bodies[pair.a].fixed || (!pair.plane && !scene_.bodies[pair.b].fixed);
      Expect(moves, key, "found two that never move, expected a pair of which one is a body that moves");
    }
  }

  void CheckRegion(std::size_t i, const TerminalTerm& term) {
    const TerminalTerm::Region& region = *term.region;
    Expect(
        term.hard, KeyAt("objective.terminal", i, "hard"), "found false, expected true: a goal region is a constraint");
    const TerminalTerm::Region none;
    bool any = false;
    for (int j = 0; j < 2 && !error_; ++j) {
      const auto bound = [&](const char* name, double given, double unbounded) {
        if (given == unbounded) return;
        Number({"objective.terminal", i, name, j}, given, in_.any);
        any = true;
      };
      bound("min", region.min[j], none.min[j]);
      bound("max", region.max[j], none.max[j]);
      Expect(region.min[j] <= region.max[j], KeyAt("objective.terminal", i, "min"), [&] {
        return "found " + ToText(region.min[j]) + " above max, " + ToText(region.max[j]) + ", expected at most that";
      });
    }
    Expect(any, KeyAt("objective.terminal", i, "min"), "found no bound, expected at least one number in min or max");
    if (error_) return;
    Expect(!scene_.bodies[term.body].fixed, KeyAt("objective.terminal", i, "body"), [&] {
      return "found " + scene_.bodies[term.body].name + ", which is fixed; expected a body that moves";
    });
    Expect(!term.IsRotational() || (std::isinf(region.min[1]) && std::isinf(region.max[1])),
           KeyAt("objective.terminal", i, "min"),
           "expected one number: it is of spin");
  }

  void CheckLimits() {
    for (std::size_t i = 0; i < scene_.objective.limits.size(); ++i) {
      const SpeedLimit& limit = scene_.objective.limits[i];
      BodyIndex(KeyAt("objective.limits", i, "body"), limit.body);
      Number(KeyAt("objective.limits", i, "speed"), limit.max, in_.positive);
      if (error_) return;
      Expect(!scene_.bodies[limit.body].fixed, KeyAt("objective.limits", i, "body"), [&] {
        return "found " + scene_.bodies[limit.body].name + ", which is fixed; expected a body that moves";
      });
    }
  }

  void CheckObjective() {
    const std::vector<TerminalTerm>& terms = scene_.objective.terminal;
    for (std::size_t i = 0; i < terms.size(); ++i) {
      const TerminalTerm& term = terms[i];
      BodyIndex(KeyAt("objective.terminal", i, "body"), term.body);
      Vector(KeyAt("objective.terminal", i, "target"), term.target);
      Number(KeyAt("objective.terminal", i, "weight"), term.weight, term.component ? in_.any : in_.not_negative);
      Expect(!term.component || *term.component == 0 || *term.component == 1,
             KeyAt("objective.terminal", i, "component"),
             "expected 0 (x) or 1 (y)");
      if (term.IsRotational() && !error_) {
        Expect(scene_.bodies[term.body].Spins(), KeyAt("objective.terminal", i, "quantity"), [&] {
          return std::string("found ") + kQuantities[static_cast<std::size_t>(term.quantity)] +
                 ", expected position or velocity: " + scene_.bodies[term.body].name +
                 " has no inertia and cannot spin";
        });
        Expect(!term.component && term.target[1] == 0,
               KeyAt("objective.terminal", i, "target"),
               "expected one number, and no component: it is of spin");
      }
      Expect(!term.hard || !term.component,
             KeyAt("objective.terminal", i, "hard"),
             "found a terminal equality constraint (hard) with a component, expected a target: a linear term is no "
             "constraint");
      if (term.region) CheckRegion(i, term);
    }
    Number({"objective.effort"}, scene_.objective.effort, in_.not_negative);
    CheckRunning();
    CheckVia();
    CheckLimits();
    CheckFreeDuration();
    if (!all_) return;
    Expect((scene_.optimize == Optimize::kNone && scene_.design.empty()) || !terms.empty(),
           {"objective.terminal"},
           "found no term, expected at least one: there is something to optimize");
  }

  void CheckFree() {
    Movable("free", scene_.free);
    if (!all_) return;
    const bool needed = scene_.optimize == Optimize::kVelocity || scene_.optimize == Optimize::kPosition;
    Expect(!needed || !scene_.free.empty(), {"free"}, "found no body, expected at least one that moves");
  }

  void CheckFreeSpin() {
    Movable("free_spin", scene_.free_spin);
    for (std::size_t i = 0; i < scene_.free_spin.size() && !error_; ++i) {
      const Body& body = scene_.bodies[scene_.free_spin[i]];
      Expect(body.Spins(), KeyAt("free_spin", i), [&] {
        return "found " + body.name + ", which has no inertia; expected a body that spins";
      });
    }
    if (!all_ || scene_.free_spin.empty()) return;
    Expect(scene_.optimize == Optimize::kVelocity,
           {"free_spin"},
           "found bodies, expected none: angular velocities are optimized with optimize: velocity");
  }

  // Returns how many objects of the scene have a parameter of this kind; -1 if it belongs to no object.
  int NumberOf(SceneParameter::Kind kind) const {
    using Kind = SceneParameter::Kind;
    if (kind == Kind::kMass || kind == Kind::kRadius || kind == Kind::kPosition || kind == Kind::kDrag) {
      return scene_.num_bodies();
    }
    if (kind == Kind::kPlaneOffset || kind == Kind::kPlaneAngle) return static_cast<int>(scene_.planes.size());
    if (kind == Kind::kSegmentOffset || kind == Kind::kSegmentAngle) return static_cast<int>(scene_.segments.size());
    return -1;
  }

  bool HasDrag(int body) const {
    return std::ranges::any_of(scene_.forces, [&](const StateForce& force) {
      const auto* drag = std::get_if<Drag>(&force);
      return drag != nullptr && drag->body == body;
    });
  }

  void CheckDesign() {
    using Kind = SceneParameter::Kind;
    const Key key{"optimize"};
    for (std::size_t i = 0; i < scene_.design.size() && !error_; ++i) {
      const auto& [parameter, min, max, moved] = scene_.design[i];
      const Kind kind = parameter.kind;
      Expect(kind >= Kind{} && kind <= Kind::kSegmentAngle && kind != Kind::kForce && kind != Kind::kLaw,
             key,
             "found a force or a law, expected a parameter of the scene");
      const int number = NumberOf(kind);
      Expect(number < 0 || (parameter.body >= 0 && parameter.body < number), key, [&] {
        return "found the index " + std::to_string(parameter.body) + ", expected one below " + std::to_string(number);
      });
      const bool of_pair = kind == Kind::kRestitution || kind == Kind::kFriction;
      const int components = of_pair ? std::max<int>(1, std::ssize(PairContactsOf(scene_))) : 2;
      Expect(parameter.component >= 0 && parameter.component < components, key, [&] {
        return "found the component " + std::to_string(parameter.component) + ", expected one below " +
               std::to_string(components);
      });
      if (error_) return;
      const auto found = [&] { return "found " + NameOf(parameter, scene_); };
      const bool fixed = (kind == Kind::kMass || kind == Kind::kPosition) && scene_.bodies[parameter.body].fixed;
      Expect(kind != Kind::kMass || !fixed, key, [&] { return found() + ", expected the mass of a body that moves"; });
      Expect(kind != Kind::kPosition || fixed, key, [&] {
        return found() + ", expected the position of a fixed body; those that move have optimize: position";
      });
      Expect(kind != Kind::kDrag || HasDrag(parameter.body), key, [&] {
        return found() + ", expected the drag of a body that has some in forces";
      });
      const bool on_path =
          (kind == Kind::kPosition && scene_.bodies[parameter.body].path) ||
          ((kind == Kind::kPlaneOffset || kind == Kind::kPlaneAngle) && scene_.planes[parameter.body].motion);
      Expect(!on_path, key, [&] { return found() + ", expected a position or wall without a prescribed motion"; });
      const std::vector<int>& turned = scene_.control.torque_bodies;
      const bool of_turned = kind == Kind::kRadius && std::ranges::find(turned, parameter.body) != turned.end();
      Expect(!of_turned, key, [&] { return found() + ", expected the radius of a body without a torque on it"; });
      for (std::size_t j = 0; j < i; ++j) {
        const SceneParameter& other = scene_.design[j].parameter;
        Expect(!(other == parameter), key, [&] { return found() + " again, expected it once"; });
        // Offset and angle of one segment do not commute: the order of the two would matter for its ends.
        const bool of_segment = kind >= Kind::kSegmentOffset && other.kind >= Kind::kSegmentOffset;
        Expect(!of_segment || other.body != parameter.body, key, [&] {
          return found() + " beside " + NameOf(other, scene_) + ", expected one of them";
        });
      }
      const ParameterRange widest = RangeOf({parameter});
      for (const std::optional<double>& bound : {min, max}) {
        if (bound) Number(key, *bound, in_.any);
        const bool beyond = bound && (*bound + kSmallestPositive < widest.min || *bound > widest.max);
        Expect(!beyond, key, [&] {
          return found() + " with the bound " + ToText(*bound) + ", expected one from " + ToText(widest.min) + " to " +
                 ToText(widest.max);
        });
      }
      const ParameterRange range = RangeOf(scene_.design[i]);
      const double value = ValueOf(scene_.design[i], scene_);
      Expect(range.min < range.max, key, [&] {
        return found() + " between " + ToText(range.min) + " and " + ToText(range.max) + ", expected min < max";
      });
      Expect(!all_ || (value >= range.min && value <= range.max), key, [&] {
        return found() + ", which is " + ToText(value) + " in the scene, expected a value from " + ToText(range.min) +
               " to " + ToText(range.max);
      });
    }
  }

  const Scene& scene_;
  const bool all_;
  const Ranges& in_;
  std::unordered_map<std::string, Key> names_;  // of bodies and planes
  std::optional<SceneError> error_;
};

// Returns the first rule of ValidateStructure that `scene` breaks in its natural units, in which solvers compute.
std::optional<SceneError> BrokenInNaturalUnits(const Scene& scene) {
  if (scene.units.natural) return std::nullopt;
  const Scene natural = ToNaturalUnits(scene);
  std::optional<SceneError> error = BrokenRule(natural);
  if (!error) return error;
  const Units& units = natural.units;
  error->message += "; this is in the units of the scene, " + ToText(units.length) + " m, " + ToText(units.time) +
                    " s and " + ToText(units.mass) + " kg, which are too far from the value of the key";
  return error;
}

}  // namespace

std::optional<SceneError> BrokenRule(const Scene& scene) { return Rules(scene, /*structure_only=*/true).Check(); }

std::optional<SceneError> Validate(const Scene& scene) {
  if (auto error = Rules(scene, /*structure_only=*/false).Check()) return error;
  if (auto error = BrokenInNaturalUnits(scene)) return error;
  return FindOverlap(scene);  // meaningful for finite numbers only
}

std::optional<SceneError> ValidateStructure(const Scene& scene) {
  if (auto error = BrokenRule(scene)) return error;
  return BrokenInNaturalUnits(scene);
}

bool Objective::HasConstraints() const {
  const auto hard = [](const auto& term) { return term.hard; };
  return std::ranges::any_of(terminal, hard) || std::ranges::any_of(via, hard) || !limits.empty();
}

bool Objective::IsSumOfSquares() const {
  return std::none_of(terminal.begin(), terminal.end(), [](const TerminalTerm& term) { return term.component; });
}

Scene::Scene() = default;
Scene::Scene(const Scene& other) = default;
Scene::Scene(Scene&& other) noexcept = default;
Scene& Scene::operator=(const Scene& other) = default;
Scene& Scene::operator=(Scene&& other) noexcept = default;
Scene::~Scene() = default;
bool Scene::operator==(const Scene& other) const = default;

bool Scene::Spins() const {
  return std::any_of(bodies.begin(), bodies.end(), [](const Body& body) { return body.Spins(); });
}

bool Scene::HasPaths() const {
  return std::ranges::any_of(bodies, [](const Body& body) { return body.path.has_value(); }) ||
         std::ranges::any_of(planes, [](const Plane& plane) { return plane.motion.has_value(); });
}

const char* OptimizeToString(Optimize optimize) {
  constexpr const char* kNames[] = {"control", "velocity", "position", "none"};
  return kNames[static_cast<int>(optimize)];
}

}  // namespace saltus
