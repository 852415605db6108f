#include "programs/given_gradient.h"

#include <fstream>

#include "programs/json_output.h"
#include "programs/program.h"

namespace saltus {
namespace {

// Reads lists of [x, y] and complains with the path of the key.
class Reader {
 public:
  explicit Reader(std::string path) : path_(std::move(path)) {}

  [[noreturn]] void Fail(const std::string& key, const std::string& expected) const {
    throw InputError(path_ + ": " + key + ": expected " + expected);
  }

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
      if (!is_vector) Fail(key + "[" + std::to_string(i) + "]", "[x, y] or null");
      vectors.emplace_back(Vec2d(item[0].get<double>(), item[1].get<double>()));
    }
    return vectors;
  }

 private:
  std::string path_;
};

}  // namespace

GivenGradient ReadGivenGradient(const std::string& path, const Scene& scene) {
  const Reader reader(path);
  std::ifstream file(path);
  if (!file) throw InputError("cannot read '" + path + "'");
  const Json document = Json::parse(file, nullptr, /*allow_exceptions=*/false);
  if (!document.is_object()) throw InputError(path + ": not a JSON object");
  GivenGradient given;
  given.name = path;
  for (const auto& [key, value] : document.items()) {
    if (key == "name") {
      if (!value.is_string()) reader.Fail(key, "a string");
      given.name = value.get<std::string>();
    } else if (key == "tolerance") {
      if (!value.is_number() || value.get<double>() < 0) reader.Fail(key, "a number that is not negative");
      given.tolerance = value.get<double>();
    } else if (key == "position") {
      given.position = reader.Vectors(value, key, scene.num_bodies());
    } else if (key == "velocity") {
      given.velocity = reader.Vectors(value, key, scene.num_bodies());
    } else if (key == "control") {
      const size_t most = scene.num_controlled() > 0 ? scene.steps : 0;
      if (!value.is_array() || value.size() > most)
        reader.Fail(key, "a list of at most " + std::to_string(most) + " steps");
      for (size_t k = 0; k < value.size(); ++k) {
        given.control.push_back(reader.Vectors(value[k], key + "[" + std::to_string(k) + "]", scene.num_controlled()));
      }
    } else {
      throw InputError(path + ": unknown key '" + key + "'; expected name, tolerance, position, velocity or control");
    }
  }
  return given;
}

}  // namespace saltus
