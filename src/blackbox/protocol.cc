#include "blackbox/protocol.h"

#include <yaml-cpp/yaml.h>

#include <charconv>
#include <cmath>
#include <set>
#include <span>

#include "saltus/scene/scene_file.h"

namespace saltus {
namespace {

constexpr std::size_t kExcerpt = 80;
constexpr int kVersion = 1;

// Converts a scene file to JSON. Values under a key of `texts` are texts even if they look like numbers.
ProtocolJson YamlToJson(const YAML::Node& node, const std::string& key) {
  static const std::set<std::string> texts = {"name", "body", "bodies", "free", "no_contact", "torque"};
  ProtocolJson json;
  if (node.IsMap()) {
    json = ProtocolJson::object();
    for (const auto& entry : node) {
      const auto name = entry.first.as<std::string>();
      json[name] = YamlToJson(entry.second, name);
    }
  } else if (node.IsSequence()) {
    json = ProtocolJson::array();
    for (const YAML::Node& item : node) json.push_back(YamlToJson(item, key));
  } else {
    json = ProtocolJson::parse(node.Scalar(), nullptr, /*allow_exceptions=*/false);
    if (texts.contains(key) || json.is_discarded()) json = node.Scalar();
  }
  return json;
}

void Append(double value, std::string* text) {
  char digits[32];
  text->append(digits, std::to_chars(digits, digits + sizeof digits, value).ptr);
}

// Appends a row of numbers: [a, b].
void AppendRow(std::span<const double> row, std::string* text) {
  for (std::size_t i = 0; i < row.size(); ++i) {
    *text += i == 0 ? '[' : ',';
    Append(row[i], text);
  }
  *text += row.empty() ? "[]" : "]";
}

void AppendRows(std::span<const double> numbers, std::size_t width, std::string* text) {
  *text += '[';
  for (std::size_t i = 0; i < numbers.size(); i += width) {
    if (i > 0) *text += ',';
    AppendRow(numbers.subspan(i, width), text);
  }
  *text += ']';
}

void AppendControl(std::span<const double> control, std::size_t width, std::string* text) {
  const std::size_t all = control.size();
  const auto constant = [&] {
    for (std::size_t i = width; i < all; ++i) {
      if (control[i] != control[i - width]) return false;
    }
    return true;
  };
  *text += '[';
  const std::size_t end = width > 0 && all > width && constant() ? width : all;
  for (std::size_t i = 0; i < end; i += width) {
    if (i > 0) *text += ',';
    AppendRows(control.subspan(i, width), 2, text);
  }
  *text += ']';
}

std::string KindName(Question::Kind kind) {
  constexpr const char* kNames[] = {"simulate", "gradient", "step"};
  return kNames[static_cast<int>(kind)];
}

ProtocolJson ParseObject(const std::string& line, const std::string& expected) {
  ProtocolJson json = ProtocolJson::parse(line, nullptr, /*allow_exceptions=*/false);
  const bool not_finite =
      json.is_discarded() && (line.find("NaN") != std::string::npos || line.find("Infinity") != std::string::npos);
  if (not_finite)
    throw ProtocolError("found a number that is not finite in " + Excerpt(line) + ", expected " + expected);
  if (!json.is_object()) throw ProtocolError("found " + Excerpt(line) + ", expected " + expected);
  return json;
}

// Returns a shape in words: "2 x 4".
std::string ShapeToString(const std::vector<std::size_t>& shape) {
  std::string text;
  for (const std::size_t size : shape) text += (text.empty() ? "" : " x ") + std::to_string(size);
  return text;
}

void Collect(const ProtocolJson& json, std::span<const std::size_t> shape, const std::string& what,
             std::vector<double>* numbers) {
  if (shape.empty()) {
    if (!json.is_number()) throw ProtocolError(what + ", found " + Excerpt(json.dump()) + " among them");
    const double number = json.get<double>();
    if (!std::isfinite(number)) throw ProtocolError(what + ", found one that is not finite");
    numbers->push_back(number);
    return;
  }
  if (!json.is_array() || json.size() != shape[0]) {
    const std::string found = json.is_array() ? "a list of " + std::to_string(json.size()) : Excerpt(json.dump());
    throw ProtocolError(what + ", found " + found + " in place of a list of " + std::to_string(shape[0]));
  }
  for (const ProtocolJson& item : json) Collect(item, shape.subspan(1), what, numbers);
}

std::vector<double> Member(const ProtocolJson& json, const char* key, const std::vector<std::size_t>& shape) {
  const auto found = json.find(key);
  if (found == json.end()) throw ProtocolError("found " + Excerpt(json.dump()) + ", expected \"" + key + "\" in it");
  return NumbersFrom(*found, shape, "\"" + std::string(key) + "\"");
}

}  // namespace

std::string HelloLine(const Scene& scene) {
  const ProtocolJson hello = {{"saltus", kVersion}, {"scene", YamlToJson(YAML::Load(WriteScene(scene)), "")}};
  return hello.dump();
}

std::string QuestionLine(const Scene& scene, const Question& question, std::int64_t id, const BlackBoxTraits& traits) {
  std::string text = "{\"id\": " + std::to_string(id) + ", \"" + KindName(question.kind) + "\": {";
  if (question.kind == Question::Kind::kStep) {
    text += "\"h\": ";
    Append(question.duration, &text);
    text += ", \"state\": ";
    AppendRows(question.initial, 4, &text);
    text += ", \"force\": ";
    AppendRows(question.control, 2, &text);
    return text + "}}";
  }
  text += "\"steps\": " + std::to_string(question.steps) + ", \"duration\": ";
  Append(question.duration, &text);
  text += ", \"initial\": ";
  AppendRows(question.initial, 4, &text);
  text += ", \"control\": ";
  AppendControl(question.control, scene.control_width(), &text);
  if (question.kind == Question::Kind::kGradient) {
    text += ", \"of_final\": ";
    AppendRows(question.of_final, 4, &text);
    if (question.parameters) text += ", \"parameters\": true";
  } else if (traits.states) {
    text += question.states ? ", \"states\": true" : ", \"states\": false";
  }
  return text + "}}";
}

BlackBoxTraits ReadHello(const std::string& line) {
  const ProtocolJson json = ParseObject(line, "an object with \"name\", \"can\" or \"not_applicable\"");
  BlackBoxTraits traits;
  const auto text = [&](const char* key, std::string* value) {
    const auto found = json.find(key);
    if (found == json.end()) return;
    if (!found->is_string()) throw ProtocolError("found " + Excerpt(line) + ", expected a text as \"" + key + "\"");
    *value = found->get<std::string>();
  };
  text("name", &traits.name);
  text("not_applicable", &traits.not_applicable);
  text("error", &traits.error);
  if (const auto steps = json.find("grid_steps"); steps != json.end()) {
    if (!steps->is_number_integer() || *steps < 1 || *steps > 1000) {
      throw ProtocolError("found " + Excerpt(line) + ", expected a whole number in 1..1000 as \"grid_steps\"");
    }
    traits.grid_steps = steps->get<int>();
  }
  if (!json.contains("can")) return traits;
  for (const ProtocolJson& ability : json["can"].is_array() ? json["can"] : ProtocolJson::array({json["can"]})) {
    if (ability == "gradient") {
      traits.gradient = true;
    } else if (ability == "step") {
      traits.step = true;
    } else if (ability == "states") {
      traits.states = true;
    } else {
      throw ProtocolError("found " + Excerpt(ability.dump()) +
                          " in \"can\", expected some of \"gradient\", \"step\" and \"states\"");
    }
  }
  return traits;
}

Answer ReadAnswer(const std::string& line, const Scene& scene, const Question& question, std::int64_t id,
                  const BlackBoxTraits& traits) {
  const ProtocolJson json = ParseObject(line, "an object with \"id\": " + std::to_string(id));
  const auto found = json.find("id");
  if (found == json.end() || *found != id) {
    throw ProtocolError("found " + (found == json.end() ? Excerpt(line) : "id " + Excerpt(found->dump())) +
                        ", expected \"id\": " + std::to_string(id) + " (answers come in the order of requests)");
  }
  Answer answer;
  if (const auto error = json.find("error"); error != json.end()) {
    answer.error = error->is_string() ? error->get<std::string>() : error->dump();
    if (answer.error.empty()) answer.error = "an error without words";
    return answer;
  }
  const std::size_t discs = scene.num_bodies(), pushed = scene.num_controlled(), steps = question.steps;
  if (question.kind == Question::Kind::kStep) {
    answer.final = Member(json, "state", {discs, 4});
    return answer;
  }
  answer.final = Member(json, "final", {discs, 4});
  if (question.kind == Question::Kind::kGradient) {
    answer.initial = Member(json, "initial", {discs, 4});
    if (pushed > 0) answer.control = Member(json, "control", {steps, pushed, 2});
    const auto given = json.find("parameters");
    if (given != json.end() && !given->is_object()) {
      throw ProtocolError("found " + Excerpt(given->dump()) + ", expected an object as \"parameters\"");
    }
    const ProtocolJson named = given == json.end() ? ProtocolJson::object() : *given;
    for (const auto& [name, value] : named.items()) {
      answer.parameters.emplace_back(name, NumbersFrom(value, {}, "\"parameters\"")[0]);
    }
  } else if (traits.states && question.states) {
    answer.states = Member(json, "states", {steps / traits.grid_steps + 1, discs, 4});
  }
  return answer;
}

std::string Describe(const Question& question, std::int64_t id) {
  const std::string steps =
      question.kind == Question::Kind::kStep ? "" : " of " + std::to_string(question.steps) + " steps";
  return "request " + std::to_string(id) + " (" + KindName(question.kind) + steps + ")";
}

std::string Excerpt(const std::string& text) {
  std::string excerpt = "'";
  for (const char c : text.substr(0, kExcerpt)) excerpt += c >= ' ' && c < 127 ? c : '?';
  return excerpt + (text.size() > kExcerpt ? "...' (" + std::to_string(text.size()) + " characters)" : "'");
}

ProtocolJson RowsToJson(const std::vector<double>& numbers, std::size_t width) {
  ProtocolJson rows = ProtocolJson::array();
  for (std::size_t i = 0; i < numbers.size(); i += width) {
    rows.push_back(std::vector<double>(numbers.begin() + i, numbers.begin() + i + width));
  }
  return rows;
}

ProtocolJson ControlRowsToJson(const std::vector<double>& control, std::size_t discs) {
  ProtocolJson rows = ProtocolJson::array();
  const std::size_t width = 2 * discs;
  for (std::size_t i = 0; width > 0 && i < control.size(); i += width) {
    rows.push_back(RowsToJson({control.begin() + i, control.begin() + i + width}, 2));
  }
  return rows;
}

std::vector<double> NumbersFrom(const ProtocolJson& json, const std::vector<std::size_t>& shape,
                                const std::string& what) {
  std::vector<double> numbers;
  Collect(json, shape, "expected " + what + " of " + ShapeToString(shape) + " finite numbers", &numbers);
  return numbers;
}

}  // namespace saltus
