#include "saltus/identify/recording.h"

#include <algorithm>
#include <cmath>
#include <tuple>

#include "base/csv.h"
#include "base/file.h"
#include "base/number_text.h"

namespace saltus {
namespace {

// In the order in which they are looked for; the first four must be there.
constexpr const char* kColumns[] = {"time", "body", "x", "y", "sigma", "vx", "vy", "sigma_v"};
constexpr int kNumColumns = 8, kTime = 0, kBody = 1, kX = 2, kY = 3, kSigma = 4, kVx = 5, kVy = 6, kSigmaV = 7;

std::string Bodies(const Scene& scene) {
  std::string names;
  for (const Body& body : scene.bodies) {
    if (!body.fixed) names += (names.empty() ? "" : ", ") + body.name;
  }
  return names;
}

// Reads rows; what is wrong is thrown.
class Reader {
 public:
  Reader(const std::string& file, const Scene& scene) : file_(file), scene_(scene) {}

  Recording Read(const CsvDocument& csv) {
    FindColumns(csv);
    Recording recording{file_, {}};
    for (std::size_t i = 0; i < csv.rows.size(); ++i) {
      line_ = csv.lines[i];
      recording.samples.push_back(ReadRow(csv.rows[i]));
    }
    return recording;
  }

 private:
  [[noreturn]] void Fail(const std::string& message) const { throw RecordingError{file_, line_, message}; }

  void FindColumns(const CsvDocument& csv) {
    line_ = 1;
    for (const std::string& name : csv.header) {
      if (std::find(std::begin(kColumns), std::end(kColumns), name) == std::end(kColumns)) {
        Fail("found the column '" + name + "', expected time, body, x, y and maybe sigma, vx, vy, sigma_v");
      }
    }
    for (int i = 0; i < kNumColumns; ++i) {
      column_[i] = csv.Find(kColumns[i]);
      if (i < kSigma && !column_[i])
        Fail(std::string("found no column ") + kColumns[i] + ", expected time, body, x, y");
    }
    if (column_[kVx].has_value() != column_[kVy].has_value()) Fail("found one of vx and vy, expected both or none");
    if (column_[kSigmaV] && !column_[kVx]) Fail("found sigma_v, expected vx and vy with it");
  }

  Sample ReadRow(const std::vector<std::string>& row) const {
    Sample sample;
    sample.line = line_;
    sample.time = Number(row, kTime);
    const std::string& name = row[*column_[kBody]];
    const auto body = std::find_if(
        scene_.bodies.begin(), scene_.bodies.end(), [&](const Body& candidate) { return candidate.name == name; });
    if (body == scene_.bodies.end()) Fail("body: found '" + name + "', expected one of " + Bodies(scene_));
    sample.body = static_cast<int>(body - scene_.bodies.begin());
    sample.position = {Number(row, kX), Number(row, kY)};
    if (IsGiven(row, kSigma)) sample.sigma = Positive(row, kSigma);
    if (IsGiven(row, kVx) != IsGiven(row, kVy)) Fail("found one of vx and vy, expected both or none");
    if (IsGiven(row, kVx)) sample.velocity = Vec2d(Number(row, kVx), Number(row, kVy));
    if (IsGiven(row, kSigmaV)) sample.sigma_velocity = Positive(row, kSigmaV);
    return sample;
  }

  bool IsGiven(const std::vector<std::string>& row, int column) const {
    return column_[column] && !row[*column_[column]].empty();
  }

  double Number(const std::vector<std::string>& row, int column) const {
    const std::string& text = row[*column_[column]];
    std::size_t end = 0;
    double value = std::nan("");
    try {
      value = std::stod(text, &end);
    } catch (const std::exception&) {
    }
    if (end != text.size() || !std::isfinite(value) || std::abs(value) > kLargestMagnitude) {
      Fail(std::string(kColumns[column]) + ": found '" + text + "', expected a finite number");
    }
    return value;
  }

  double Positive(const std::vector<std::string>& row, int column) const {
    const double value = Number(row, column);
    if (value < kSmallestPositive) {
      Fail(std::string(kColumns[column]) + ": found '" + row[*column_[column]] + "', expected a number > 0");
    }
    return value;
  }

  const std::string& file_;
  const Scene& scene_;
  int line_ = 1;
  std::optional<std::size_t> column_[kNumColumns];
};

std::string Text(double value) { return ToText(value, 12); }

}  // namespace

std::string RecordingError::ToString() const {
  if (message.starts_with(file + ": ")) return message;  // errors of reading a file name it
  return file + (line > 0 ? ":" + std::to_string(line) : std::string()) + ": " + message;
}

std::optional<RecordingError> CheckRecording(const Scene& scene, Recording* recording) {
  const auto error = [&](const Sample& sample, const std::string& message) {
    return RecordingError{recording->name, sample.line, message};
  };
  std::vector<Sample>& samples = recording->samples;
  if (samples.empty()) return RecordingError{recording->name, 0, "found no samples, expected at least one"};
  for (const Sample& sample : samples) {
    if (!(sample.time >= 0 && sample.time <= scene.duration)) {
      return error(
          sample,
          "time: found " + Text(sample.time) + ", expected 0 to the scene's duration, " + Text(scene.duration) + " s");
    }
    if (sample.body < 0 || sample.body >= scene.num_bodies()) return error(sample, "body: found none of the scene");
    if (scene.bodies[sample.body].fixed) {
      return error(
          sample,
          "body: found '" + scene.bodies[sample.body].name + "', which is fixed; expected one of " + Bodies(scene));
    }
    const Sample& first = samples.front();
    if ((sample.sigma > 0) != (first.sigma > 0))
      return error(sample, "found sigma in some rows, expected in all or none");
    if (sample.velocity && (sample.sigma > 0) != (sample.sigma_velocity > 0)) {
      return error(sample, "found one of sigma and sigma_v, expected both or none where there is a velocity");
    }
  }
  std::ranges::stable_sort(
      samples, [](const Sample& a, const Sample& b) { return std::tie(a.time, a.body) < std::tie(b.time, b.body); });
  for (std::size_t i = 1; i < samples.size(); ++i) {
    const Sample &before = samples[i - 1], &sample = samples[i];
    if (before.time != sample.time || before.body != sample.body) continue;
    const Sample& later = before.line > sample.line ? before : sample;
    return error(
        later,
        "found '" + scene.bodies[sample.body].name + "' again at time " + Text(sample.time) +
            (later.line > 0 ? ", as in line " + std::to_string(std::min(before.line, sample.line)) : std::string()) +
            "; expected it once");
  }
  return std::nullopt;
}

std::variant<Recording, RecordingError> ParseRecording(std::string_view text, const std::string& name,
                                                       const Scene& scene) {
  const StatusOr<CsvDocument> csv = ParseCsv(text);
  if (!csv.ok()) return RecordingError{name, 0, csv.status().message()};
  try {
    Recording recording = Reader(name, scene).Read(*csv);
    if (const auto error = CheckRecording(scene, &recording)) return *error;
    return recording;
  } catch (const RecordingError& error) {
    return error;
  }
}

std::variant<Recording, RecordingError> LoadRecording(const std::string& path, const Scene& scene) {
  const StatusOr<std::string> text = ReadFile(path);
  if (!text.ok()) return RecordingError{path, 0, text.status().message()};
  return ParseRecording(*text, path, scene);
}

}  // namespace saltus
