#include "programs/identify_input.h"

#include <algorithm>
#include <charconv>

#include "programs/recording_npz.h"
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

}  // namespace saltus
