// Recordings in NumPy archives.
#pragma once

#include <string>
#include <variant>

#include "output/npz.h"
#include "saltus/identify/recording.h"

namespace saltus {

// Arrays time (n), body (n, names or indices of the scene) and position (n x 2); and if they are there velocity (n x
// 2), sigma and sigma_v (n, or one number). Refused: what CSV is refused for, with the row, from 0.
std::variant<Recording, RecordingError> RecordingFromArrays(const NpzArrays& arrays, const std::string& name,
                                                            const Scene& scene);

// Those of a file.
std::variant<Recording, RecordingError> LoadRecordingNpz(const std::string& path, const Scene& scene);

}  // namespace saltus
