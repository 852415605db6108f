#include "hybrid/mechanical/bodies_file.h"

#include <algorithm>
#include <array>
#include <initializer_list>
#include <limits>
#include <numeric>

#include "scene/scene_reader.h"

namespace saltus {
namespace {

using internal::Value;
using JointKind = RigidJoint2D::Kind;

constexpr std::array kComponents = {".x", ".y", ".angle"};

Point2D ToPoint(const Vec2d& vector) { return {vector[0], vector[1]}; }

double ReadAtLeast(double least, const Value& value, const char* expected, double most = 1e24) {
  const double number = ReadNumber(value, expected);
  if (!(number >= least && number <= most)) FailExpected(value, expected);
  return number;
}

double ReadPositive(const Value& value, const char* expected) { return ReadAtLeast(1e-24, value, expected); }

// Reads a file of bodies: its own keys, and parts that scene files have too.
class BodiesReader final : internal::SceneReader {
 public:
  BodiesProblem Read(const YAML::Node& root);

 private:
  // Reads a direction and returns it with length 1.
  Point2D ReadDirection(const Value& value) {
    const Vec2d vector = ReadVector(value);
    if (!(vector.norm() > 0)) FailExpected(value, "a vector of another length than zero");
    return ToPoint(vector / vector.norm());
  }

  RigidJoint2D ReadJoint(const Value& value) {
    if (!value.node.IsMap()) {
      const std::string word = value.node.IsScalar() ? value.node.Scalar() : "";
      if (word == "free") return {};
      if (word == "translation") return {JointKind::kTranslation};
      if (word == "weld") return {JointKind::kWeld};
      FailExpected(value, "one of free, translation, weld, {revolute: [x, y]} and {prismatic: [x, y]}");
    }
    const Fields fields = ReadFields(value, {"revolute", "prismatic"});
    if (fields.values.size() != 1) FailExpected(value, "either revolute or prismatic");
    if (const Value* point = fields.Find("revolute")) {
      return {.kind = JointKind::kRevolute, .point = ToPoint(ReadVector(*point))};
    }
    return {.kind = JointKind::kPrismatic, .axis = ReadDirection(*fields.Find("prismatic"))};
  }

  void ReadShape(const Fields& fields, RigidBody2D* body) {
    const Value *box = fields.Find("box"), *polygon = fields.Find("polygon"), *radius = fields.Find("radius");
    if ((box != nullptr) + (polygon != nullptr) + (radius != nullptr) != 1) {
      Fail(fields.map, "expected one of the keys box, polygon and radius");
    }
    if (radius != nullptr) {
      body->radius = ReadPositive(*radius, "a radius above zero in m");
    } else if (box != nullptr) {
      const Vec2d half = ReadVector(*box);
      if (!(half.minCoeff() > 0)) FailExpected(*box, "half the width and half the height, above zero, in m");
      body->polygon = BoxPolygon(half[0], half[1]);
    } else {
      for (const Value& vertex : ReadList(*polygon, "a list of vertices [x, y]")) {
        body->polygon.push_back(ToPoint(ReadVector(vertex)));
      }
    }
  }

  RigidBody2D ReadRigidBody(const Value& value) {
    const Fields fields = ReadFields(value,
                                     {"name",
                                      "box",
                                      "polygon",
                                      "radius",
                                      "mass",
                                      "inertia",
                                      "position",
                                      "velocity",
                                      "angle",
                                      "angular_velocity",
                                      "joint"});
    RigidBody2D body{.name = ReadName(fields.Require("name", "a name"))};
    ReadShape(fields, &body);
    body.position = ToPoint(ReadVector(fields.Require("position", "the position [x, y] of the centre of mass in m")));
    if (const Value* angle = fields.Find("angle")) body.angle = ReadNumber(*angle);
    if (const Value* joint = fields.Find("joint")) body.joint = ReadJoint(*joint);
    const JointKind kind = body.joint.kind;
    const bool turns = kind == JointKind::kFree || kind == JointKind::kRevolute, moves = kind != JointKind::kWeld;
    const auto find = [&](const char* key, bool has) {
      const Value* found = fields.Find(key);
      if (found != nullptr && !has) Fail(*found, "expected no such key: the joint leaves it without effect");
      return found;
    };
    if (moves) fields.Require("mass", "the mass in kg");
    if (const Value* mass = find("mass", moves)) body.mass = ReadPositive(*mass, "a mass above zero in kg");
    if (const Value* inertia = find("inertia", turns)) {
      body.inertia = ReadPositive(*inertia, "a moment of inertia above zero in kg m^2");
    }
    if (const Value* velocity = find("velocity", moves && kind != JointKind::kRevolute)) {
      body.velocity = ToPoint(ReadVector(*velocity));
    }
    if (const Value* spin = find("angular_velocity", turns)) body.spin = ReadNumber(*spin);
    if (const std::string wrong = Validate(body); !wrong.empty()) Fail(value, wrong);
    return body;
  }

  // Names are those of flags such as --set, too.
  void ReadRigidBodies(const Value& value) {
    for (const Value& item : ReadList(value, "a list of bodies")) {
      RigidBody2D body = ReadRigidBody(item);
      if (body.name.empty() || body.name.find_first_of(",= ") != std::string::npos) {
        Fail(item, "expected a name without commas, spaces and =");
      }
      if (!body_of_name_.emplace(body.name, static_cast<int>(rigid_.bodies.size())).second) {
        Fail(item, "found the name " + body.name + " again, expected another");
      }
      scene_.bodies.emplace_back().name = body.name;
      rigid_.bodies.push_back(std::move(body));
    }
    if (const std::string wrong = Validate(rigid_); !wrong.empty()) Fail(value, wrong);
  }

  void ReadContact(const Value& value) {
    const Fields fields = ReadFields(value, {"restitution", "friction"});
    if (const Value* e = fields.Find("restitution")) rigid_.restitution = ReadAtLeast(0, *e, "a number from 0 to 1", 1);
    if (const Value* mu = fields.Find("friction")) rigid_.friction = ReadAtLeast(0, *mu, "a number of 0 or more");
  }

  // Reads forces and torques of bodies, in the order of the system.
  void ReadControl(const Value& value, int intervals, std::vector<double>* control, HybridFree* free) {
    const Fields fields = ReadFields(value, {"bodies", "initial", "max", "max_torque"});
    const std::vector<int> pushed = ReadBodyNames(fields.Require("bodies", "a list of names of bodies"));
    for (const int body : pushed) {
      RigidBody2D& added = rigid_.bodies[body];
      if (added.pushed || added.joint.kind == JointKind::kWeld) Fail(value, "expected bodies that can move, each once");
      added.pushed = true;
    }
    const auto rank = [&](int body) {
      return std::count_if(
          rigid_.bodies.begin(), rigid_.bodies.begin() + body, [](const RigidBody2D& one) { return one.pushed; });
    };
    constexpr char kExpected[] = "a list with one [x, y, torque] per controlled body, in N and N m";
    const std::vector<Value> rows = ReadList(fields.Require("initial", kExpected), kExpected);
    std::vector<double> all(3 * rows.size());
    if (rows.size() != pushed.size()) FailExpected(*fields.Find("initial"), kExpected);
    for (std::size_t i = 0; i < rows.size(); ++i) {
      const std::vector<Value> entries = ReadList(rows[i], kExpected);
      if (entries.size() != 3) FailExpected(rows[i], "[x, y, torque], in N and N m");
      for (int k = 0; k < 3; ++k) all[3 * rank(pushed[i]) + k] = ReadNumber(entries[k]);
    }
    for (int k = 0; k < intervals; ++k) control->insert(control->end(), all.begin(), all.end());
    const Value *max = fields.Find("max"), *max_torque = fields.Find("max_torque");
    if (max == nullptr && max_torque == nullptr) return;
    const double infinite = std::numeric_limits<double>::infinity();
    const double force = max == nullptr ? infinite : ReadPositive(*max, "a force above zero in N");
    const double torque = max_torque == nullptr ? infinite : ReadPositive(*max_torque, "a torque above zero in N m");
    for (std::size_t i = 0; i < all.size(); ++i) {
      free->control_max.push_back(i % 3 == 2 ? torque : force);
      free->control_min.push_back(-free->control_max.back());
    }
  }

  // The coordinates of a body out of some components; -1 for those that its joint leaves it without.
  std::vector<int> CoordinatesOf(int body, std::initializer_list<int> components) const {
    std::vector<int> coordinates;
    for (const int component : components) {
      const auto found = std::ranges::find(names_, rigid_.bodies[body].name + kComponents[component]);
      coordinates.push_back(found == names_.end() ? -1 : static_cast<int>(found - names_.begin()));
    }
    return coordinates;
  }

  void AddTerminalTerm(const Value& value, HybridProblem* problem) {
    const TerminalTerm term = ReadTerm(value);
    if (term.component) Fail(value, "found a component, expected a target: terms are squares");
    if (!term.hard && !(term.weight >= 0)) Fail(value, "found a negative weight, expected 0 or more");
    const int n = static_cast<int>(names_.size());
    const bool of_rate =
        term.quantity == TerminalTerm::Quantity::kVelocity || term.quantity == TerminalTerm::Quantity::kAngularVelocity;
    const std::vector<int> coordinates =
        term.IsRotational() ? CoordinatesOf(term.body, {2}) : CoordinatesOf(term.body, {0, 1});
    const TerminalTerm::Region goal = term.Goal();
    if ((goal.min.array() > goal.max.array()).any()) Fail(value, "found min above max, expected at most that");
    if (!goal.min.array().isFinite().any() && !goal.max.array().isFinite().any()) {
      Fail(value, "found no bound, expected at least one number in min or max");
    }
    for (std::size_t i = 0; i < coordinates.size(); ++i) {
      const int j = static_cast<int>(i), state = coordinates[i] + (of_rate ? n : 0);
      const bool has_min = std::isfinite(goal.min[j]), has_max = std::isfinite(goal.max[j]);
      if (coordinates[i] < 0 && (has_min || has_max)) {
        Fail(value, "the joint of " + rigid_.bodies[term.body].name + " leaves no such coordinate");
      }
      if (!term.hard || goal.min[j] == goal.max[j]) {
        problem->terms.push_back(MakeTerminalCost(state, goal.min[j], term.hard ? 1 : term.weight, 2 * n));
        if (term.hard) problem->terms.back().role = HybridTerm::Role::kEquality;
        continue;
      }
      if (has_min) problem->terms.push_back(MakeTerminalBound(state, goal.min[j], true, 2 * n));
      if (has_max) problem->terms.push_back(MakeTerminalBound(state, goal.max[j], false, 2 * n));
    }
  }

  void ReadObjective(const Value& value, HybridProblem* problem) {
    const Fields fields = ReadFields(value, {"terminal", "effort", "duration"});
    for (const Value& term : ReadList(fields.Require("terminal", "a list of terms"), "a list of terms")) {
      AddTerminalTerm(term, problem);
    }
    const int num_controls = problem->system.num_controls();
    if (const Value* effort = fields.Find("effort")) {
      if (num_controls == 0) Fail(*effort, "expected no such key: no body is controlled");
      const double weight = ReadAtLeast(0, *effort, "a number of 0 or more");
      if (weight > 0) problem->terms.push_back(MakeEffortCost(weight, num_controls));
    }
    if (const Value* duration = fields.Find("duration")) {
      const FreeDuration range = ReadFreeDuration(*duration);
      if (!(range.min > 0 && range.min < range.max)) Fail(*duration, "expected 0 < min < max");
      problem->free.duration = true;
      problem->free.duration_min = range.min;
      problem->free.duration_max = range.max;
      if (range.weight != 0) problem->terms.push_back(MakeDurationCost(range.weight));
    }
  }

  void ReadOptimize(const Fields& fields, HybridFree* free) {
    const Value& value = fields.Require("optimize", "what a solver changes, or none");
    const std::vector<Value> items = value.node.IsSequence() ? ReadList(value, "a list") : std::vector<Value>{value};
    const Value* names = fields.Find("free");
    std::vector<int> bodies(rigid_.bodies.size());
    std::iota(bodies.begin(), bodies.end(), 0);
    if (names != nullptr) bodies = ReadBodyNames(*names);
    for (const Value& item : items) {
      // After the first four the parameters of the system, in its order.
      const int choice = ReadChoice(
          item, {"none", "control", "position", "velocity", "restitution", "friction", "gravity.x", "gravity.y"});
      if (choice == 0 && items.size() > 1) FailExpected(item, "no none beside others");
      if (choice >= 4) free->parameters.push_back(choice - 4);
      if (choice == 1 && !std::ranges::any_of(rigid_.bodies, &RigidBody2D::pushed)) {
        Fail(item, "found control, but no body is controlled");
      }
      if (choice == 1) free->control = true;
      if (choice != 2 && choice != 3) continue;
      for (const int body : bodies) {
        for (const int coordinate : CoordinatesOf(body, {0, 1, 2})) {
          if (coordinate < 0) continue;
          free->initial.push_back(coordinate + (choice == 3 ? static_cast<int>(names_.size()) : 0));
        }
      }
    }
    if (names != nullptr && free->initial.empty())
      Fail(*names, "expected no such key: no position or velocity is free");
  }

  RigidScene2D rigid_;
  std::vector<std::string> names_;  // of coordinates
};

BodiesProblem BodiesReader::Read(const YAML::Node& root) {
  const Fields fields = ReadFields({root, "", 1},
                                   {"name",
                                    "duration",
                                    "steps",
                                    "gravity",
                                    "bodies",
                                    "planes",
                                    "contact",
                                    "control",
                                    "objective",
                                    "optimize",
                                    "free"});
  const std::string name = ReadName(fields.Require("name", "the name of the scene"));
  HybridInput guess{.duration =
                        ReadPositive(fields.Require("duration", "the duration in s"), "a duration above zero in s")};
  if (const Value* steps = fields.Find("steps")) {
    guess.num_intervals = ReadSteps(*steps);
    if (guess.num_intervals < 1 || guess.num_intervals > 100000) FailExpected(*steps, "1 to 100000 control intervals");
  }
  rigid_ = {.bodies = {}, .gravity = {0, 0}, .restitution = 1, .friction = 0};  // as in scene files
  if (const Value* gravity = fields.Find("gravity")) rigid_.gravity = ToPoint(ReadVector(*gravity));
  if (const Value* contact = fields.Find("contact")) ReadContact(*contact);
  ReadRigidBodies(fields.Require("bodies", "a list of bodies"));
  if (const Value* planes = fields.Find("planes")) {
    for (const Value& item : ReadList(*planes, "a list of planes")) {
      const Fields plane = ReadFields(item, {"point", "normal"});
      rigid_.planes.push_back({ToPoint(ReadVector(plane.Require("point", "a point [x, y] of the boundary in m"))),
                               ReadDirection(plane.Require("normal", "the normal [x, y]"))});
    }
  }
  HybridFree free;
  if (const Value* control = fields.Find("control")) ReadControl(*control, guess.num_intervals, &guess.control, &free);
  const RigidBodies2D bodies(rigid_);
  names_ = bodies.Layout().coordinate_names;
  guess.initial = bodies.InitialState();
  guess.parameters = bodies.Parameters();
  const MechanicalSystem system(bodies);
  std::vector<double> first(system.hybrid().num_controls());
  if (!guess.control.empty()) std::copy_n(guess.control.begin(), first.size(), first.begin());
  const MechanicalSystem::Start start = system.FindMode(guess.initial, first, guess.parameters);
  if (start.mode < 0) Fail(*fields.Find("bodies"), start.reason);
  guess.mode = start.mode;
  BodiesProblem task{
      name, {.system = system.hybrid(), .guess = std::move(guess), .free = std::move(free)}, system, bodies};
  ReadObjective(fields.Require("objective", "a map with the key terminal"), &task.problem);
  ReadOptimize(fields, &task.problem.free);
  return task;
}

}  // namespace

BodiesProblem ReadBodies(const YAML::Node& root) { return BodiesReader().Read(root); }

}  // namespace saltus
