#include "solve/phases/motion_merit.h"

#include <cmath>
#include <limits>

#include "control/control_bounds.h"
#include "solve/phases/phase_plan.h"

namespace saltus {
namespace {

constexpr double kMissWeight = 1e3;  // of hard constraints beside the loss, in natural units
constexpr int kHalvings = 8;         // on the way from one motion to another

// A part of the way; its exact run is not filled.
Trial Between(const Scene& scene, const Trial& to, const Trial& from, double part) {
  Trial between = to;
  for (size_t j = 0; j < to.initial.size(); ++j) {
    between.initial[j] = part * to.initial[j] + (1 - part) * InitialOf(scene, from)[j];
  }
  const auto before = ForcesOf(scene, from);
  const double stretch = DurationOf(from) / DurationOf(to);
  double begin = 0;
  for (size_t k = 0; k < to.durations.size(); ++k) {
    for (int entry = 0; entry < scene.control_width(); ++entry) {
      double& u = between.control[scene.ForceIndex(k, 0) + entry];
      u = part * u + (1 - part) * before(entry, stretch * (begin + 0.5 * to.durations[k]));
    }
    begin += to.durations[k];
    between.durations[k] *= part + (1 - part) * stretch;
  }
  return between;
}

}  // namespace

double MeritOf(const Scene& scene, const Trial& trial) {
  if (!trial.exact.ok || !trial.exact.only_impacts) return std::numeric_limits<double>::infinity();
  const double violation = ViolationOf(scene, trial);
  return trial.exact.loss + kMissWeight * violation * violation;
}

Trial WithinBounds(const Scene& scene, const std::vector<OwnTerm>& terms, Trial trial) {
  const std::vector<double> control = trial.control;
  MoveWithinBounds(scene, trial.control);
  if (trial.control != control) Simulate(scene, terms, &trial);
  return trial;
}

std::optional<Trial> WalkTo(const Scene& scene, const std::vector<OwnTerm>& terms, const Trial& to, const Trial& from) {
  std::optional<Trial> best;
  double least = MeritOf(scene, WithinBounds(scene, terms, from));
  if (std::isfinite(least)) least -= kHardlyBetter * std::abs(least);
  double part = 1;
  for (int i = 0; i <= kHalvings; ++i, part /= 2) {
    Trial between = Between(scene, to, from, part);
    MoveWithinBounds(scene, between.control);
    Simulate(scene, terms, &between);
    const double merit = MeritOf(scene, between);
    if (!(merit < least)) continue;
    least = merit;
    best = std::move(between);
  }
  return best;
}

}  // namespace saltus
