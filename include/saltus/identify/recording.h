// Recordings: measured positions, and velocities, of discs at given times.
#pragma once

#include <optional>
#include <string>
#include <string_view>
#include <variant>
#include <vector>

#include "saltus/scene/scene.h"

namespace saltus {

// A measurement of one disc at one time.
struct Sample {
  double time = 0;                               // s, in [0, duration] of the scene
  int body = 0;                                  // index into Scene::bodies
  Vec2d position = Vec2d::Zero();                // m
  std::optional<Vec2d> velocity = std::nullopt;  // m/s, where it was measured too
  double sigma = 0;                              // m, standard deviation of either coordinate; 0: not stated
  double sigma_velocity = 0;                     // m/s, that of either component of the velocity; 0: not stated
  int line = 0;                                  // of the file, from 1; 0: of none

  bool operator==(const Sample&) const = default;
};

// Samples of one run of a scene, in the order of time. Recordings share the parameters, and each has its own initial
// state.
struct Recording {
  std::string name;
  std::vector<Sample> samples;
};

// The reason why a text is no recording.
struct RecordingError {
  std::string file;
  int line = 0;  // from 1; 0: of no line in particular
  std::string message;

  // One line: "ball.csv:12: body: found 'bal', expected one of ball, wall".
  std::string ToString() const;
};

// Reads a recording from CSV text; `name` stands for the file in errors. Columns, in any order: time, body, x, y; and
// if they are there sigma, vx, vy (both or none) and sigma_v, whose fields may be empty. Rows need not be in order.
// Refused, with the line: numbers that are not finite, times outside of the scene's, bodies that do not exist or are
// fixed, a body twice at one time, sigma in some rows only, unknown columns. The scene must be valid.
std::variant<Recording, RecordingError> ParseRecording(std::string_view text, const std::string& name,
                                                       const Scene& scene);

// Reads a recording from a CSV file, by the rules of ParseRecording().
std::variant<Recording, RecordingError> LoadRecording(const std::string& path, const Scene& scene);

// Returns the first error in samples: none, times, bodies or sigmas that ParseRecording() refuses, or a body twice at
// one time. Sorts the samples by time, then by body.
std::optional<RecordingError> CheckRecording(const Scene& scene, Recording* recording);

}  // namespace saltus
