// What identification is given, as text and files.
#pragma once

#include <optional>
#include <string>
#include <variant>

#include "saltus/identify/identify.h"

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

}  // namespace saltus
