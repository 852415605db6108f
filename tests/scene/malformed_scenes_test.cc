// Scenes that are wrong by construction: each must be refused with an error that names the key, or at least the line.
//
// Most are made from one good scene, held as JSON (of which YAML is a superset), by putting one wrong thing in one
// place; that place is then the key and the line that the error must name.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <fstream>
#include <nlohmann/json.hpp>
#include <optional>
#include <random>
#include <set>
#include <sstream>
#include <string>
#include <variant>
#include <vector>

#include "folders.h"
#include "saltus/scene/scene_file.h"

namespace saltus {
namespace {

using Json = nlohmann::ordered_json;
using Pointer = Json::json_pointer;

const Json& GoodScene() {
  static const Json scene = Json::parse(R"({
    "name": "good",
    "duration": 1.0,
    "steps": 100,
    "gravity": [0, -9.8],
    "bodies": [
      {"name": "striker", "radius": 0.2, "mass": 1.0, "fixed": false, "position": [-2, 2], "velocity": [1, 0]},
      {"name": "target", "radius": 0.1, "mass": 2.0, "position": [-1, 1]},
      {"name": "post", "radius": 0.25, "fixed": true, "position": [3, 0]}
    ],
    "planes": [{"name": "ground", "point": [0, -1], "normal": [0, 2]}],
    "contact": {"restitution": 0.5, "friction": 0.25, "stiffness": 1e5, "damping": 3},
    "control": {"bodies": ["target", "striker"], "initial": [[3, 4], [5, 6]]},
    "objective": {
      "terminal": [
        {"body": "target", "quantity": "position", "target": [0, 1], "weight": 2.0},
        {"body": "striker", "quantity": "velocity", "component": "y", "weight": -3.0}
      ],
      "effort": 0.1
    },
    "optimize": "position",
    "free": ["target"]
  })");
  return scene;
}

struct Malformed {
  std::string text;
  std::optional<std::string> key;  // that the error must name
  int line = 0;                    // that the error must name, unless 0
};

// Stands for raw text that JSON could not hold.
constexpr char kPlaceholder[] = "@raw@";

// `scene`, whose one string kPlaceholder becomes the raw text `raw`.
Malformed WithRaw(const Json& scene, const std::string& raw, const std::string& key) {
  std::string text = scene.dump(2);
  const std::string quoted = '"' + std::string(kPlaceholder) + '"';
  const std::size_t at = text.find(quoted);
  EXPECT_NE(at, std::string::npos);
  const int line = 1 + static_cast<int>(std::count(text.begin(), text.begin() + static_cast<long>(at), '\n'));
  return {text.replace(at, quoted.size(), raw), key, line};
}

Malformed Replaced(const std::string& pointer, const std::string& raw, const std::string& key) {
  Json scene = GoodScene();
  scene.at(Pointer(pointer)) = kPlaceholder;
  return WithRaw(scene, raw, key);
}

struct Place {
  Pointer pointer;
  std::string path;  // as errors write it
};

void CollectPlaces(const Json& node, const Place& place, std::vector<Place>* places) {
  places->push_back(place);
  if (node.is_object()) {
    for (const auto& [key, value] : node.items()) {
      CollectPlaces(value, {place.pointer / key, place.path.empty() ? key : place.path + '.' + key}, places);
    }
  } else if (node.is_array()) {
    for (std::size_t i = 0; i < node.size(); ++i) {
      CollectPlaces(node[i], {place.pointer / i, place.path + '[' + std::to_string(i) + ']'}, places);
    }
  }
}

// Every value of the good scene, the whole first.
std::vector<Place> Places() {
  std::vector<Place> places;
  CollectPlaces(GoodScene(), {Pointer(), ""}, &places);
  return places;
}

bool IsVector(const Json& node) { return node.is_array() && node.size() == 2 && node[0].is_number(); }

std::vector<std::string> WrongValues(const Json& node) {
  if (node.is_number()) {
    return {"abc",  "\"1\"", "null", "[1]", "{a: 1}", "true", ".nan", ".NaN", "-.inf", "inf", "nan", "1e999",
            "1e25", "-1e25", "0x10", "1 2", "1_0",    "--1",  "1.0m", "+-1",  "1e",    "'1'", "~"};
  }
  if (node.is_boolean()) return {"yes", "1", "\"true\"", "null", "[true]", "TRUE!"};
  if (node.is_string()) return {"[a]", "{a: 1}", "null", "[]"};
  if (IsVector(node)) return {"5", "null", "{x: 1, y: 2}", "text", "[1]", "[]", "[1, 2, 3]", "[[1, 2]]"};
  if (node.is_array()) return {"5", "null", "{a: 1}", "text", "\"[]\""};
  return {"5", "null", "[]", "text", "[[]]"};
}

std::vector<Malformed> WrongTypes() {
  std::vector<Malformed> cases;
  for (const Place& place : Places()) {
    if (place.path.empty()) continue;
    for (const std::string& raw : WrongValues(GoodScene().at(place.pointer))) {
      cases.push_back(Replaced(place.pointer.to_string(), raw, place.path));
    }
  }
  return cases;
}

// A key too many, misspelt, twice or missing, in every map.
std::vector<Malformed> WrongKeys() {
  const std::set<std::string> optional = {"gravity",
                                          "velocity",
                                          "fixed",
                                          "planes",
                                          "contact",
                                          "restitution",
                                          "friction",
                                          "damping",
                                          "weight",
                                          "effort",
                                          "free",
                                          "control",
                                          "stiffness",
                                          "component"};
  std::vector<Malformed> cases;
  for (const Place& place : Places()) {
    const Json& node = GoodScene().at(place.pointer);
    if (!node.is_object()) continue;
    const std::string prefix = place.path.empty() ? "" : place.path + '.';
    Json more = GoodScene();
    more.at(place.pointer)["version"] = 1;
    cases.push_back({more.dump(2), prefix + "version"});
    for (const auto& [key, value] : node.items()) {
      Json misspelt = GoodScene();
      misspelt.at(place.pointer).erase(key);
      if (!optional.contains(key)) cases.push_back({misspelt.dump(2), prefix + key});
      misspelt.at(place.pointer)[key + "s_"] = value;
      cases.push_back({misspelt.dump(2), prefix + key + "s_"});
      Json twice = GoodScene();
      twice.at(place.pointer)[kPlaceholder] = value;
      cases.push_back(WithRaw(twice, '"' + key + '"', prefix + key));
    }
  }
  return cases;
}

std::vector<Malformed> OutOfRange() {
  std::vector<Malformed> cases;
  const auto add = [&](const std::string& pointer, const std::string& key, const std::vector<std::string>& raws) {
    for (const std::string& raw : raws) cases.push_back(Replaced(pointer, raw, key));
  };
  const std::vector<std::string> not_positive = {"0", "-0.0", "-1", "-1e-3", "1e-25", "1e-320"};
  add("/duration", "duration", not_positive);
  for (const char* body : {"0", "1", "2"}) {
    add(std::string("/bodies/") + body + "/radius", std::string("bodies[") + body + "].radius", not_positive);
  }
  add("/bodies/0/mass", "bodies[0].mass", not_positive);
  add("/bodies/1/mass", "bodies[1].mass", not_positive);
  add("/steps", "steps", {"0", "-1", "0.5", "100.0", "1e3", "10000001", "2147483648", "-2147483649", "1000000000000"});
  add("/contact/restitution", "contact.restitution", {"-0.1", "1.1", "-1e-9", "1.000001"});
  for (const char* name : {"friction", "stiffness", "damping"}) {
    add(std::string("/contact/") + name, std::string("contact.") + name, {"-1", "-1e-9"});
  }
  add("/objective/effort", "objective.effort", {"-1", "-1e-9"});
  add("/objective/terminal/0/weight", "objective.terminal[0].weight", {"-1", "-1e-9"});
  add("/planes/0/normal", "planes[0].normal", {"[0, 0]", "[-0.0, 0]", "[1e-25, 0]", "[1e-320, 1e-25]"});
  add("/name", "name", {"\"\"", "Good", "two words", "a/b", "..", "\"a\\nb\"", std::string(101, 'a')});
  add("/planes/0/name", "planes[0].name", {"\"\"", "two words", "a/b", "striker", "post", "\"\\x1b[2J\""});
  add("/bodies/2/name", "bodies[2].name", {"\"\"", "two words", "a/b", "striker", "target"});
  return cases;
}

std::vector<Malformed> WrongReferences() {
  std::vector<Malformed> cases;
  const auto add = [&](const std::string& pointer, const std::string& key, const std::vector<std::string>& raws) {
    for (const std::string& raw : raws) cases.push_back(Replaced(pointer, raw, key));
  };
  add("/control/bodies/0", "control.bodies[0]", {"targt", "ground", "post", "0", "\"\""});
  add("/control/bodies/1", "control.bodies[1]", {"Striker", "post", "target"});
  add("/control/bodies", "control.bodies", {"[]"});
  cases.push_back({Replaced("/control/bodies", "[target]", "").text, "control.initial"});
  add("/control/initial", "control.initial", {"[]", "[[1, 2]]", "[[1, 2], [3, 4], [5, 6]]"});
  add("/free/0", "free[0]", {"nobody", "post", "ground", "1"});
  add("/free", "free", {"[]"});
  add("/free", "free[1]", {"[target, target]", "[striker, post]"});
  add("/objective/terminal/0/body", "objective.terminal[0].body", {"nobody", "ground", "1"});
  add("/objective/terminal/0/quantity", "objective.terminal[0].quantity", {"speed", "Position", "0"});
  add("/objective/terminal/1/component", "objective.terminal[1].component", {"z", "0", "X", "xy"});
  add("/objective/terminal", "objective.terminal", {"[]"});
  add("/optimize", "optimize", {"controls", "Control", "0", "false"});
  add("/bodies/0/name", "bodies[0].name", {R"("two\nlines")", R"("a\u0007bell")"});
  Json uncontrolled = GoodScene();
  uncontrolled.erase("control");
  uncontrolled["optimize"] = kPlaceholder;
  cases.push_back(WithRaw(uncontrolled, "control", "optimize"));
  Json both = GoodScene();
  both["objective"]["terminal"][1]["target"] = kPlaceholder;
  cases.push_back(WithRaw(both, "[0, 0]", "objective.terminal[1].target"));
  Json heavy = GoodScene();
  heavy["bodies"][2]["mass"] = kPlaceholder;
  cases.push_back(WithRaw(heavy, "1", "bodies[2].mass"));
  Json moving = GoodScene();
  moving["bodies"][2]["velocity"] = kPlaceholder;
  cases.push_back(WithRaw(moving, "[1, 0]", "bodies[2].velocity"));
  return cases;
}

std::string ToText(double x, double y) {
  std::ostringstream text;
  text.precision(17);
  text << '[' << x << ", " << y << ']';
  return text.str();
}

// The second body at random places within reach of the first, of the post, and of the plane y = -1.
std::vector<Malformed> Overlaps() {
  std::mt19937 random(11);
  std::uniform_real_distribution<double> angle(-3, 3), depth(0, 1), far(10, 20);
  std::vector<Malformed> cases;
  for (int i = 0; i < 20; ++i) {
    const double distance = depth(random) * 0.2999, direction = angle(random);
    cases.push_back(Replaced("/bodies/1/position",
                             ToText(-2 + distance * std::cos(direction), 2 + distance * std::sin(direction)),
                             "bodies[1].position"));
    const double gap = depth(random) * 0.3499;
    Json scene = GoodScene();
    scene["bodies"][2]["position"] = kPlaceholder;  // the post onto the second body
    cases.push_back(
        WithRaw(scene, ToText(-1 + gap * std::cos(direction), 1 + gap * std::sin(direction)), "bodies[2].position"));
    cases.push_back(
        Replaced("/bodies/1/position", ToText(far(random), -0.9001 - 5 * depth(random)), "bodies[1].position"));
  }
  return cases;
}

std::string ReadProblem(const std::string& name) {
  std::ifstream file(SourceFolder() + "/problems/" + name + ".yaml");
  std::stringstream text;
  text << file.rdbuf();
  return text.str();
}

std::vector<std::string> Problems() {
  std::vector<std::string> texts;
  for (const char* name : {"bounce_once", "ground_wall", "two_balls", "single_collision", "multiple_collisions"}) {
    texts.push_back(ReadProblem(name));
  }
  return texts;
}

// The problems cut off before the value of their last key, which is required; and a map that is never closed.
std::vector<Malformed> Truncations() {
  std::vector<Malformed> cases;
  for (const std::string& text : Problems()) {
    const std::string last = "optimize:";
    const std::size_t end = text.rfind(last) + last.size();
    for (std::size_t length = 0; length <= end; length += 3) cases.push_back({text.substr(0, length), {}});
    cases.push_back({text.substr(0, end), {}});
  }
  const std::string closed = GoodScene().dump(1);
  for (std::size_t length = 1; length < closed.size(); length += 7) cases.push_back({closed.substr(0, length), {}});
  return cases;
}

// Bytes that no UTF-8 text without control characters holds, anywhere.
std::vector<Malformed> BadBytes() {
  const std::string bad[] = {"\xff",
                             "\xfe",
                             "\x80",
                             "\xc0\xaf",
                             "\xed\xa0\x80",
                             "\xf5\x80\x80\x80",
                             "\xe2\x28\xa1",
                             "\xf0\x80\x80\x80",
                             {'\0', 1},
                             "\x1b",
                             "\x7f",
                             "\xc3"};
  std::mt19937 random(13);
  std::vector<Malformed> cases;
  for (const std::string& text : Problems()) {
    for (const std::string& bytes : bad) {
      std::string wrong = text;
      const std::size_t at = std::uniform_int_distribution<std::size_t>(0, text.size())(random);
      const int line = 1 + static_cast<int>(std::count(text.begin(), text.begin() + static_cast<long>(at), '\n'));
      cases.push_back({wrong.insert(at, bytes), "", line});
    }
  }
  return cases;
}

// YAML beyond what a scene file may use, and text that is not YAML, before a good scene or after it.
std::vector<Malformed> WrongYaml() {
  std::vector<Malformed> cases;
  for (const std::string& text : Problems()) {
    for (const char* before : {"name: again\n",
                               "<<: {gravity: [0, 0]}\n",
                               "&a gravity: [0, 0]\n",
                               "? [x]\n: 1\n",
                               "*a : 1\n",
                               "- a\n",
                               "!!map\n",
                               "%YAML 7.0\n---\n",
                               "{}\n---\n",
                               "\tgravity: [0, 0]\n",
                               "gravity: [0, 0\n",
                               "gravity: \"[0, 0]\n",
                               "gravity: !vec [0, 0]\n",
                               "@a: 1\n",
                               "]\n"}) {
      cases.push_back({before + text, {}});
    }
    for (const char* after : {"---\n",
                              "---\n{}\n",
                              "...\n---\na: 1\n",
                              "]\n",
                              "}\n",
                              "free: *a\n",
                              "  free: [a]\n",
                              "free: &a [a]\n",
                              "text\n",
                              "free: [",
                              "free: {",
                              "free: \"",
                              "optimize: none\n",
                              ": \n"}) {
      cases.push_back({text + after, {}});
    }
  }
  return cases;
}

std::vector<Malformed> AllCases() {
  std::vector<Malformed> all;
  for (const auto& make :
       {WrongTypes, WrongKeys, OutOfRange, WrongReferences, Overlaps, Truncations, BadBytes, WrongYaml}) {
    const std::vector<Malformed> cases = make();
    all.insert(all.end(), cases.begin(), cases.end());
  }
  return all;
}

TEST(MalformedScenes, StartFromGoodOnes) {
  EXPECT_TRUE(std::holds_alternative<Scene>(ParseScene(GoodScene().dump(2), "good")));
  for (const std::string& text : Problems()) EXPECT_TRUE(std::holds_alternative<Scene>(ParseScene(text, "good")));
}

TEST(MalformedScenes, AreRefusedNamingThePlace) {
  std::set<std::string> texts;
  for (const Malformed& malformed : AllCases()) {
    SCOPED_TRACE(malformed.text);
    texts.insert(malformed.text);
    const auto result = ParseScene(malformed.text, "bad.yaml");
    ASSERT_TRUE(std::holds_alternative<SceneFileError>(result));
    const SceneFileError& error = std::get<SceneFileError>(result);
    EXPECT_EQ(error.file, "bad.yaml");
    EXPECT_GT(error.line, 0);
    EXPECT_LE(error.line, 1 + std::count(malformed.text.begin(), malformed.text.end(), '\n'));
    EXPECT_THAT(error.message, testing::HasSubstr("expected"));
    // A list is a value of `optimize`, so what is wrong is an entry of it.
    const std::string key = malformed.key.value_or(error.key);
    EXPECT_EQ(key == "optimize" && error.key == "optimize[0]" ? key : error.key, key) << error.ToString();
    EXPECT_EQ(error.line, malformed.line > 0 ? malformed.line : error.line) << error.ToString();
  }
  EXPECT_GE(texts.size(), 2000u);
}

// A random edit may still be a valid scene, which then passes; otherwise the error says where.
TEST(MalformedScenes, NeverCrashTheParser) {
  const std::string inserts[] = {"[",  "]",  "{", "}",   ":",   ": ", ",",  "\"", "'",  "&a ",     "*a",
                                 "!",  "!2", "|", ">",   "%",   "@",  "\t", "- ", "? ", "#",       " #",
                                 "\n", "\r", " ", "---", "...", "\\", "9",  "e",  "-",  "\xc3\xa9"};
  std::mt19937 random(17);
  const auto pick = [&](std::size_t n) { return std::uniform_int_distribution<std::size_t>(0, n - 1)(random); };
  for (const std::string& good : Problems()) {
    for (int i = 0; i < 600; ++i) {
      std::string text = good;
      for (std::size_t edits = 1 + pick(4); edits > 0; --edits) {
        const std::size_t at = pick(text.size());
        if (pick(3) == 0) text.erase(at, 1 + pick(20));
        text.insert(std::min(at, text.size()), inserts[pick(std::size(inserts))]);
      }
      SCOPED_TRACE(text);
      const auto result = ParseScene(text, "fuzz");
      if (const auto* scene = std::get_if<Scene>(&result)) {
        EXPECT_FALSE(Validate(*scene));
      } else {
        EXPECT_GT(std::get<SceneFileError>(result).line, 0);
      }
    }
  }
}

}  // namespace
}  // namespace saltus
