#include "programs/identify_input.h"

#include <algorithm>
#include <charconv>
#include <cmath>
#include <cstdint>
#include <vector>

#include "base/csv.h"
#include "programs/program.h"
#include "scene/units.h"

namespace saltus {

namespace {

constexpr int kLawUnits = 4, kProfileUnits = 3, kMostUnits = 16;
constexpr double kInside = 1e-3;  // how near to its bounds a law may begin

// "network:8" is a network of eight units; of "network" there are `units`. None if what follows the colon is no number
// of units.
struct KindAndUnits {
  std::string kind;
  int units = 0;
};
std::optional<KindAndUnits> SplitUnits(const std::string& text, int units) {
  const std::size_t colon = text.find(':');
  KindAndUnits split{text.substr(0, colon), units};
  if (colon == std::string::npos) return split;
  const std::string digits = text.substr(colon + 1);
  split.units = 0;
  std::from_chars(digits.data(), digits.data() + digits.size(), split.units);
  if (digits != std::to_string(split.units) || split.units < 1 || split.units > kMostUnits) return std::nullopt;
  return split;
}

std::string Expected(const std::string& kinds) {
  return "expected " + kinds + " with N in 1.." + std::to_string(kMostUnits);
}

}  // namespace

std::optional<RobustLoss> ParseRobustLoss(const std::string& name) {
  if (name == "none") return RobustLoss::kNone;
  if (name == "huber") return RobustLoss::kHuber;
  if (name == "cauchy") return RobustLoss::kCauchy;
  return std::nullopt;
}

std::variant<ImpactLaw, std::string> ParseLaw(const std::string& text, const Scene& scene) {
  const std::optional<KindAndUnits> split = SplitUnits(text, kLawUnits);
  const double speed = NaturalUnits(scene).speed();
  const double restitution = std::clamp(scene.contact.restitution, kInside, 1 - kInside);
  if (split && split->kind == "network") return RestitutionNetwork(split->units, speed, restitution);
  if (split && split->kind == "impulse") {
    return ImpulseNetwork(split->units, speed, restitution, std::max(scene.contact.friction, kInside));
  }
  return Expected("network or impulse, and maybe :N");
}

std::variant<EventFunctions, std::string> ParseEvents(const std::string& text, const Scene& scene) {
  const std::optional<KindAndUnits> split = SplitUnits(text, kProfileUnits);
  if (split && split->kind == "profile") return ProfileEvents(scene, split->units);
  if (text == "affine") return AffineEvents(scene);
  return Expected("affine or profile, which maybe has :N");
}

std::variant<Recording, RecordingError> LoadAnyRecording(const std::string& path, const Scene& scene) {
  return path.ends_with(".npz") ? LoadRecordingNpz(path, scene) : LoadRecording(path, scene);
}

// ---- A law that is known

namespace {

double ReadNumber(const std::string& text, const std::string& where) {
  double value = 0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  if (error != std::errc() || end != text.data() + text.size() || !std::isfinite(value)) {
    throw InputError(where + ": found '" + text + "', expected a finite number");
  }
  return value;
}

}  // namespace

std::optional<double> KnownLaw::At(double at) const {
  const auto above = std::lower_bound(speed.begin(), speed.end(), at);
  if (above == speed.end() || at < speed.front()) return std::nullopt;
  const auto i = std::max<std::ptrdiff_t>(1, above - speed.begin());
  const double share = (at - speed[i - 1]) / (speed[i] - speed[i - 1]);
  return restitution[i - 1] + share * (restitution[i] - restitution[i - 1]);
}

KnownLaw ReadKnownLaw(const std::string& path) {
  const StatusOr<CsvDocument> csv = ReadCsv(path);
  if (!csv.ok()) throw InputError(csv.status().message());
  const auto speed = csv->Find("speed"), restitution = csv->Find("restitution");
  if (!speed || !restitution) throw InputError(path + ": expected the columns speed and restitution");
  KnownLaw law;
  for (std::size_t i = 0; i < csv->rows.size(); ++i) {
    const std::string line = path + ":" + std::to_string(csv->lines[i]) + ": ";
    const double v = ReadNumber(csv->rows[i][*speed], line + "speed");
    const double e = ReadNumber(csv->rows[i][*restitution], line + "restitution");
    if (v < 0 || (i > 0 && v <= law.speed.back())) throw InputError(line + "speed: expected speeds >= 0 that rise");
    if (e < 0 || e > 1) throw InputError(line + "restitution: expected a number in [0, 1]");
    law.speed.push_back(v);
    law.restitution.push_back(e);
  }
  if (law.speed.size() < 2)
    throw InputError(path + ": found fewer than two rows, expected a law at two speeds or more");
  return law;
}

// ---- Recordings in NPZ files

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
