#include "programs/given_gradient.h"

#include <algorithm>

#include "base/file.h"
#include "programs/json_input.h"
#include "programs/program.h"
#include "saltus/simulate/registry.h"

namespace saltus {
namespace {

// Reads lists of [x, y].
class GradientReader : public InputReader {
 public:
  using InputReader::InputReader;

  std::vector<std::optional<Vec2d>> Vectors(const Json& list, const std::string& key, size_t most) const {
    if (!list.is_array() || list.size() > most)
      Fail(key, "a list of at most " + std::to_string(most) + " times [x, y]");
    std::vector<std::optional<Vec2d>> vectors;
    for (size_t i = 0; i < list.size(); ++i) {
      const Json& item = list[i];
      if (item.is_null()) {
        vectors.emplace_back();
        continue;
      }
      const bool is_vector = item.is_array() && item.size() == 2 && item[0].is_number() && item[1].is_number();
      if (!is_vector) Fail(key + "[" + std::to_string(i) + "]", "[x, y] of finite numbers, or null");
      vectors.emplace_back(Vec2d(item[0].get<double>(), item[1].get<double>()));
    }
    return vectors;
  }
};

Json ReadObject(const std::string& path) {
  const StatusOr<std::string> text = ReadFile(path);
  if (!text.ok()) throw InputError("--given: " + text.status().message());
  Json document = ParseJson(*text, path, "a JSON object");
  if (!document.is_object()) throw InputError(path + ": found JSON that is no object, expected a JSON object");
  return document;
}

// Reads into how many intervals the control is cut, from the model of the gradient.
void ReadContact(const Json& contact, const GradientReader& reader, const Scene& scene, GivenGradient* given) {
  if (!contact.is_string()) reader.Fail("contact", "a string");
  given->name = contact.get<std::string>();
  const ModelTraits* traits = FindContactModel(given->name);
  if (traits != nullptr && scene.steps % traits->grid_steps == 0) given->intervals = scene.steps / traits->grid_steps;
}

// One of the control: [x, y], or of a disc that is turned [x, y, torque] too.
void ReadInterval(Json list, const std::string& key, const GradientReader& reader, const Scene& scene,
                  GivenGradient* given) {
  const std::vector<int>& turned = scene.control.turned;
  std::vector<std::optional<double>> torques(turned.size());
  for (size_t c = 0; list.is_array() && c < std::min<size_t>(list.size(), scene.num_controlled()); ++c) {
    const auto at = std::ranges::find(turned, scene.control.bodies[c]);
    if (at == turned.end() || !list[c].is_array() || list[c].size() != 3 || !list[c][2].is_number()) continue;
    torques[at - turned.begin()] = list[c][2].get<double>();
    list[c].erase(2);
  }
  given->control.push_back(reader.Vectors(list, key, scene.num_controlled()));
  given->torque.push_back(std::move(torques));
}

void ReadGradient(const Json& document, const GradientReader& reader, const Scene& scene, GivenGradient* given) {
  if (const auto intervals = document.find("intervals"); intervals != document.end()) {
    const int64_t count = intervals->is_number_integer() ? intervals->get<int64_t>() : 0;
    if (count < 1 || count > scene.steps || scene.steps % count != 0) {
      reader.Fail("intervals", "a whole number that divides the " + std::to_string(scene.steps) + " steps");
    }
    given->intervals = static_cast<int>(count);
  }
  for (const auto& [key, value] : document.items()) {
    if (key == "name") {
      if (!value.is_string()) reader.Fail(key, "a string");
      given->name = value.get<std::string>();
    } else if (key == "tolerance") {
      if (!value.is_number() || value.get<double>() < 0) reader.Fail(key, "a number that is not negative");
      given->tolerance = value.get<double>();
    } else if (key == "position") {
      given->position = reader.Vectors(value, key, scene.num_bodies());
    } else if (key == "velocity") {
      given->velocity = reader.Vectors(value, key, scene.num_bodies());
    } else if (key == "control") {
      const int intervals = given->intervals > 0 ? given->intervals : scene.steps;
      const size_t most = scene.num_controlled() > 0 ? intervals : 0;
      if (!value.is_array() || value.size() > most)
        reader.Fail(key, "a list of at most " + std::to_string(most) + " intervals");
      for (size_t k = 0; k < value.size(); ++k) {
        ReadInterval(value[k], key + "[" + std::to_string(k) + "]", reader, scene, given);
      }
    } else if (key == "parameters") {
      if (!value.is_object() && !value.is_null()) reader.Fail(key, "an object or null");
    } else if (key != "intervals") {
      reader.Fail(key, "no such key, but position, velocity, control, parameters, name, tolerance or intervals");
    }
  }
}

// Whether there is a number that can be compared with the exact gradient: one of a disc that moves.
bool HasNumber(const GivenGradient& given, const Scene& scene) {
  const auto has_value = [](const auto& entry) { return entry.has_value(); };
  for (const auto& vectors : {given.position, given.velocity}) {
    for (size_t i = 0; i < vectors.size(); ++i) {
      if (vectors[i] && !scene.bodies[i].fixed) return true;
    }
  }
  const auto in_any = [&](const auto& rows) {
    return std::ranges::any_of(rows, [&](const auto& row) { return std::ranges::any_of(row, has_value); });
  };
  return in_any(given.control) || in_any(given.torque);
}

}  // namespace

GivenGradient ReadGivenGradient(const std::string& path, const Scene& scene) {
  const GradientReader reader(path);
  const Json document = ReadObject(path);
  GivenGradient given;
  given.name = path;
  if (document.contains("audits") || document.contains("audit") || document.contains("runs")) {
    throw InputError(path + ": a whole document of results; expected one gradient, such as its audits[0]");
  }
  const auto gradient = document.find("gradient");
  if (gradient == document.end()) {
    ReadGradient(document, reader, scene, &given);
  } else {
    if (!gradient->is_object()) reader.Fail("gradient", "an object");
    if (document.contains("contact")) ReadContact(document["contact"], reader, scene, &given);
    ReadGradient(*gradient, reader, scene, &given);
  }
  if (!HasNumber(given, scene)) {
    throw InputError(path + ": found no number of a disc that moves, expected some in position, velocity or control");
  }
  return given;
}

}  // namespace saltus
