#include <algorithm>
#include <cmath>
#include <limits>

#include "base/file.h"
#include "programs/input_files.h"
#include "programs/program.h"
#include "saltus/control/control_rows.h"
#include "saltus/simulate/registry.h"

namespace saltus {
namespace {

constexpr double kUnknown = std::numeric_limits<double>::quiet_NaN();

// Reads lists of [x, y].
class GradientReader : public InputReader {
 public:
  using InputReader::InputReader;

  // Returns rows of `columns` numbers, of which unknown ones are NaN. Rows with a nonzero entry in `thirds` may be [x,
  // y, z].
  std::vector<double> Vectors(const Json& list, const std::string& key, size_t most, size_t columns = 2,
                              const std::vector<char>& thirds = {}) const {
    if (!list.is_array() || list.size() > most)
      Fail(key, "a list of at most " + std::to_string(most) + " times [x, y]");
    std::vector<double> numbers(most * columns, kUnknown);
    for (size_t i = 0; i < list.size(); ++i) {
      const Json& item = list[i];
      if (item.is_null()) continue;
      const bool fits = item.is_array() && (item.size() == 2 || (item.size() == 3 && !thirds.empty() && thirds[i]));
      if (!fits || !std::ranges::all_of(item, [](const Json& number) { return number.is_number(); })) {
        Fail(key + "[" + std::to_string(i) + "]", "[x, y] of finite numbers, or null");
      }
      for (size_t j = 0; j < item.size(); ++j) numbers[i * columns + j] = item[j].get<double>();
    }
    return numbers;
  }

  // Returns numbers of discs, of which unknown ones are NaN.
  std::vector<double> Rotations(const Json& list, const std::string& key, size_t most) const {
    const auto fits = [](const Json& number) { return number.is_null() || number.is_number(); };
    if (!list.is_array() || list.size() > most || !std::ranges::all_of(list, fits)) {
      Fail(key, "a list of at most " + std::to_string(most) + " finite numbers or null, one for each disc");
    }
    std::vector<double> numbers;
    for (const Json& number : list) numbers.push_back(number.is_null() ? kUnknown : number.get<double>());
    return numbers;
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
void ReadContact(const Json& contact, const GradientReader& reader, const Scene& scene, ExternalGradient* given) {
  if (!contact.is_string()) reader.Fail("contact", "a string");
  given->name = contact.get<std::string>();
  const ModelTraits* traits = FindContactModel(given->name);
  if (traits != nullptr && scene.steps % traits->grid_steps == 0) given->intervals = scene.steps / traits->grid_steps;
}

// Reads intervals of [x, y] or, of discs that are turned, [x, y, torque].
void ReadControl(const Json& list, const GradientReader& reader, const Scene& scene, ExternalGradient* given) {
  const int intervals = given->intervals > 0 ? given->intervals : scene.steps;
  const size_t discs = scene.num_controlled(), most = discs > 0 ? intervals : 0;
  if (!list.is_array() || list.size() > most) {
    reader.Fail("control", "a list of at most " + std::to_string(most) + " intervals");
  }
  std::vector<char> turns;
  for (const int body : scene.control.bodies)
    turns.push_back(std::ranges::count(scene.control.torque_bodies, body) > 0);
  for (size_t k = 0; k < list.size(); ++k) {
    const std::string key = "control[" + std::to_string(k) + "]";
    const std::vector<double> row = reader.Vectors(list[k], key, discs, ControlColumns(scene), turns);
    given->control.insert(given->control.end(), row.begin(), row.end());
  }
}

void ReadGradient(const Json& document, const GradientReader& reader, const Scene& scene, ExternalGradient* given) {
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
    } else if (scene.Spins() && (key == "angle" || key == "angular_velocity")) {
      (key == "angle" ? given->angle : given->angular_velocity) = reader.Rotations(value, key, scene.num_bodies());
    } else if (key == "control") {
      ReadControl(value, reader, scene, given);
    } else if (key == "parameters") {
      if (!value.is_object() && !value.is_null()) reader.Fail(key, "an object or null");
    } else if (key != "intervals") {
      reader.Fail(
          key,
          "no such key, but position, velocity, control, parameters, name, tolerance or intervals, and of scenes "
          "with discs that spin angle and angular_velocity");
    }
  }
}

// Whether there is a number that can be compared with the exact gradient: one of a disc that moves.
bool HasNumber(const ExternalGradient& given, const Scene& scene) {
  for (const std::vector<double>& numbers : {given.position, given.velocity}) {
    for (size_t i = 0; i < numbers.size(); ++i) {
      if (!std::isnan(numbers[i]) && !scene.bodies[i / 2].fixed) return true;
    }
  }
  for (const std::vector<double>& numbers : {given.angle, given.angular_velocity}) {
    for (size_t i = 0; i < numbers.size(); ++i) {
      if (!std::isnan(numbers[i]) && scene.bodies[i].Spins()) return true;
    }
  }
  return !std::ranges::all_of(given.control, [](double number) { return std::isnan(number); });
}

}  // namespace

ExternalGradient ReadExternalGradient(const std::string& path, const Scene& scene) {
  const GradientReader reader(path);
  const Json document = ReadObject(path);
  ExternalGradient given;
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
