// What identification is given, as text and files.
#pragma once

#include <optional>
#include <string>
#include <variant>
#include <vector>

#include "output/npz.h"
#include "saltus/identify/identify.h"
#include "saltus/identify/recording.h"

namespace saltus {

// "none", "huber" or "cauchy".
std::optional<RobustLoss> ParseRobustLoss(const std::string& name);

// "network" or "impulse", perhaps with ":N" hidden units: a network that begins as the scene's law. Else what was
// expected.
std::variant<ImpactLaw, std::string> ParseLaw(const std::string& text, const Scene& scene);

// "affine", or "profile", perhaps with ":N" hidden units: event functions that begin as the scene's planes. Else what
// was expected.
std::variant<EventFunctions, std::string> ParseEvents(const std::string& text, const Scene& scene);

// A recording from a CSV or an NPZ file.
std::variant<Recording, RecordingError> LoadAnyRecording(const std::string& path, const Scene& scene);

// Restitution by the speed of approach, m/s, which rises.
struct KnownLaw {
  std::vector<double> speed, restitution;

  // By straight lines between the points; nothing outside of them.
  std::optional<double> At(double at) const;
};

// From CSV with the columns speed and restitution. Throws InputError that names the line: numbers that are not finite,
// speeds that do not rise, restitution outside of [0, 1], fewer than two rows.
KnownLaw ReadKnownLaw(const std::string& path);

// Arrays time (n), body (n, names or indices of the scene) and position (n x 2); and if they are there velocity (n x
// 2), sigma and sigma_v (n, or one number). Refused: what CSV is refused for, with the row, from 0.
std::variant<Recording, RecordingError> RecordingFromArrays(const NpzArrays& arrays, const std::string& name,
                                                            const Scene& scene);

// Those of a file.
std::variant<Recording, RecordingError> LoadRecordingNpz(const std::string& path, const Scene& scene);

}  // namespace saltus
