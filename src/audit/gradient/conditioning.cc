#include "audit/gradient/conditioning.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <random>
#include <string>
#include <vector>

#include "saltus/audit/gradients.h"
#include "saltus/simulate/registry.h"

namespace saltus {
namespace {

constexpr int kSamples = 4;
constexpr double kEpsilon = std::numeric_limits<double>::epsilon();

double Norm(const std::vector<double>& entries) {
  double sum = 0;
  for (double entry : entries) sum += entry * entry;
  return std::sqrt(sum);
}

double RelativeChange(std::vector<double> gradient, const std::vector<double>& from) {
  for (std::size_t i = 0; i < gradient.size(); ++i) gradient[i] -= from[i];
  const double scale = Norm(from);
  return scale > 0 ? Norm(gradient) / scale : 0.0;
}

// With every number of the initial state off by a last bit, up or down.
Scene Jitter(Scene scene, std::mt19937* random) {
  for (Body& body : scene.bodies) {
    for (Vec2d* vector : {&body.position, &body.velocity}) {
      for (int j = 0; j < 2; ++j) (*vector)[j] *= (*random)() % 2 == 0 ? 1 + kEpsilon : 1 - kEpsilon;
    }
  }
  return scene;
}

}  // namespace

std::optional<Conditioning> MeasureConditioning(const Scene& scene, const StopRequest& stop) {
  const auto exact = std::find_if(AllContactModels().begin(), AllContactModels().end(), [](const ModelTraits& traits) {
    return traits.event_driven;
  });
  if (exact == AllContactModels().end()) return std::nullopt;
  const ModelGradient gradient = ComputeGradient(exact->name, scene, Precision::kDouble, stop);
  if (!gradient.ok()) return std::nullopt;
  Conditioning found;
  const auto compare = [&](const Scene& other) {
    const ModelGradient changed = ComputeGradient(exact->name, other, Precision::kDouble, stop);
    return changed.ok() ? RelativeChange(changed.gradient.initial, gradient.gradient.initial) : 1.0;
  };
  std::mt19937 random(1);
  for (int sample = 1; sample <= kSamples; ++sample) {
    const double change = compare(Jitter(scene, &random));
    found.condition = std::max(found.condition, change / kEpsilon);
    Scene resampled = scene;
    resampled.steps += sample;
    found.rounding = std::max({found.rounding, change, compare(resampled)});
    if (stop && stop()) return std::nullopt;
  }
  return found;
}

}  // namespace saltus
