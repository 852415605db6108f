#include "saltus/io/scene_file.h"

#include <glog/logging.h>
#include <yaml-cpp/eventhandler.h>
#include <yaml-cpp/yaml.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <charconv>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <initializer_list>
#include <sstream>
#include <unordered_map>
#include <utility>

#include "io/suggestion.h"

namespace saltus {
namespace {

// Names of things in messages are cut to this many bytes.
constexpr std::size_t kLongestExcerpt = 60;

// Thrown below, caught in ParseScene, as yaml-cpp's own exceptions are.
struct Failure {
  int line;
  std::string key;
  std::string message;
};

// `text` on one line, without control characters, cut at a character of UTF-8.
std::string Printable(std::string_view text) {
  std::size_t length = std::min(text.size(), kLongestExcerpt);
  while (length > 0 && length < text.size() && (text[length] & 0xC0) == 0x80) --length;
  std::string printable;
  for (const unsigned char c : text.substr(0, length)) {
    if (c < 0x20 || c == 0x7F) {
      constexpr char kDigits[] = "0123456789abcdef";
      printable += {'\\', 'x', kDigits[c >> 4], kDigits[c & 15]};
    } else {
      printable += static_cast<char>(c);
    }
  }
  return length < text.size() ? printable + "..." : printable;
}

std::string Join(const std::vector<std::string>& words) {
  std::string text;
  for (const std::string& word : words) text += (text.empty() ? "" : ", ") + word;
  return text;
}

// Length of the UTF-8 character at `text[i]`, or 0 if there is none, or one of the control characters that YAML
// forbids.
std::size_t CharacterLength(std::string_view text, std::size_t i) {
  const auto byte = [&](std::size_t k) { return k < text.size() ? static_cast<unsigned char>(text[k]) : 0U; };
  const unsigned lead = byte(i);
  if (lead < 0x80) return (lead >= 0x20 && lead != 0x7F) || lead == '\t' || lead == '\n' || lead == '\r';
  const std::size_t length = lead >= 0xF0 ? 4 : lead >= 0xE0 ? 3 : 2;
  if (lead < 0xC2 || lead > 0xF4) return 0;
  for (std::size_t k = 1; k < length; ++k) {
    if ((byte(i + k) & 0xC0) != 0x80) return 0;
  }
  // Overlong forms, surrogates, and beyond the last code point.
  const unsigned second = byte(i + 1);
  if ((lead == 0xE0 && second < 0xA0) || (lead == 0xED && second > 0x9F)) return 0;
  if ((lead == 0xF0 && second < 0x90) || (lead == 0xF4 && second > 0x8F)) return 0;
  return length;
}

void CheckText(std::string_view text) {
  if (text.size() > kMaxSceneBytes) {
    throw Failure{1, "", "found more than " + std::to_string(kMaxSceneBytes) + " bytes, expected a scene file"};
  }
  int line = 1;
  for (std::size_t i = 0; i < text.size();) {
    const std::size_t length = CharacterLength(text, i);
    if (length == 0) {
      throw Failure{line,
                    "",
                    "found byte " + std::to_string(static_cast<unsigned char>(text[i])) +
                        ", expected text in UTF-8 without control characters"};
    }
    line += text[i] == '\n';
    i += length;
  }
}

// Refuses, before any tree is built, what YAML allows and a scene file does not need.
class StructureCheck : public YAML::EventHandler {
 public:
  bool found_document() const { return found_document_; }

  void OnDocumentStart(const YAML::Mark& mark) override {
    Expect(!found_document_, mark, "found a second document, expected one");
    found_document_ = true;
  }
  void OnDocumentEnd() override {}
  void OnNull(const YAML::Mark& mark, YAML::anchor_t anchor) override { CheckNode(mark, "", anchor); }
  void OnAlias(const YAML::Mark& mark, YAML::anchor_t) override {
    Expect(false, mark, "found an alias, expected the value itself");
  }
  void OnScalar(const YAML::Mark& mark, const std::string& tag, YAML::anchor_t anchor, const std::string&) override {
    CheckNode(mark, tag, anchor);
  }
  void OnSequenceStart(const YAML::Mark& mark, const std::string& tag, YAML::anchor_t anchor,
                       YAML::EmitterStyle::value) override {
    CheckNode(mark, tag, anchor);
    Descend(mark);
  }
  void OnSequenceEnd() override { --depth_; }
  void OnMapStart(const YAML::Mark& mark, const std::string& tag, YAML::anchor_t anchor,
                  YAML::EmitterStyle::value) override {
    CheckNode(mark, tag, anchor);
    Descend(mark);
  }
  void OnMapEnd() override { --depth_; }

 private:
  static void Expect(bool holds, const YAML::Mark& mark, const std::string& message) {
    if (!holds) throw Failure{mark.line + 1, "", message};
  }
  static void CheckNode(const YAML::Mark& mark, const std::string& tag, YAML::anchor_t anchor) {
    Expect(anchor == YAML::NullAnchor, mark, "found an anchor (&), expected the value without one");
    Expect(tag.empty() || tag == "?" || tag == "!",
           mark,
           "found the tag " + Printable(tag) + ", expected the value without one");
  }
  void Descend(const YAML::Mark& mark) {
    Expect(++depth_ <= kMaxSceneDepth,
           mark,
           "found lists or maps nested deeper than " + std::to_string(kMaxSceneDepth) + ", expected a scene");
  }

  bool found_document_ = false;
  int depth_ = 0;
};

YAML::Node LoadYaml(std::string_view text) {
  CheckText(text);
  std::istringstream stream{std::string(text)};
  YAML::Parser parser(stream);
  StructureCheck check;
  while (parser.HandleNextDocument(check)) {
  }
  if (!check.found_document()) throw Failure{1, "", "found nothing, expected a scene"};
  return YAML::Load(std::string(text));
}

// A YAML value, and where it stands.
struct Value {
  YAML::Node node;
  std::string path;
  int line;
};

bool IsQuoted(const YAML::Node& node) { return node.Tag() == "!"; }

std::string Describe(const YAML::Node& node) {
  switch (node.Type()) {
    case YAML::NodeType::Map:
      return "a map";
    case YAML::NodeType::Sequence:
      return "a list of " + std::to_string(node.size());
    case YAML::NodeType::Scalar:
      return IsQuoted(node) ? "the text \"" + Printable(node.Scalar()) + '"' : Printable(node.Scalar());
    default:
      return "nothing";
  }
}

[[noreturn]] void Fail(const Value& value, const std::string& message) {
  throw Failure{value.line, value.path, message};
}

[[noreturn]] void FailExpected(const Value& value, const std::string& expected) {
  Fail(value, "found " + Describe(value.node) + ", expected " + expected);
}

template <typename T>
bool ParseAll(std::string_view text, T* value) {
  if (text.starts_with('+')) {
    text.remove_prefix(1);
    if (text.starts_with('-')) return false;
  }
  const auto [end, status] = std::from_chars(text.data(), text.data() + text.size(), *value);
  return status == std::errc() && end == text.data() + text.size();
}

template <typename T>
T ReadPlain(const Value& value, const char* expected) {
  T result = 0;
  if (!value.node.IsScalar() || IsQuoted(value.node) || !ParseAll(value.node.Scalar(), &result)) {
    FailExpected(value, expected);
  }
  return result;
}

double ReadNumber(const Value& value) { return ReadPlain<double>(value, "a finite number"); }

int ReadSteps(const Value& value) { return ReadPlain<int>(value, "a positive whole number"); }

bool ReadBool(const Value& value) {
  if (value.node.IsScalar() && !IsQuoted(value.node)) {
    if (value.node.Scalar() == "true") return true;
    if (value.node.Scalar() == "false") return false;
  }
  FailExpected(value, "true or false");
}

const std::string& ReadName(const Value& value) {
  if (!value.node.IsScalar()) FailExpected(value, "a name");
  return value.node.Scalar();
}

// Position in `choices` of the one that is given.
int ReadChoice(const Value& value, const std::vector<std::string>& choices) {
  const auto choice = std::find(choices.begin(), choices.end(), value.node.IsScalar() ? value.node.Scalar() : "");
  if (choice == choices.end()) {
    FailExpected(value,
                 "one of " + Join(choices) + (value.node.IsScalar() ? Suggestion(value.node.Scalar(), choices) : ""));
  }
  return static_cast<int>(choice - choices.begin());
}

// In the order of TerminalTerm::Quantity.
constexpr std::array kQuantities = {"position", "velocity", "angle", "angular_velocity"};

Inertia ReadInertia(const Value& value) {
  const std::string text = value.node.IsScalar() ? value.node.Scalar() : "";
  if (text == "none") return {};
  if (text == "solid") return {Inertia::Kind::kSolid};
  return {Inertia::Kind::kGiven, ReadPlain<double>(value, "none, solid or a number in kg m^2")};
}

// Builds a Scene out of a YAML tree, and remembers the line of every path that it passes.
class SceneReader {
 public:
  Scene Read(const YAML::Node& root);

  // Line of a path, or of the innermost part of it that stands in the text.
  int LineOf(std::string path) const;

 private:
  // A map all of whose keys are known.
  struct Fields {
    Value map;
    std::unordered_map<std::string, Value> values;

    const Value* Find(const std::string& key) const;
    const Value& Require(const std::string& key, const std::string& expected) const;
  };

  Fields ReadFields(const Value& map, const std::vector<std::string>& known);
  std::vector<Value> ReadList(const Value& list, const std::string& expected);
  Vec2d ReadVector(const Value& value);
  int ReadBodyName(const Value& value) const;
  std::vector<int> ReadBodyNames(const Value& value);

  Body ReadBody(const Value& value);
  Plane ReadPlane(const Value& value);
  EdgeSegment ReadSegment(const Value& value);
  EdgePolygon ReadPolygon(const Value& value);
  EdgeArc ReadArc(const Value& value);
  TableFriction ReadTable(const Value& value);
  ContactParameters ReadContact(const Value& value);
  std::vector<double> ReadBounds(const Value& value, size_t count);
  Control ReadControl(const Value& value);
  TerminalTerm::Quantity ReadQuantity(const Fields& fields);
  TerminalTerm ReadTerm(const Value& value);
  RunningTerm ReadRunning(const Value& value);
  ViaTerm ReadVia(const Value& value);
  FreeDuration ReadFreeDuration(const Value& value);
  NoContact ReadNoContact(const Value& value);
  Objective ReadObjective(const Value& value);
  void ReadBodies(const Value& value);

  Scene scene_;
  std::unordered_map<std::string, int> body_of_name_;
  std::unordered_map<std::string, int> line_of_path_;
};

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
  throw Failure{map.line, map.path.empty() ? key : map.path + '.' + key, "found no such key, expected " + expected};
}

SceneReader::Fields SceneReader::ReadFields(const Value& map, const std::vector<std::string>& known) {
  if (!map.node.IsMap()) FailExpected(map, "a map with keys out of " + Join(known));
  Fields fields{map, {}};
  for (const auto& entry : map.node) {
    const YAML::Node& key = entry.first;
    const int line = key.Mark().is_null() ? map.line : key.Mark().line + 1;
    if (!key.IsScalar()) throw Failure{line, map.path, "found " + Describe(key) + " as a key, expected a word"};
    const std::string path = (map.path.empty() ? "" : map.path + '.') + Printable(key.Scalar());
    if (std::find(known.begin(), known.end(), key.Scalar()) == known.end()) {
      throw Failure{
          line, path, "found an unknown key, expected one of " + Join(known) + Suggestion(key.Scalar(), known)};
    }
    if (!fields.values.emplace(key.Scalar(), Value{entry.second, path, line}).second) {
      throw Failure{line, path, "found the key again, expected it once"};
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

Vec2d SceneReader::ReadVector(const Value& value) {
  constexpr char kExpected[] = "a vector [x, y]";
  const std::vector<Value> entries = ReadList(value, kExpected);
  if (entries.size() != 2) FailExpected(value, kExpected);
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

Body SceneReader::ReadBody(const Value& value) {
  const Fields fields = ReadFields(
      value, {"name", "radius", "mass", "fixed", "position", "velocity", "inertia", "angle", "angular_velocity"});
  Body body;
  body.name = ReadName(fields.Require("name", "a name"));
  body.radius = ReadNumber(fields.Require("radius", "the radius in m"));
  if (const Value* fixed = fields.Find("fixed")) body.fixed = ReadBool(*fixed);
  if (!body.fixed) {
    body.mass = ReadNumber(fields.Require("mass", "the mass in kg"));
  } else if (const Value* mass = fields.Find("mass")) {
    Fail(*mass, "found a mass, expected none: the body is fixed");
  }
  body.position = ReadVector(fields.Require("position", "the position [x, y] in m"));
  if (const Value* velocity = fields.Find("velocity")) body.velocity = ReadVector(*velocity);
  if (const Value* inertia = fields.Find("inertia")) body.inertia = ReadInertia(*inertia);
  if (const Value* angle = fields.Find("angle")) body.angle = ReadNumber(*angle);
  if (const Value* spin = fields.Find("angular_velocity")) body.angular_velocity = ReadNumber(*spin);
  return body;
}

Plane SceneReader::ReadPlane(const Value& value) {
  const Fields fields = ReadFields(value, {"name", "point", "normal"});
  return {ReadName(fields.Require("name", "a name")),
          ReadVector(fields.Require("point", "a point [x, y] of the boundary in m")),
          ReadVector(fields.Require("normal", "the normal [x, y]"))};
}

EdgeSegment SceneReader::ReadSegment(const Value& value) {
  const Fields fields = ReadFields(value, {"name", "from", "to"});
  return {ReadName(fields.Require("name", "a name")),
          ReadVector(fields.Require("from", "the point [x, y] in m where it begins")),
          ReadVector(fields.Require("to", "the point [x, y] in m where it ends"))};
}

EdgePolygon SceneReader::ReadPolygon(const Value& value) {
  const Fields fields = ReadFields(value, {"name", "points", "solid"});
  EdgePolygon polygon;
  polygon.name = ReadName(fields.Require("name", "a name"));
  const Value& points = fields.Require("points", "the corners, a list of points [x, y] in m");
  for (const Value& point : ReadList(points, "a list of points [x, y]")) polygon.points.push_back(ReadVector(point));
  const Value& solid = fields.Require("solid", "inside or outside");
  const bool outside = ReadChoice(solid, {"inside", "outside"}) == 1;
  polygon.solid = outside ? EdgePolygon::Solid::kOutside : EdgePolygon::Solid::kInside;
  return polygon;
}

EdgeArc SceneReader::ReadArc(const Value& value) {
  const Fields fields = ReadFields(value, {"name", "center", "radius", "from", "to"});
  return {ReadName(fields.Require("name", "a name")),
          ReadVector(fields.Require("center", "the center [x, y] in m")),
          ReadNumber(fields.Require("radius", "the radius in m")),
          ReadNumber(fields.Require("from", "the angle in rad where it begins")),
          ReadNumber(fields.Require("to", "the angle in rad where it ends"))};
}

TableFriction SceneReader::ReadTable(const Value& value) {
  const Fields fields = ReadFields(value, {"friction", "gravity"});
  TableFriction table;
  table.friction = ReadNumber(fields.Require("friction", "the coefficient of friction"));
  if (const Value* gravity = fields.Find("gravity")) table.gravity = ReadNumber(*gravity);
  return table;
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

// One number for all, or a list with one for each.
std::vector<double> SceneReader::ReadBounds(const Value& value, size_t count) {
  if (!value.node.IsSequence()) return std::vector<double>(count, ReadNumber(value));
  std::vector<double> bounds;
  for (const Value& bound : ReadList(value, "a number, or a list of numbers")) bounds.push_back(ReadNumber(bound));
  return bounds;
}

Control SceneReader::ReadControl(const Value& value) {
  const Fields fields = ReadFields(value, {"bodies", "initial", "max", "max_norm"});
  Control control;
  control.bodies = ReadBodyNames(fields.Require("bodies", "a list of names of bodies"));
  const Value& initial = fields.Require("initial", "a list with one force [x, y] per controlled body, in N");
  for (const Value& force : ReadList(initial, "a list with one force [x, y] per controlled body")) {
    control.initial.push_back(ReadVector(force));
  }
  if (const Value* max = fields.Find("max")) control.max = ReadBounds(*max, control.bodies.size());
  if (const Value* norm = fields.Find("max_norm")) control.max_norm = ReadBounds(*norm, control.bodies.size());
  return control;
}

TerminalTerm::Quantity SceneReader::ReadQuantity(const Fields& fields) {
  const Value& quantity = fields.Require("quantity", "position, velocity, angle or angular_velocity");
  return static_cast<TerminalTerm::Quantity>(ReadChoice(quantity, {kQuantities.begin(), kQuantities.end()}));
}

TerminalTerm SceneReader::ReadTerm(const Value& value) {
  const Fields fields = ReadFields(value, {"body", "quantity", "target", "component", "weight", "hard"});
  TerminalTerm term;
  term.body = ReadBodyName(fields.Require("body", "the name of a body"));
  term.quantity = ReadQuantity(fields);
  if (const Value* component = fields.Find("component")) {
    term.component = ReadChoice(*component, {"x", "y"});
    if (const Value* target = fields.Find("target")) {
      Fail(*target, "found a target, expected none: with a component the term is linear");
    }
  } else if (term.IsOfSpin()) {
    term.target = {ReadNumber(fields.Require("target", "the target in rad or rad/s")), 0};
  } else {
    term.target = ReadVector(fields.Require("target", "the target [x, y], or component: x or y"));
  }
  if (const Value* hard = fields.Find("hard")) term.hard = ReadBool(*hard);
  if (const Value* weight = fields.Find("weight")) {
    if (term.hard) Fail(*weight, "found a weight, expected none: the term is hard, a constraint");
    term.weight = ReadNumber(*weight);
  }
  return term;
}

RunningTerm SceneReader::ReadRunning(const Value& value) {
  const Fields fields = ReadFields(value, {"body", "quantity", "target", "weight"});
  RunningTerm term;
  term.body = ReadBodyName(fields.Require("body", "the name of a body"));
  term.quantity = ReadQuantity(fields);
  constexpr char kRow[] = "a row [time, x, y]";
  for (const Value& row : ReadList(fields.Require("target", "rows [time, x, y]"), "a list of rows [time, x, y]")) {
    const std::vector<Value> entries = ReadList(row, kRow);
    if (entries.size() != 3) FailExpected(row, kRow);
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
  if (const Value* hard = fields.Find("hard")) term.hard = ReadBool(*hard);
  if (const Value* weight = fields.Find("weight")) {
    if (term.hard) Fail(*weight, "found a weight, expected none: the term is hard, a constraint");
    term.weight = ReadNumber(*weight);
  }
  return term;
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

// Two names, of discs or of a disc and a plane.
NoContact SceneReader::ReadNoContact(const Value& value) {
  constexpr char kExpected[] = "a pair [body, body or plane]";
  const std::vector<Value> names = ReadList(value, kExpected);
  if (names.size() != 2) FailExpected(value, kExpected);
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
  const Fields fields = ReadFields(value, {"terminal", "effort", "running", "via", "duration"});
  Objective objective;
  for (const Value& term : ReadList(fields.Require("terminal", "a list of terms"), "a list of terms")) {
    objective.terminal.push_back(ReadTerm(term));
  }
  if (const Value* effort = fields.Find("effort")) objective.effort = ReadNumber(*effort);
  if (const Value* running = fields.Find("running")) {
    for (const Value& term : ReadList(*running, "a list of terms")) objective.running.push_back(ReadRunning(term));
  }
  if (const Value* via = fields.Find("via")) {
    for (const Value& term : ReadList(*via, "a list of terms")) objective.via.push_back(ReadVia(term));
  }
  if (const Value* duration = fields.Find("duration")) objective.duration = ReadFreeDuration(*duration);
  return objective;
}

void SceneReader::ReadBodies(const Value& value) {
  for (const Value& body : ReadList(value, "a list of bodies")) {
    scene_.bodies.push_back(ReadBody(body));
    body_of_name_.emplace(scene_.bodies.back().name, scene_.num_bodies() - 1);
  }
}

Scene SceneReader::Read(const YAML::Node& root) {
  const Fields fields = ReadFields({root, "", 1},
                                   {"name",
                                    "duration",
                                    "steps",
                                    "gravity",
                                    "bodies",
                                    "planes",
                                    "segments",
                                    "polygons",
                                    "arcs",
                                    "table",
                                    "contact",
                                    "control",
                                    "objective",
                                    "no_contact",
                                    "optimize",
                                    "free",
                                    "free_spin"});
  scene_.name = ReadName(fields.Require("name", "the name of the scene"));
  scene_.duration = ReadNumber(fields.Require("duration", "the duration in s"));
  scene_.steps = ReadSteps(fields.Require("steps", "the number of steps"));
  if (const Value* gravity = fields.Find("gravity")) scene_.gravity = ReadVector(*gravity);
  ReadBodies(fields.Require("bodies", "a list of bodies"));
  if (const Value* planes = fields.Find("planes")) {
    for (const Value& plane : ReadList(*planes, "a list of planes")) scene_.planes.push_back(ReadPlane(plane));
  }
  if (const Value* segments = fields.Find("segments")) {
    for (const Value& one : ReadList(*segments, "a list of segments")) scene_.segments.push_back(ReadSegment(one));
  }
  if (const Value* polygons = fields.Find("polygons")) {
    for (const Value& one : ReadList(*polygons, "a list of polygons")) scene_.polygons.push_back(ReadPolygon(one));
  }
  if (const Value* arcs = fields.Find("arcs")) {
    for (const Value& one : ReadList(*arcs, "a list of arcs")) scene_.arcs.push_back(ReadArc(one));
  }
  if (const Value* table = fields.Find("table")) scene_.table = ReadTable(*table);
  if (const Value* contact = fields.Find("contact")) scene_.contact = ReadContact(*contact);
  if (const Value* control = fields.Find("control")) scene_.control = ReadControl(*control);
  scene_.objective = ReadObjective(fields.Require("objective", "a map with the key terminal"));
  if (const Value* pairs = fields.Find("no_contact")) {
    for (const Value& pair : ReadList(*pairs, "a list of pairs")) scene_.no_contact.push_back(ReadNoContact(pair));
  }
  const Value& optimize = fields.Require("optimize", "control, velocity, position or none");
  constexpr Optimize kChoices[] = {Optimize::kControl, Optimize::kVelocity, Optimize::kPosition, Optimize::kNone};
  scene_.optimize = kChoices[ReadChoice(optimize, {"control", "velocity", "position", "none"})];
  if (const Value* free = fields.Find("free")) {
    scene_.free = ReadBodyNames(*free);
  } else if (scene_.optimize == Optimize::kVelocity || scene_.optimize == Optimize::kPosition) {
    for (int i = 0; i < scene_.num_bodies(); ++i) {
      if (!scene_.bodies[i].fixed) scene_.free.push_back(i);
    }
  }
  if (const Value* spin = fields.Find("free_spin")) scene_.free_spin = ReadBodyNames(*spin);
  return scene_;
}

Scene ReadScene(std::string_view text) {
  SceneReader reader;
  Scene scene = reader.Read(LoadYaml(text));
  if (const auto error = Validate(scene)) throw Failure{reader.LineOf(error->key), error->key, error->message};
  return scene;
}

SceneFileError CannotRead(const std::string& path, const std::string& why) {
  return {path, 0, "", "cannot read: " + why + "; expected a scene file"};
}

// The shortest decimal that reads back as the same number.
std::string ToText(double value) {
  char text[32];
  return {text, std::to_chars(text, text + sizeof(text), value).ptr};
}

YAML::Emitter& operator<<(YAML::Emitter& out, const Vec2d& vector) {
  return out << YAML::Flow << YAML::BeginSeq << ToText(vector[0]) << ToText(vector[1]) << YAML::EndSeq;
}

template <typename T>
void WriteField(YAML::Emitter* out, const char* key, const T& value) {
  *out << YAML::Key << key << YAML::Value << value;
}

void WriteField(YAML::Emitter* out, const char* key, double value) { WriteField(out, key, ToText(value)); }

// The names of the bodies with these indices.
void WriteNames(YAML::Emitter* out, const char* key, const Scene& scene, const std::vector<int>& bodies) {
  *out << YAML::Key << key << YAML::Value << YAML::Flow << YAML::BeginSeq;
  for (const int body : bodies) *out << scene.bodies[body].name;
  *out << YAML::EndSeq;
}

void WriteSpin(YAML::Emitter* out, const Body& body) {
  if (body.inertia.kind == Inertia::Kind::kSolid) {
    WriteField(out, "inertia", "solid");
  } else {
    WriteField(out, "inertia", body.inertia.moment);
  }
  WriteField(out, "angle", body.angle);
  WriteField(out, "angular_velocity", body.angular_velocity);
}

void WriteBody(YAML::Emitter* out, const Body& body) {
  *out << YAML::Flow << YAML::BeginMap;
  WriteField(out, "name", body.name);
  WriteField(out, "radius", body.radius);
  if (body.fixed) {
    WriteField(out, "fixed", true);
  } else {
    WriteField(out, "mass", body.mass);
  }
  WriteField(out, "position", body.position);
  if (!body.fixed) WriteField(out, "velocity", body.velocity);
  if (body.Spins()) WriteSpin(out, body);
  *out << YAML::EndMap;
}

void WritePlane(YAML::Emitter* out, const Plane& plane) {
  *out << YAML::Flow << YAML::BeginMap;
  WriteField(out, "name", plane.name);
  WriteField(out, "point", plane.point);
  WriteField(out, "normal", plane.normal);
  *out << YAML::EndMap;
}

void WriteSegment(YAML::Emitter* out, const Scene&, const EdgeSegment& segment) {
  *out << YAML::Flow << YAML::BeginMap;
  WriteField(out, "name", segment.name);
  WriteField(out, "from", segment.from);
  WriteField(out, "to", segment.to);
  *out << YAML::EndMap;
}

void WritePolygon(YAML::Emitter* out, const Scene&, const EdgePolygon& polygon) {
  *out << YAML::Flow << YAML::BeginMap;
  WriteField(out, "name", polygon.name);
  *out << YAML::Key << "points" << YAML::Value << YAML::BeginSeq;
  for (const Vec2d& point : polygon.points) *out << point;
  *out << YAML::EndSeq;
  WriteField(out, "solid", polygon.solid == EdgePolygon::Solid::kOutside ? "outside" : "inside");
  *out << YAML::EndMap;
}

void WriteArc(YAML::Emitter* out, const Scene&, const EdgeArc& arc) {
  *out << YAML::Flow << YAML::BeginMap;
  WriteField(out, "name", arc.name);
  WriteField(out, "center", arc.center);
  WriteField(out, "radius", arc.radius);
  WriteField(out, "from", arc.from);
  WriteField(out, "to", arc.to);
  *out << YAML::EndMap;
}

void WriteTable(YAML::Emitter* out, const TableFriction& table) {
  *out << YAML::Key << "table" << YAML::Value << YAML::Flow << YAML::BeginMap;
  WriteField(out, "friction", table.friction);
  WriteField(out, "gravity", table.gravity);
  *out << YAML::EndMap;
}

void WriteContact(YAML::Emitter* out, const ContactParameters& contact) {
  *out << YAML::Key << "contact" << YAML::Value << YAML::Flow << YAML::BeginMap;
  WriteField(out, "restitution", contact.restitution);
  WriteField(out, "friction", contact.friction);
  WriteField(out, "stiffness", contact.stiffness);
  WriteField(out, "damping", contact.damping);
  *out << YAML::EndMap;
}

void WriteBounds(YAML::Emitter* out, const char* key, const std::vector<double>& bounds) {
  if (bounds.empty()) return;
  *out << YAML::Key << key << YAML::Value << YAML::Flow << YAML::BeginSeq;
  for (const double bound : bounds) *out << ToText(bound);
  *out << YAML::EndSeq;
}

void WriteControl(YAML::Emitter* out, const Scene& scene) {
  *out << YAML::Key << "control" << YAML::Value << YAML::BeginMap;
  WriteNames(out, "bodies", scene, scene.control.bodies);
  *out << YAML::Key << "initial" << YAML::Value << YAML::Flow << YAML::BeginSeq;
  for (const Vec2d& force : scene.control.initial) *out << force;
  *out << YAML::EndSeq;
  WriteBounds(out, "max", scene.control.max);
  WriteBounds(out, "max_norm", scene.control.max_norm);
  *out << YAML::EndMap;
}

void WriteQuantity(YAML::Emitter* out, TerminalTerm::Quantity quantity) {
  WriteField(out, "quantity", kQuantities[static_cast<size_t>(quantity)]);
}

// The weight of a term that may be a constraint instead.
void WriteWeight(YAML::Emitter* out, double weight, bool hard) {
  if (hard) {
    WriteField(out, "hard", true);
  } else {
    WriteField(out, "weight", weight);
  }
}

void WriteTerm(YAML::Emitter* out, const Scene& scene, const TerminalTerm& term) {
  *out << YAML::Flow << YAML::BeginMap;
  WriteField(out, "body", scene.bodies[term.body].name);
  WriteQuantity(out, term.quantity);
  if (term.component) {
    WriteField(out, "component", *term.component == 0 ? "x" : "y");
  } else if (term.IsOfSpin()) {
    WriteField(out, "target", term.target[0]);
  } else {
    WriteField(out, "target", term.target);
  }
  WriteWeight(out, term.weight, term.hard);
  *out << YAML::EndMap;
}

void WriteRunning(YAML::Emitter* out, const Scene& scene, const RunningTerm& term) {
  *out << YAML::Flow << YAML::BeginMap;
  WriteField(out, "body", scene.bodies[term.body].name);
  WriteQuantity(out, term.quantity);
  *out << YAML::Key << "target" << YAML::Value << YAML::BeginSeq;
  for (size_t i = 0; i < term.times.size(); ++i) {
    *out << YAML::BeginSeq << ToText(term.times[i]) << ToText(term.targets[i][0]) << ToText(term.targets[i][1])
         << YAML::EndSeq;
  }
  *out << YAML::EndSeq;
  WriteField(out, "weight", term.weight);
  *out << YAML::EndMap;
}

void WriteVia(YAML::Emitter* out, const Scene& scene, const ViaTerm& term) {
  *out << YAML::Flow << YAML::BeginMap;
  WriteField(out, "body", scene.bodies[term.body].name);
  WriteField(out, "time", term.time);
  WriteQuantity(out, term.quantity);
  WriteField(out, "target", term.target);
  WriteWeight(out, term.weight, term.hard);
  *out << YAML::EndMap;
}

void WriteFreeDuration(YAML::Emitter* out, const FreeDuration& duration) {
  *out << YAML::Key << "duration" << YAML::Value << YAML::Flow << YAML::BeginMap;
  WriteField(out, "free", true);
  WriteField(out, "min", duration.min);
  WriteField(out, "max", duration.max);
  WriteField(out, "weight", duration.weight);
  *out << YAML::EndMap;
}

// A list of terms, or of edges, under a key, if there are any.
template <typename Term>
void WriteTerms(YAML::Emitter* out, const char* key, const Scene& scene, const std::vector<Term>& terms,
                void (*write)(YAML::Emitter*, const Scene&, const Term&)) {
  if (terms.empty()) return;
  *out << YAML::Key << key << YAML::Value << YAML::BeginSeq;
  for (const Term& term : terms) write(out, scene, term);
  *out << YAML::EndSeq;
}

void WriteObjective(YAML::Emitter* out, const Scene& scene) {
  *out << YAML::Key << "objective" << YAML::Value << YAML::BeginMap << YAML::Key << "terminal" << YAML::Value
       << YAML::BeginSeq;
  for (const TerminalTerm& term : scene.objective.terminal) WriteTerm(out, scene, term);
  *out << YAML::EndSeq;
  WriteField(out, "effort", scene.objective.effort);
  WriteTerms(out, "running", scene, scene.objective.running, WriteRunning);
  WriteTerms(out, "via", scene, scene.objective.via, WriteVia);
  if (scene.objective.duration) WriteFreeDuration(out, *scene.objective.duration);
  *out << YAML::EndMap;
}

void WriteNoContact(YAML::Emitter* out, const Scene& scene, const NoContact& pair) {
  *out << YAML::Flow << YAML::BeginSeq << scene.bodies[pair.a].name
       << (pair.plane ? scene.planes[pair.b].name : scene.bodies[pair.b].name) << YAML::EndSeq;
}

}  // namespace

std::string SceneFileError::ToString() const {
  std::string text = file;
  if (line > 0) text += ':' + std::to_string(line);
  if (!key.empty()) text += ": " + key;
  return text + ": " + message;
}

std::variant<Scene, SceneFileError> ParseScene(std::string_view text, const std::string& name) {
  try {
    return ReadScene(text);
  } catch (const Failure& failure) {
    return SceneFileError{name, failure.line, failure.key, failure.message};
  } catch (const YAML::Exception& error) {
    return SceneFileError{name,
                          error.mark.is_null() ? 1 : error.mark.line + 1,
                          "",
                          "found text that is not YAML (" + error.msg + "), expected a scene"};
  }
}

std::variant<Scene, SceneFileError> LoadSceneFile(const std::string& path) {
  std::error_code status;
  if (std::filesystem::is_directory(path, status)) return CannotRead(path, "it is a directory");
  std::ifstream file(path, std::ios::binary);
  if (!file) return CannotRead(path, std::strerror(errno));
  std::string text(kMaxSceneBytes + 1, '\0');  // one more than allowed, to see that there is more
  file.read(text.data(), static_cast<std::streamsize>(text.size()));
  if (file.bad()) return CannotRead(path, std::strerror(errno));
  text.resize(static_cast<std::size_t>(file.gcount()));
  return ParseScene(text, path);
}

std::string WriteScene(const Scene& scene) {
  const auto error = Validate(scene);
  CHECK(!error) << error->key << ": " << error->message;
  YAML::Emitter out;
  out << YAML::BeginMap;
  WriteField(&out, "name", scene.name);
  WriteField(&out, "duration", scene.duration);
  WriteField(&out, "steps", scene.steps);
  WriteField(&out, "gravity", scene.gravity);
  out << YAML::Key << "bodies" << YAML::Value << YAML::BeginSeq;
  for (const Body& body : scene.bodies) WriteBody(&out, body);
  out << YAML::EndSeq << YAML::Key << "planes" << YAML::Value << YAML::BeginSeq;
  for (const Plane& plane : scene.planes) WritePlane(&out, plane);
  out << YAML::EndSeq;
  WriteTerms(&out, "segments", scene, scene.segments, WriteSegment);
  WriteTerms(&out, "polygons", scene, scene.polygons, WritePolygon);
  WriteTerms(&out, "arcs", scene, scene.arcs, WriteArc);
  if (scene.table) WriteTable(&out, *scene.table);
  WriteContact(&out, scene.contact);
  if (scene.num_controlled() > 0) WriteControl(&out, scene);
  WriteObjective(&out, scene);
  WriteTerms(&out, "no_contact", scene, scene.no_contact, WriteNoContact);
  WriteField(&out, "optimize", OptimizeToString(scene.optimize));
  if (!scene.free.empty()) WriteNames(&out, "free", scene, scene.free);
  if (!scene.free_spin.empty()) WriteNames(&out, "free_spin", scene, scene.free_spin);
  out << YAML::EndMap;
  return std::string(out.c_str()) + '\n';
}

}  // namespace saltus
