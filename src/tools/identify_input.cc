#include "tools/identify_input.h"

#include <algorithm>
#include <charconv>

#include "physics/units.h"
#include "tools/recording_npz.h"

namespace saltus {
namespace {

constexpr int kLawUnits = 4, kMostLawUnits = 16;
constexpr double kInside = 1e-3;  // how near to its bounds a law may begin

}  // namespace

std::optional<RobustLoss> ParseRobustLoss(const std::string& name) {
  if (name == "none") return RobustLoss::kNone;
  if (name == "huber") return RobustLoss::kHuber;
  if (name == "cauchy") return RobustLoss::kCauchy;
  return std::nullopt;
}

std::variant<ImpactLaw, std::string> ParseLaw(const std::string& text, const Scene& scene) {
  const std::size_t colon = std::min(text.find(':'), text.size());
  const std::string kind = text.substr(0, colon), width = text.substr(std::min(colon + 1, text.size()));
  int units = colon == text.size() ? kLawUnits : 0;
  std::from_chars(width.data(), width.data() + width.size(), units);
  const bool whole = colon == text.size() || width == std::to_string(units);
  if ((kind != "network" && kind != "impulse") || !whole || units < 1 || units > kMostLawUnits) {
    return "expected network or impulse, and maybe :N with N in 1.." + std::to_string(kMostLawUnits);
  }
  const double speed = NaturalUnits(scene).speed();
  const double restitution = std::clamp(scene.contact.restitution, kInside, 1 - kInside);
  if (kind == "network") return RestitutionNetwork(units, speed, restitution);
  return ImpulseNetwork(units, speed, restitution, std::max(scene.contact.friction, kInside));
}

std::variant<Recording, RecordingError> LoadAnyRecording(const std::string& path, const Scene& scene) {
  return path.ends_with(".npz") ? LoadRecordingNpz(path, scene) : LoadRecording(path, scene);
}

}  // namespace saltus
