#include "control/smoothed_gradient.h"

#include <glog/logging.h>

#include <algorithm>
#include <cmath>

#include "base/random.h"
#include "saltus/control/objective.h"
#include "saltus/simulate/registry.h"

namespace saltus {
namespace {

constexpr int kMostPairs = 64;  // held in memory at a time

Scene RemoveEffort(Scene scene) {
  scene.objective.effort = 0;
  return scene;
}

// Mean and standard error of samples, updated one sample at a time (Welford 1962).
class Moments {
 public:
  explicit Moments(size_t size) : mean_(size), squares_(size) {}

  template <typename ValueOf>
  void Add(const ValueOf& value) {
    ++count_;
    for (size_t i = 0; i < mean_.size(); ++i) {
      const double x = value(i), before = x - mean_[i];
      mean_[i] += before / count_;
      squares_[i] += before * (x - mean_[i]);
    }
  }

  double mean(size_t i) const { return mean_[i]; }
  double standard_error(size_t i) const { return std::sqrt(squares_[i] / (count_ - 1) / count_); }

 private:
  double count_ = 0;
  std::vector<double> mean_, squares_;
};

}  // namespace

SmoothedGradient::SmoothedGradient(const Contact& contact, const Scene& scene, Precision precision,
                                   const Surrogate& surrogate, int threads, Variables variables)
    : objective_(scene.objective),
      controls_(variables == Variables::kOptimized && scene.optimize == Optimize::kControl),
      surrogate_(surrogate),
      batch_(contact, RemoveEffort(scene), precision, threads, variables) {
  CHECK(surrogate.smooths());
  CHECK(Validate(surrogate).empty()) << Validate(surrogate);
  CHECK(ReasonNotApplicable(surrogate, contact, scene).empty()) << ReasonNotApplicable(surrogate, contact, scene);
  const int steps = scene.steps / FindContactModel(contact)->grid_steps;
  step_ = scene.duration / steps;
  const int width = scene.control_width();
  const std::int64_t segments = surrogate.segments == 0 ? steps : surrogate.segments;
  multiplicity_.resize(controls_ ? segments * width : num_variables());
  for (int i = 0; i < num_variables(); ++i) {
    place_.push_back(controls_ ? static_cast<int>(i / width * segments / steps) * width + i % width : i);
    ++multiplicity_[place_.back()];
  }
}

void SmoothedGradient::Perturb(std::span<const double> z, int pairs) {
  const size_t n = z.size(), m = multiplicity_.size();
  points_.resize(2 * pairs * n);
  losses_.resize(2 * pairs);
  for (int pair = 0; pair < pairs; ++pair) {
    double* above = &points_[2 * pair * n];
    for (size_t i = 0; i < n; ++i) {
      const double away = surrogate_.sigma * normals_[pair * m + place_[i]];
      above[i] = z[i] + away;
      above[n + i] = z[i] - away;
    }
  }
}

bool SmoothedGradient::Evaluate(std::span<const double> z, int iteration, std::span<double> gradient,
                                std::span<double> standard_error) {
  const size_t n = num_variables(), m = multiplicity_.size();
  CHECK_EQ(z.size(), n);
  if (n == 0) return true;
  NormalStream stream(surrogate_.seed + iteration);
  Moments moments(zeroth() ? m : n);
  for (int left = surrogate_.samples / 2; left > 0; left -= kMostPairs) {
    const int pairs = std::min(left, kMostPairs);
    normals_.resize(pairs * m);
    std::generate(normals_.begin(), normals_.end(), [&] { return stream.Next(); });
    Perturb(z, pairs);
    if (!zeroth()) gradients_.resize(points_.size());
    batch_.Evaluate(points_, losses_, gradients_);
    if (!std::all_of(losses_.begin(), losses_.end(), [](double loss) { return std::isfinite(loss); })) return false;
    for (int pair = 0; pair < pairs; ++pair) {
      if (zeroth()) {
        const double slope = (losses_[2 * pair] - losses_[2 * pair + 1]) / (2 * surrogate_.sigma);
        moments.Add([&](size_t i) { return slope * normals_[pair * m + i]; });
      } else {
        const double* above = &gradients_[2 * pair * n];
        moments.Add([&](size_t i) { return 0.5 * (above[i] + above[n + i]); });
      }
    }
  }
  for (size_t i = 0; i < n; ++i) {
    const size_t at = zeroth() ? place_[i] : i;
    const double share = zeroth() ? multiplicity_[at] : 1;
    gradient[i] = moments.mean(at) / share;
    standard_error[i] = moments.standard_error(at) / share;
  }
  if (controls_) AddEffortGradient(objective_, z, step_, gradient);
  return true;
}

}  // namespace saltus
