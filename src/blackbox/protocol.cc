#include "blackbox/protocol.h"

#include <yaml-cpp/yaml.h>

#include <algorithm>
#include <cmath>
#include <set>
#include <span>

#include "saltus/scene/scene_file.h"

namespace saltus {
namespace {

constexpr std::size_t kExcerpt = 80;
constexpr int kVersion = 1;
constexpr char kDiscs[] = "discs";  // the mode of a scene

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

template <typename Name>
ProtocolJson NamesOf(int count, const Name& name) {
  ProtocolJson names = ProtocolJson::array();
  for (int i = 0; i < count; ++i) names.push_back(name(i));
  return names;
}

ProtocolJson NamesOf(const Scene& scene) {
  ProtocolJson states = ProtocolJson::array(), controls = ProtocolJson::array();
  for (const Body& body : scene.bodies) {
    for (const char* quantity : {"px ", "py ", "vx ", "vy "}) states.push_back(quantity + body.name);
    for (const char* quantity : {"fx ", "fy "}) controls.push_back(quantity + body.name);
  }
  return {{"modes", {{{"name", kDiscs}, {"states", std::move(states)}}}},
          {"controls", std::move(controls)},
          {"parameters", ProtocolJson::array()}};
}

ProtocolJson StepToJson(const std::string& mode, double t, double h, std::span<const double> state,
                        std::span<const double> control, std::span<const double> parameters) {
  const auto list = [](std::span<const double> numbers) { return std::vector<double>(numbers.begin(), numbers.end()); };
  return {{"mode", mode},
          {"t", t},
          {"h", h},
          {"state", list(state)},
          {"control", list(control)},
          {"parameters", list(parameters)}};
}

std::string KindName(BlackBoxRequest::Kind kind) {
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

}  // namespace

ProtocolJson NamesToJson(const HybridSystem& system) {
  ProtocolJson modes = ProtocolJson::array();
  for (int mode = 0; mode < system.functions().num_base_modes(); ++mode) {
    modes.push_back({{"name", system.ModeName(mode)},
                     {"states", NamesOf(system.state_size(mode), [&](int i) { return system.StateName(mode, i); })}});
  }
  return {{"modes", std::move(modes)},
          {"controls", NamesOf(system.num_controls(), [&](int i) { return system.ControlName(i); })},
          {"parameters", NamesOf(system.num_parameters(), [&](int i) { return system.ParameterName(i); })}};
}

ProtocolJson HelloOf(const Scene& scene) {
  return {{"saltus", kVersion}, {"scene", YamlToJson(YAML::Load(WriteScene(scene)), "")}, {"names", NamesOf(scene)}};
}

ProtocolJson HelloOf(const HybridSystem& system, const ProtocolJson& scene) {
  ProtocolJson hello = {{"saltus", kVersion}, {"hybrid", NamesToJson(system)}};
  if (!scene.is_null()) hello["scene"] = scene;
  return hello;
}

ProtocolJson RequestToJson(const Scene& scene, const BlackBoxRequest& request, const BlackBoxTraits& traits) {
  ProtocolJson asked;
  if (request.kind == BlackBoxRequest::Kind::kStep && traits.names) {
    asked = StepToJson(kDiscs, 0, request.duration, request.initial, request.control, {});
  } else if (request.kind == BlackBoxRequest::Kind::kStep) {
    asked = {
        {"h", request.duration}, {"state", RowsToJson(request.initial, 4)}, {"force", RowsToJson(request.control, 2)}};
  } else {
    std::vector<double> control = request.control;
    const std::size_t width = scene.control_width();
    const bool constant = std::equal(control.begin() + std::min(width, control.size()), control.end(), control.begin());
    if (constant && control.size() > width) control.resize(width);
    asked = {{"steps", request.steps},
             {"duration", request.duration},
             {"initial", RowsToJson(request.initial, 4)},
             {"control", ControlRowsToJson(control, scene.num_controlled())}};
  }
  if (request.kind == BlackBoxRequest::Kind::kGradient) {
    asked["of_final"] = RowsToJson(request.final_cotangent, 4);
    if (request.parameters) asked["parameters"] = true;
  } else if (request.kind == BlackBoxRequest::Kind::kSimulate && traits.states) {
    asked["states"] = request.states;
  }
  return {{KindName(request.kind), std::move(asked)}};
}

ProtocolJson StepToJson(const HybridSystem& system, const SchemeStep& step, bool jacobian) {
  const auto list = [](const double* numbers, int count) { return std::span(numbers, count); };
  ProtocolJson asked = StepToJson(system.ModeName(step.mode),
                                  step.t,
                                  step.h,
                                  list(step.x, system.state_size(step.mode)),
                                  list(step.u, system.num_controls()),
                                  list(step.p, system.num_parameters()));
  if (jacobian) asked["jacobian"] = true;
  return {{"step", std::move(asked)}};
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
  const std::pair<const char*, bool*> abilities[] = {{"gradient", &traits.gradient},
                                                     {"step", &traits.step},
                                                     {"states", &traits.states},
                                                     {"jacobian", &traits.jacobian},
                                                     {"names", &traits.names},
                                                     {"simulate", &traits.simulate}};
  traits.simulate = false;
  for (const ProtocolJson& ability : json["can"].is_array() ? json["can"] : ProtocolJson::array({json["can"]})) {
    const auto known = std::ranges::find_if(abilities, [&](const auto& one) { return ability == one.first; });
    if (known == std::end(abilities)) {
      throw ProtocolError("found " + Excerpt(ability.dump()) +
                          " in \"can\", expected some of \"gradient\", \"step\", \"states\", \"jacobian\", "
                          "\"names\" and \"simulate\"");
    }
    *known->second = true;
  }
  traits.step = traits.step || traits.names;
  traits.simulate = traits.simulate || !traits.names;
  return traits;
}

ProtocolJson ReadReply(const std::string& line, std::int64_t id) {
  ProtocolJson json = ParseObject(line, "an object with \"id\": " + std::to_string(id));
  const auto found = json.find("id");
  if (found == json.end() || *found != id) {
    throw ProtocolError("found " + (found == json.end() ? Excerpt(line) : "id " + Excerpt(found->dump())) +
                        ", expected \"id\": " + std::to_string(id) + " (answers come in the order of requests)");
  }
  return json;
}

std::string ErrorIn(const ProtocolJson& reply) {
  const auto error = reply.find("error");
  if (error == reply.end()) return "";
  const std::string words = error->is_string() ? error->get<std::string>() : error->dump();
  return words.empty() ? "an error without words" : words;
}

BlackBoxAnswer ParseAnswer(const ProtocolJson& json, const Scene& scene, const BlackBoxRequest& request,
                           const BlackBoxTraits& traits) {
  BlackBoxAnswer answer;
  answer.error = ErrorIn(json);
  if (!answer.error.empty()) return answer;
  const std::size_t discs = scene.num_bodies(), pushed = scene.num_controlled(), steps = request.steps;
  if (request.kind == BlackBoxRequest::Kind::kStep) {
    answer.final = NumbersAt(json, "state", traits.names ? std::vector{4 * discs} : std::vector{discs, std::size_t{4}});
    return answer;
  }
  answer.final = NumbersAt(json, "final", {discs, 4});
  if (request.kind == BlackBoxRequest::Kind::kGradient) {
    answer.initial = NumbersAt(json, "initial", {discs, 4});
    if (pushed > 0) answer.control = NumbersAt(json, "control", {steps, pushed, 2});
    const auto given = json.find("parameters");
    if (given != json.end() && !given->is_object()) {
      throw ProtocolError("found " + Excerpt(given->dump()) + ", expected an object as \"parameters\"");
    }
    const ProtocolJson named = given == json.end() ? ProtocolJson::object() : *given;
    for (const auto& [name, value] : named.items()) {
      answer.parameters.emplace_back(name, NumbersFrom(value, {}, "\"parameters\"")[0]);
    }
  } else if (traits.states && request.states) {
    answer.states = NumbersAt(json, "states", {steps / traits.grid_steps + 1, discs, 4});
  }
  return answer;
}

std::string Describe(const BlackBoxRequest& request) {
  const bool step = request.kind == BlackBoxRequest::Kind::kStep;
  return KindName(request.kind) + (step ? "" : " of " + std::to_string(request.steps) + " steps");
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

std::vector<double> NumbersAt(const ProtocolJson& json, const char* key, const std::vector<std::size_t>& shape) {
  const auto found = json.find(key);
  if (found == json.end()) throw ProtocolError("found " + Excerpt(json.dump()) + ", expected \"" + key + "\" in it");
  return NumbersFrom(*found, shape, "\"" + std::string(key) + "\"");
}

ProtocolJson SceneToJson(const RigidBodies2D& bodies) {
  const RigidScene2D& rigid = bodies.scene();
  ProtocolJson scene = {{"bodies", ProtocolJson::array()}, {"planes", ProtocolJson::array()}};
  if (rigid.friction == 0) scene["frictionless"] = true;
  for (std::size_t b = 0; b < rigid.bodies.size(); ++b) {
    const RigidBody2D& body = rigid.bodies[b];
    ProtocolJson item = {{"name", body.name}, {"position", body.position}, {"angle", body.angle}};
    item["fixed"] = body.joint.kind == RigidJoint2D::Kind::kWeld;
    if (body.joint.kind == RigidJoint2D::Kind::kTranslation) item["joint"] = "translation";
    if (body.joint.kind == RigidJoint2D::Kind::kRevolute) item["joint"] = {{"revolute", body.joint.point}};
    if (body.joint.kind == RigidJoint2D::Kind::kPrismatic) item["joint"] = {{"prismatic", body.joint.axis}};
    item["mass"] = body.mass;
    item["inertia"] = bodies.InertiaOf(static_cast<int>(b));
    if (body.radius > 0) {
      item["radius"] = body.radius;
    } else if (body.polygon == BoxPolygon(body.polygon[2][0], body.polygon[2][1])) {
      item["box"] = body.polygon[2];
    } else {
      item["polygon"] = body.polygon;
    }
    if (body.pushed) item["pushed"] = true;
    scene["bodies"].push_back(std::move(item));
  }
  for (const RigidPlane2D& plane : rigid.planes) {
    scene["planes"].push_back({{"point", plane.point}, {"normal", plane.normal}});
  }
  return scene;
}

}  // namespace saltus
