#include "scene/scene_reader.h"

#include <algorithm>
#include <utility>

#include "base/suggestion.h"
#include "base/table.h"
#include "saltus/scene/materials.h"
#include "saltus/scene/scene_parameter.h"
#include "scene/path_motion.h"
#include "scene/scene_rules.h"

namespace saltus::internal {
namespace {

Inertia ReadInertia(const Value& value) {
  const std::string text = value.node.IsScalar() ? value.node.Scalar() : "";
  if (text == "none") return {};
  if (text == "solid") return {Inertia::Kind::kSolid};
  return {Inertia::Kind::kGiven, ReadNumber(value, "none, solid or a number in kg m^2")};
}

}  // namespace

int SceneReader::LineOf(std::string path) const {
  while (!path.empty()) {
    if (const auto found = line_of_path_.find(path); found != line_of_path_.end()) return found->second;
    const std::size_t end = path.find_last_of(".[");
    path.resize(end == std::string::npos ? 0 : end);
  }
  return 1;
}

const Value* SceneReader::Fields::Find(const std::string& key) const {
  const auto found = values.find(key);
  return found == values.end() ? nullptr : &found->second;
}

const Value& SceneReader::Fields::Require(const std::string& key, const std::string& expected) const {
  if (const Value* value = Find(key)) return *value;
  throw SceneFileFailure{
      map.line, map.path.empty() ? key : map.path + '.' + key, "found no such key, expected " + expected};
}

SceneReader::Fields SceneReader::ReadFields(const Value& map, const std::vector<std::string>& known) {
  if (!map.node.IsMap()) FailExpected(map, "a map with keys out of " + Joined(known));
  Fields fields{map, {}};
  for (const auto& entry : map.node) {
    const YAML::Node& key = entry.first;
    const int line = key.Mark().is_null() ? map.line : key.Mark().line + 1;
    if (!key.IsScalar())
      throw SceneFileFailure{line, map.path, "found " + Describe(key) + " as a key, expected a word"};
    const std::string path = (map.path.empty() ? "" : map.path + '.') + Printable(key.Scalar());
    if (std::find(known.begin(), known.end(), key.Scalar()) == known.end()) {
      throw SceneFileFailure{
          line, path, "found an unknown key, expected one of " + Joined(known) + Suggestion(key.Scalar(), known)};
    }
    if (!fields.values.emplace(key.Scalar(), Value{entry.second, path, line}).second) {
      throw SceneFileFailure{line, path, "found the key again, expected it once"};
    }
    line_of_path_.emplace(path, line);
  }
  return fields;
}

std::vector<Value> SceneReader::ReadList(const Value& list, const std::string& expected) {
  if (!list.node.IsSequence()) FailExpected(list, expected);
  std::vector<Value> items;
  for (const auto& node : list.node) {
    const std::string path = list.path + '[' + std::to_string(items.size()) + ']';
    const int line = node.Mark().is_null() ? list.line : node.Mark().line + 1;
    line_of_path_.emplace(path, line);
    items.push_back({node, path, line});
  }
  return items;
}

template <typename Item>
void SceneReader::ReadEach(const Fields& fields, const std::string& key, const std::string& expected,
                           Item (SceneReader::*read)(const Value&), std::vector<Item>* items) {
  const Value* list = fields.Find(key);
  if (list == nullptr) return;
  for (const Value& value : ReadList(*list, expected)) items->push_back((this->*read)(value));
}

std::vector<Value> SceneReader::ReadTuple(const Value& list, std::size_t size, const std::string& expected) {
  std::vector<Value> items = ReadList(list, expected);
  if (items.size() != size) FailExpected(list, expected);
  return items;
}

Vec2d SceneReader::ReadVector(const Value& value) {
  const std::vector<Value> entries = ReadTuple(value, 2, "a vector [x, y]");
  return {ReadNumber(entries[0]), ReadNumber(entries[1])};
}

int SceneReader::ReadBodyName(const Value& value) const {
  const std::string& name = ReadName(value);
  if (const auto found = body_of_name_.find(name); found != body_of_name_.end()) return found->second;
  std::vector<std::string> names;
  for (const Body& body : scene_.bodies) names.push_back(body.name);
  FailExpected(value, "the name of a body" + Suggestion(name, names));
}

std::vector<int> SceneReader::ReadBodyNames(const Value& value) {
  const std::vector<Value> names = ReadList(value, "a list of names of bodies");
  if (names.empty()) FailExpected(value, "at least one name of a body");
  std::vector<int> bodies;
  for (const Value& name : names) bodies.push_back(ReadBodyName(name));
  return bodies;
}

PrescribedMotion SceneReader::ReadPath(const Value& value) {
  const Fields fields = ReadFields(value, {"times", "positions"});
  PrescribedMotion path;
  for (const Value& time : ReadList(fields.Require("times", "a list of times in s"), "a list of times")) {
    path.times.push_back(ReadNumber(time));
  }
  const Value& positions = fields.Require("positions", "a list of positions [x, y] in m");
  for (const Value& position : ReadList(positions, "a list of positions [x, y]")) {
    path.positions.push_back(ReadVector(position));
  }
  return path;
}

Body SceneReader::ReadBody(const Value& value) {
  const Fields fields = ReadFields(value,
                                   {"name",
                                    "radius",
                                    "mass",
                                    "fixed",
                                    "position",
                                    "velocity",
                                    "inertia",
                                    "angle",
                                    "angular_velocity",
                                    "material",
                                    "path"});
  Body body;
  body.name = ReadName(fields.Require("name", "a name"));
  body.radius = ReadNumber(fields.Require("radius", "the radius in m"));
  const Value* path = fields.Find("path");
  body.fixed = path != nullptr;
  if (const Value* fixed = fields.Find("fixed")) body.fixed = ReadBool(*fixed);
  if (path != nullptr && !body.fixed) Fail(*fields.Find("fixed"), "found false beside a path, expected no such key");
  if (!body.fixed) {
    body.mass = ReadNumber(fields.Require("mass", "the mass in kg"));
  } else if (const Value* mass = fields.Find("mass")) {
    Fail(*mass, "found a mass, expected none: the body is fixed");
  }
  if (path != nullptr) {
    for (const char* key : {"position", "velocity"}) {
      if (const Value* found = fields.Find(key)) Fail(*found, "found it beside a path, expected none: the path has it");
    }
    body.path = ReadPath(*path);
    if (IsPath(*body.path)) body.position = PathMotion(*body.path).SampleAt(0).position;
  } else {
    body.position = ReadVector(fields.Require("position", "the position [x, y] in m, or a path"));
  }
  if (const Value* velocity = fields.Find("velocity")) body.velocity = ReadVector(*velocity);
  if (const Value* inertia = fields.Find("inertia")) body.inertia = ReadInertia(*inertia);
  if (const Value* angle = fields.Find("angle")) body.angle = ReadNumber(*angle);
  if (const Value* spin = fields.Find("angular_velocity")) body.angular_velocity = ReadNumber(*spin);
  body.material = ReadMaterialOf(fields);
  return body;
}

Plane SceneReader::ReadPlane(const Value& value) {
  const Fields fields = ReadFields(value, {"name", "point", "normal", "material", "motion"});
  Plane plane{.name = ReadName(fields.Require("name", "a name"))};
  if (const Value* motion = fields.Find("motion")) {
    if (const Value* point = fields.Find("point")) Fail(*point, "found it beside a motion, expected none: it is there");
    plane.motion = ReadPath(*motion);
    if (IsPath(*plane.motion)) plane.point = PathMotion(*plane.motion).SampleAt(0).position;
  } else {
    plane.point = ReadVector(fields.Require("point", "a point [x, y] of the boundary in m, or its motion"));
  }
  plane.normal = ReadVector(fields.Require("normal", "the normal [x, y]"));
  plane.material = ReadMaterialOf(fields);
  return plane;
}

EdgeSegment SceneReader::ReadSegment(const Value& value) {
  const Fields fields = ReadFields(value, {"name", "from", "to", "material"});
  return {ReadName(fields.Require("name", "a name")),
          ReadVector(fields.Require("from", "the point [x, y] in m where it begins")),
          ReadVector(fields.Require("to", "the point [x, y] in m where it ends")),
          ReadMaterialOf(fields)};
}

EdgePolygon SceneReader::ReadPolygon(const Value& value) {
  const Fields fields = ReadFields(value, {"name", "points", "solid", "material"});
  EdgePolygon polygon;
  polygon.name = ReadName(fields.Require("name", "a name"));
  const Value& points = fields.Require("points", "the corners, a list of points [x, y] in m");
  for (const Value& point : ReadList(points, "a list of points [x, y]")) polygon.points.push_back(ReadVector(point));
  const Value& solid = fields.Require("solid", "inside or outside");
  const bool outside = ReadChoice(solid, {"inside", "outside"}) == 1;
  polygon.solid = outside ? EdgePolygon::Solid::kOutside : EdgePolygon::Solid::kInside;
  polygon.material = ReadMaterialOf(fields);
  return polygon;
}

EdgeArc SceneReader::ReadArc(const Value& value) {
  const Fields fields = ReadFields(value, {"name", "center", "radius", "from", "to", "material"});
  return {ReadName(fields.Require("name", "a name")),
          ReadVector(fields.Require("center", "the center [x, y] in m")),
          ReadNumber(fields.Require("radius", "the radius in m")),
          ReadNumber(fields.Require("from", "the angle in rad where it begins")),
          ReadNumber(fields.Require("to", "the angle in rad where it ends")),
          ReadMaterialOf(fields)};
}

Pocket SceneReader::ReadPocket(const Value& value) {
  const Fields fields = ReadFields(value, {"name", "position", "radius"});
  return {ReadName(fields.Require("name", "a name")),
          ReadVector(fields.Require("position", "the position [x, y] of the centre in m")),
          ReadNumber(fields.Require("radius", "the radius in m"))};
}

TableFriction SceneReader::ReadTable(const Value& value) {
  const Fields fields = ReadFields(value, {"friction", "gravity"});
  TableFriction table;
  table.friction = ReadNumber(fields.Require("friction", "the coefficient of friction"));
  if (const Value* gravity = fields.Find("gravity")) table.gravity = ReadNumber(*gravity);
  return table;
}

StateForce SceneReader::ReadForce(const Value& value) {
  const Fields kind = ReadFields(value, {"drag", "spring"});
  if (kind.values.size() != 1) FailExpected(value, "one key, drag or spring");
  if (const Value* drag = kind.Find("drag")) {
    const Fields fields = ReadFields(*drag, {"body", "linear"});
    return Drag{ReadBodyName(fields.Require("body", "the name of a body")),
                ReadNumber(fields.Require("linear", "the force at a speed of 1 m/s, in N s/m"))};
  }
  const Fields fields = ReadFields(*kind.Find("spring"), {"body", "to", "stiffness", "length", "damping"});
  Spring spring{.body = ReadBodyName(fields.Require("body", "the name of a body"))};
  const Value& to = fields.Require("to", "a point [x, y], or the name of another body");
  if (to.node.IsSequence()) {
    spring.point = ReadVector(to);
  } else {
    spring.to = ReadBodyName(to);
  }
  spring.stiffness = ReadNumber(fields.Require("stiffness", "the stiffness in N/m"));
  if (const Value* length = fields.Find("length")) spring.length = ReadNumber(*length);
  if (const Value* damping = fields.Find("damping")) spring.damping = ReadNumber(*damping);
  return spring;
}

ContactParameters SceneReader::ReadContact(const Value& value) {
  const Fields fields = ReadFields(value, {"restitution", "friction", "stiffness", "damping"});
  ContactParameters contact;
  if (const Value* restitution = fields.Find("restitution")) contact.restitution = ReadNumber(*restitution);
  if (const Value* friction = fields.Find("friction")) contact.friction = ReadNumber(*friction);
  if (const Value* stiffness = fields.Find("stiffness")) contact.stiffness = ReadNumber(*stiffness);
  if (const Value* damping = fields.Find("damping")) contact.damping = ReadNumber(*damping);
  return contact;
}

// Reads the materials, in the order of the file. A number that one does not have is that of contact.
void SceneReader::ReadMaterials(const Value& value) {
  if (!value.node.IsMap()) FailExpected(value, "a map of materials, such as {rubber: {restitution: 0.9}}");
  std::vector<std::string> names;
  for (const auto& entry : value.node) names.push_back(entry.first.IsScalar() ? entry.first.Scalar() : "");
  const Fields materials = ReadFields(value, names);
  for (const std::string& name : names) {
    const Fields fields = ReadFields(*materials.Find(name), {"restitution", "friction"});
    Material material{name, {scene_.contact.restitution, scene_.contact.friction}};
    if (const Value* restitution = fields.Find("restitution")) material.contact.restitution = ReadNumber(*restitution);
    if (const Value* friction = fields.Find("friction")) material.contact.friction = ReadNumber(*friction);
    scene_.materials.push_back(material);
  }
}

// Reads the name of a material; -1 if it is that of what has none.
int SceneReader::ReadMaterial(const Value& value) const {
  const std::string& name = ReadName(value);
  std::vector<std::string> names;
  for (const Material& material : scene_.materials) {
    if (material.name == name) return static_cast<int>(names.size());
    names.push_back(material.name);
  }
  if (name == kNoMaterial && !names.empty()) return -1;
  FailExpected(value,
               names.empty() ? "no such key: the scene has no materials"
                             : "one of the scene's materials, " + Joined(names) + Suggestion(name, names));
}

int SceneReader::ReadMaterialOf(const Fields& fields) const {
  const Value* material = fields.Find("material");
  return material == nullptr ? -1 : ReadMaterial(*material);
}

MaterialPair SceneReader::ReadPair(const Value& value) {
  const Fields fields = ReadFields(value, {"between", "restitution", "friction"});
  const std::vector<Value> names =
      ReadTuple(fields.Require("between", "two materials"), 2, "two materials, [rubber, steel]");
  MaterialPair pair{ReadMaterial(names[0]), ReadMaterial(names[1])};
  if (const Value* restitution = fields.Find("restitution")) pair.restitution = ReadNumber(*restitution);
  if (const Value* friction = fields.Find("friction")) pair.friction = ReadNumber(*friction);
  return pair;
}

// Reads one number for all, or a list with one for each.
std::vector<double> SceneReader::ReadBounds(const Value& value, size_t count) {
  if (!value.node.IsSequence()) return std::vector<double>(count, ReadNumber(value));
  std::vector<double> bounds;
  for (const Value& bound : ReadList(value, "a number, or a list of numbers")) bounds.push_back(ReadNumber(bound));
  return bounds;
}

Control SceneReader::ReadControl(const Value& value) {
  const Fields fields = ReadFields(value, {"bodies", "torque", "initial", "max", "max_norm", "max_torque"});
  Control control;
  control.bodies = ReadBodyNames(fields.Require("bodies", "a list of names of bodies"));
  if (const Value* torque = fields.Find("torque")) control.torque_bodies = ReadBodyNames(*torque);
  control.initial_torque.assign(control.torque_bodies.size(), 0.0);
  const Value& initial = fields.Require("initial", "a list with one force [x, y] per controlled body, in N");
  for (const Value& force : ReadList(initial, "a list with one force [x, y] per controlled body")) {
    const auto begin = control.torque_bodies.begin(), end = control.torque_bodies.end();
    const auto turned = control.initial.size() < control.bodies.size()
                            ? std::find(begin, end, control.bodies[control.initial.size()])
                            : end;
    if (turned == end) {
      control.initial.push_back(ReadVector(force));
      continue;
    }
    const std::vector<Value> entries =
        ReadTuple(force, 3, "[x, y, torque], in N and N m, as the body has a torque control");
    control.initial.emplace_back(ReadNumber(entries[0]), ReadNumber(entries[1]));
    control.initial_torque[turned - begin] = ReadNumber(entries[2]);
  }
  if (const Value* max = fields.Find("max")) control.max = ReadBounds(*max, control.bodies.size());
  if (const Value* norm = fields.Find("max_norm")) control.max_norm = ReadBounds(*norm, control.bodies.size());
  if (const Value* max = fields.Find("max_torque")) {
    if (control.torque_bodies.empty())
      Fail(*max, "found bounds of torques, expected none: there is no key control.torque");
    control.max_torque = ReadBounds(*max, control.torque_bodies.size());
  }
  return control;
}

TerminalTerm::Quantity SceneReader::ReadQuantity(const Fields& fields) {
  const Value& quantity = fields.Require("quantity", "position, velocity, angle or angular_velocity");
  return static_cast<TerminalTerm::Quantity>(ReadChoice(quantity, {kQuantities.begin(), kQuantities.end()}));
}

// Reads the weight of a term that may be a constraint instead.
template <typename Term>
void SceneReader::ReadWeight(const Fields& fields, Term* term) {
  if (const Value* hard = fields.Find("hard")) term->hard = ReadBool(*hard);
  if (const Value* weight = fields.Find("weight")) {
    if (term->hard) Fail(*weight, "found a weight, expected none: the term is hard, a constraint");
    term->weight = ReadNumber(*weight);
  }
}

// Reads the bounds of the components of a quantity: numbers, and null where there is none.
Vec2d SceneReader::ReadBoundsOf(const Fields& fields, const char* key, bool of_spin, double unbounded) {
  Vec2d bounds = Vec2d::Constant(unbounded);
  const Value* value = fields.Find(key);
  if (value == nullptr) return bounds;
  if (of_spin) {
    bounds[0] = ReadNumber(*value);
    return bounds;
  }
  const std::vector<Value> entries = ReadTuple(*value, 2, "[x, y], with null where there is no bound");
  for (int j = 0; j < 2; ++j) {
    if (!entries[j].node.IsNull()) bounds[j] = ReadNumber(entries[j], "a number, or null where there is no bound");
  }
  return bounds;
}

// Reads the goal region of a term: that of the keys min and max, or of a target in one component. Returns std::nullopt
// if the term has none of them.
std::optional<TerminalTerm::Region> SceneReader::ReadRegion(const Fields& fields, const TerminalTerm& term) {
  const Value *target = fields.Find("target"), *component = fields.Find("component");
  const Value *min = fields.Find("min"), *max = fields.Find("max"), *hard = fields.Find("hard");
  const bool has_bounds = min != nullptr || max != nullptr;
  if (!has_bounds && !(component != nullptr && term.hard)) return std::nullopt;
  if (hard != nullptr && !term.hard)
    Fail(*hard, "found false, expected true or no such key: min and max are constraints");
  if (target != nullptr && has_bounds) Fail(*target, "found a target beside min or max, expected one of them");
  if (const Value* weight = fields.Find("weight")) {
    Fail(*weight, "found a weight, expected none: min and max are constraints");
  }
  TerminalTerm::Region region;
  if (component == nullptr) {
    region.min = ReadBoundsOf(fields, "min", term.IsRotational(), region.min[0]);
    region.max = ReadBoundsOf(fields, "max", term.IsRotational(), region.max[0]);
    return region;
  }
  if (term.IsRotational()) Fail(*component, "found a component, expected none: the quantity is one number");
  const int j = ReadChoice(*component, {"x", "y"});
  if (!has_bounds) {
    region.min[j] = region.max[j] = ReadNumber(fields.Require("target", "the target of the component, or min or max"));
  }
  if (min != nullptr) region.min[j] = ReadNumber(*min);
  if (max != nullptr) region.max[j] = ReadNumber(*max);
  return region;
}

TerminalTerm SceneReader::ReadTerm(const Value& value) {
  const Fields fields = ReadFields(value, {"body", "quantity", "target", "component", "weight", "hard", "min", "max"});
  TerminalTerm term;
  term.body = ReadBodyName(fields.Require("body", "the name of a body"));
  term.quantity = ReadQuantity(fields);
  if (const Value* hard = fields.Find("hard")) term.hard = ReadBool(*hard);
  term.region = ReadRegion(fields, term);
  if (term.region) {
    term.hard = true;
    return term;
  }
  if (const Value* component = fields.Find("component")) {
    term.component = ReadChoice(*component, {"x", "y"});
    if (const Value* target = fields.Find("target")) {
      Fail(*target,
           "found a target, expected none: with a component the term is linear, or with hard: true a constraint");
    }
  } else if (term.IsRotational()) {
    term.target = {ReadNumber(fields.Require("target", "the target in rad or rad/s, or min or max")), 0};
  } else {
    term.target = ReadVector(fields.Require("target", "the target [x, y], component: x or y, or min or max"));
  }
  ReadWeight(fields, &term);
  return term;
}

RunningTerm SceneReader::ReadRunning(const Value& value) {
  const Fields fields = ReadFields(value, {"body", "quantity", "target", "weight"});
  RunningTerm term;
  term.body = ReadBodyName(fields.Require("body", "the name of a body"));
  term.quantity = ReadQuantity(fields);
  for (const Value& row : ReadList(fields.Require("target", "rows [time, x, y]"), "a list of rows [time, x, y]")) {
    const std::vector<Value> entries = ReadTuple(row, 3, "a row [time, x, y]");
    term.times.push_back(ReadNumber(entries[0]));
    term.targets.emplace_back(ReadNumber(entries[1]), ReadNumber(entries[2]));
  }
  if (const Value* weight = fields.Find("weight")) term.weight = ReadNumber(*weight);
  return term;
}

ViaTerm SceneReader::ReadVia(const Value& value) {
  const Fields fields = ReadFields(value, {"body", "time", "quantity", "target", "weight", "hard"});
  ViaTerm term;
  term.body = ReadBodyName(fields.Require("body", "the name of a body"));
  term.time = ReadNumber(fields.Require("time", "the time in s"));
  term.quantity = ReadQuantity(fields);
  term.target = ReadVector(fields.Require("target", "the target [x, y]"));
  ReadWeight(fields, &term);
  return term;
}

SpeedLimit SceneReader::ReadLimit(const Value& value) {
  const Fields fields = ReadFields(value, {"body", "speed", "at"});
  SpeedLimit limit;
  limit.body = ReadBodyName(fields.Require("body", "the name of a body"));
  const Fields speed = ReadFields(fields.Require("speed", "a map with the key max"), {"max"});
  limit.max = ReadNumber(speed.Require("max", "the greatest speed in m/s"));
  if (const Value* at = fields.Find("at"))
    limit.at = static_cast<SpeedLimit::Timing>(ReadChoice(*at, {"end", "always"}));
  return limit;
}

FreeDuration SceneReader::ReadFreeDuration(const Value& value) {
  const Fields fields = ReadFields(value, {"free", "min", "max", "weight"});
  if (const Value& free = fields.Require("free", "free: true"); !ReadBool(free)) {
    Fail(free, "found false, expected true, or no key duration: the scene's own is meant then");
  }
  FreeDuration duration;
  duration.min = ReadNumber(fields.Require("min", "the shortest duration in s"));
  duration.max = ReadNumber(fields.Require("max", "the longest duration in s"));
  if (const Value* weight = fields.Find("weight")) duration.weight = ReadNumber(*weight);
  return duration;
}

// Reads two names, of discs or of a disc and a plane.
NoContact SceneReader::ReadNoContact(const Value& value) {
  const std::vector<Value> names = ReadTuple(value, 2, "a pair [body, body or plane]");
  NoContact pair;
  pair.a = ReadBodyName(names[0]);
  const std::string& second = ReadName(names[1]);
  for (size_t i = 0; i < scene_.planes.size(); ++i) {
    if (scene_.planes[i].name == second) return {pair.a, static_cast<int>(i), true};
  }
  pair.b = ReadBodyName(names[1]);
  if (pair.b < pair.a) std::swap(pair.a, pair.b);
  return pair;
}

Objective SceneReader::ReadObjective(const Value& value) {
  const Fields fields = ReadFields(value, {"terminal", "effort", "running", "via", "limits", "duration"});
  Objective objective;
  for (const Value& term : ReadList(fields.Require("terminal", "a list of terms"), "a list of terms")) {
    objective.terminal.push_back(ReadTerm(term));
  }
  if (const Value* effort = fields.Find("effort")) objective.effort = ReadNumber(*effort);
  ReadEach(fields, "running", "a list of terms", &SceneReader::ReadRunning, &objective.running);
  ReadEach(fields, "via", "a list of terms", &SceneReader::ReadVia, &objective.via);
  ReadEach(fields, "limits", "a list of limits", &SceneReader::ReadLimit, &objective.limits);
  if (const Value* duration = fields.Find("duration")) objective.duration = ReadFreeDuration(*duration);
  return objective;
}

void SceneReader::ReadBodies(const Value& value) {
  for (const Value& body : ReadList(value, "a list of bodies")) {
    scene_.bodies.push_back(ReadBody(body));
    body_of_name_.emplace(scene_.bodies.back().name, scene_.num_bodies() - 1);
  }
}

// Replaces a free duration between equal bounds by the scene's duration, with its price if it has one.
void SceneReader::FixDuration() {
  std::optional<FreeDuration>& duration = scene_.objective.duration;
  if (!duration || duration->min != duration->max) return;
  scene_.duration = duration->min;
  if (duration->weight == 0) duration.reset();
}

void SceneReader::ReadOptimize(const Value& value) {
  constexpr Optimize kChoices[] = {Optimize::kControl, Optimize::kVelocity, Optimize::kPosition, Optimize::kNone};
  if (!value.node.IsSequence()) {
    scene_.optimize = kChoices[ReadChoice(value, {"control", "velocity", "position", "none"})];
    return;
  }
  const std::vector<Value> items = ReadList(value, "a list");
  if (items.empty()) FailExpected(value, "at least one of control, velocity, position and parameters");
  for (const Value& item : items) {
    const std::string word = item.node.IsScalar() ? item.node.Scalar() : "";
    const auto* choice = std::find_if(std::begin(kChoices), std::end(kChoices), [&](Optimize one) {
      return one != Optimize::kNone && word == OptimizeToString(one);
    });
    if (choice == std::end(kChoices)) {
      ReadUnknown(item);
    } else if (scene_.optimize != Optimize::kNone) {
      Fail(item,
           "found " + word + " beside " + OptimizeToString(scene_.optimize) +
               ", expected one of control, velocity and position");
    } else {
      scene_.optimize = *choice;
    }
  }
}

// Reads the name of a parameter, or a map with bounds.
void SceneReader::ReadUnknown(const Value& value) {
  const std::string expected = "control, velocity, position, or a parameter: " + ContactParametersOf(scene_) +
                               ", gravity.x, gravity.y, mass.BODY of a body that moves, radius.BODY, position.BODY of "
                               "a fixed body, offset.WALL or angle.WALL of a "
                               "plane "
                               "or a segment";
  DesignParameter design;
  Value name = value;
  if (value.node.IsMap()) {
    const Fields fields = ReadFields(value, {"parameter", "min", "max"});
    name = fields.Require("parameter", "the name of a parameter");
    if (const Value* min = fields.Find("min")) design.min = ReadNumber(*min);
    if (const Value* max = fields.Find("max")) design.max = ReadNumber(*max);
  }
  if (!name.node.IsScalar()) FailExpected(name, expected);
  const std::vector<SceneParameter> found = ParametersNamed(name.node.Scalar(), scene_);
  const bool of_scene = !found.empty() && found.front().kind != SceneParameter::Kind::kForce;
  if (!of_scene) FailExpected(name, expected);
  for (const SceneParameter& parameter : found) {
    design.parameter = parameter;
    scene_.design.push_back(design);
  }
}

Scene SceneReader::Read(const YAML::Node& root) {
  const Fields fields = ReadFields(
      {root, "", 1}, {"name",    "duration",  "steps",      "gravity",  "bodies",  "planes",    "segments", "polygons",
                      "arcs",    "pockets",   "table",      "forces",   "contact", "materials", "pairs",    "combine",
                      "control", "objective", "no_contact", "optimize", "free",    "free_spin"});
  scene_.name = ReadName(fields.Require("name", "the name of the scene"));
  scene_.duration = ReadNumber(fields.Require("duration", "the duration in s"));
  scene_.steps = ReadSteps(fields.Require("steps", "the number of steps"));
  if (const Value* gravity = fields.Find("gravity")) scene_.gravity = ReadVector(*gravity);
  if (const Value* contact = fields.Find("contact")) scene_.contact = ReadContact(*contact);
  if (const Value* materials = fields.Find("materials")) ReadMaterials(*materials);
  ReadEach(fields, "pairs", "a list of pairs of materials", &SceneReader::ReadPair, &scene_.pairs);
  if (const Value* combine = fields.Find("combine")) {
    if (scene_.materials.empty()) Fail(*combine, "found a rule, expected no such key: the scene has no materials");
    scene_.combine = static_cast<Combine>(ReadChoice(*combine, {kCombines.begin(), kCombines.end()}));
  }
  ReadBodies(fields.Require("bodies", "a list of bodies"));
  ReadEach(fields, "planes", "a list of planes", &SceneReader::ReadPlane, &scene_.planes);
  ReadEach(fields, "segments", "a list of segments", &SceneReader::ReadSegment, &scene_.segments);
  ReadEach(fields, "polygons", "a list of polygons", &SceneReader::ReadPolygon, &scene_.polygons);
  ReadEach(fields, "arcs", "a list of arcs", &SceneReader::ReadArc, &scene_.arcs);
  ReadEach(fields, "pockets", "a list of pockets", &SceneReader::ReadPocket, &scene_.pockets);
  if (const Value* table = fields.Find("table")) scene_.table = ReadTable(*table);
  ReadEach(fields, "forces", "a list of forces", &SceneReader::ReadForce, &scene_.forces);
  if (const Value* control = fields.Find("control")) scene_.control = ReadControl(*control);
  scene_.objective = ReadObjective(fields.Require("objective", "a map with the key terminal"));
  ReadEach(fields, "no_contact", "a list of pairs", &SceneReader::ReadNoContact, &scene_.no_contact);
  ReadOptimize(fields.Require("optimize", "control, velocity, position or none"));
  const bool starts = scene_.optimize == Optimize::kVelocity || scene_.optimize == Optimize::kPosition;
  if (const Value* free = fields.Find("free")) {
    const bool lacks_control = scene_.optimize == Optimize::kControl && scene_.num_controlled() == 0;
    if (!starts && !lacks_control)
      Fail(*free, "found bodies, expected none: they are for optimize: velocity or position");
    scene_.free = ReadBodyNames(*free);
  } else if (starts) {
    for (int i = 0; i < scene_.num_bodies(); ++i) {
      if (!scene_.bodies[i].fixed) scene_.free.push_back(i);
    }
  }
  if (const Value* spin = fields.Find("free_spin")) scene_.free_spin = ReadBodyNames(*spin);
  FixDuration();
  // If a control is to be optimized and there is none, that is the error, not its price.
  if (scene_.objective.effort != 0 && scene_.num_controlled() == 0 && scene_.optimize != Optimize::kControl) {
    throw SceneFileFailure{
        LineOf("objective.effort"), "objective.effort", "expected 0 or no such key: no body is controlled"};
  }
  return scene_;
}

}  // namespace saltus::internal
