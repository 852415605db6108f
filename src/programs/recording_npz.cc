#include "programs/recording_npz.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <vector>

namespace saltus {
namespace {

class NpzReader {
 public:
  NpzReader(const std::string& path, const Scene& scene, const NpzArrays& arrays)
      : path_(path), scene_(scene), arrays_(arrays) {}

  Recording Read() const {
    for (const auto& [name, array] : arrays_) {
      if (name != "time" && name != "body" && name != "position" && name != "velocity" && name != "sigma" &&
          name != "sigma_v") {
        Fail("found the array '" + name + "', expected time, body, position and maybe velocity, sigma, sigma_v");
      }
    }
    const std::vector<double> time = Numbers("time", 1), position = Numbers("position", 2);
    const std::vector<double> velocity = Numbers("velocity", 2, false), sigma = Numbers("sigma", 1, false),
                              sigma_v = Numbers("sigma_v", 1, false);
    Recording recording{path_, {}};
    for (std::size_t i = 0; i < time.size(); ++i) {
      Sample sample;
      sample.time = time[i];
      sample.body = BodyAt(i);
      sample.position = {position[2 * i], position[2 * i + 1]};
      if (!velocity.empty()) sample.velocity = Vec2d(velocity[2 * i], velocity[2 * i + 1]);
      if (!sigma.empty()) sample.sigma = sigma[i];
      if (!velocity.empty() && !sigma_v.empty()) sample.sigma_velocity = sigma_v[i];
      if ((!sigma.empty() && sample.sigma <= 0) || (!sigma_v.empty() && sigma_v[i] <= 0)) {
        Fail("sigma of row " + std::to_string(i) + ": expected a number > 0");
      }
      recording.samples.push_back(sample);
    }
    return recording;
  }

 private:
  [[noreturn]] void Fail(const std::string& message) const { throw RecordingError{path_, 0, message}; }

  const NpyArray* Find(const std::string& name, bool needed) const {
    const auto found = arrays_.find(name);
    if (found != arrays_.end()) return &found->second;
    if (needed) Fail("found no array " + name + ", expected time, body and position");
    return nullptr;
  }

  int64_t NumRows() const {
    const NpyArray* time = Find("time", true);
    if (time->shape.size() != 1) Fail("time: expected one dimension");
    return time->shape[0];
  }

  // n x width numbers; a scalar stands for n rows of one. Empty if the array is not there.
  std::vector<double> Numbers(const std::string& name, int width, bool needed = true) const {
    const NpyArray* array = Find(name, needed);
    if (array == nullptr) return {};
    const auto* numbers = std::get_if<std::vector<double>>(&array->data);
    if (numbers == nullptr) Fail(name + ": expected float64");
    for (const double number : *numbers) {
      if (!std::isfinite(number)) Fail(name + ": found a number that is not finite");
    }
    const int64_t n = NumRows();
    if (array->shape.empty() && width == 1) return std::vector<double>(static_cast<std::size_t>(n), numbers->front());
    const std::vector<int64_t> shape = width == 1 ? std::vector<int64_t>{n} : std::vector<int64_t>{n, width};
    if (array->shape != shape) Fail(name + ": expected " + std::to_string(n) + (width == 1 ? "" : " x 2") + " numbers");
    return *numbers;
  }

  int BodyAt(std::size_t row) const {
    const NpyArray* array = Find("body", true);
    if (array->shape != std::vector<int64_t>{NumRows()}) Fail("body: expected one name or index for each time");
    if (const auto* indices = std::get_if<std::vector<int64_t>>(&array->data)) {
      const int64_t index = (*indices)[row];
      if (index < 0 || index >= scene_.num_bodies()) Fail("body of row " + std::to_string(row) + ": none of the scene");
      return static_cast<int>(index);
    }
    const auto* names = std::get_if<std::vector<std::string>>(&array->data);
    if (names == nullptr) Fail("body: expected names or int64 indices");
    const auto found = std::find_if(
        scene_.bodies.begin(), scene_.bodies.end(), [&](const Body& body) { return body.name == (*names)[row]; });
    if (found == scene_.bodies.end()) Fail("body of row " + std::to_string(row) + ": found '" + (*names)[row] + "'");
    return static_cast<int>(found - scene_.bodies.begin());
  }

  const std::string& path_;
  const Scene& scene_;
  const NpzArrays& arrays_;
};

}  // namespace

std::variant<Recording, RecordingError> RecordingFromArrays(const NpzArrays& arrays, const std::string& name,
                                                            const Scene& scene) {
  try {
    Recording recording = NpzReader(name, scene, arrays).Read();
    if (const auto error = CheckRecording(scene, &recording)) return *error;
    return recording;
  } catch (const RecordingError& error) {
    return error;
  }
}

std::variant<Recording, RecordingError> LoadRecordingNpz(const std::string& path, const Scene& scene) {
  const StatusOr<NpzArrays> arrays = ReadNpz(path);
  if (!arrays.ok()) return RecordingError{path, 0, arrays.status().message()};
  return RecordingFromArrays(*arrays, path, scene);
}

}  // namespace saltus
