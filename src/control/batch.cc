#include "saltus/control/batch.h"

#include <glog/logging.h>

#include <algorithm>
#include <array>
#include <limits>

#include "base/parallel_for.h"
#include "saltus/internal/lanes.h"
#include "saltus/simulate/registry.h"

namespace saltus {

Batch::Batch(const Contact& contact, const Scene& scene, Precision precision, int threads,
             SingleShooting::Variables variables) {
  CHECK_GE(threads, 0);
  for (int i = 0; i < NumThreads(threads) * num_lanes_; ++i) {
    shootings_.push_back(std::make_unique<SingleShooting>(MakeSimulator(contact, scene, precision), variables));
    num_lanes_ = shootings_.front()->num_lanes();
  }
}

void Batch::set_memory_limit(std::size_t bytes) {
  for (const std::unique_ptr<SingleShooting>& shooting : shootings_) shooting->set_memory_limit(bytes);
}

void Batch::set_stop(const StopRequest& stop) {
  for (const std::unique_ptr<SingleShooting>& shooting : shootings_) shooting->set_stop(stop);
}

void Batch::Evaluate(std::span<const double> points, std::span<double> losses, std::span<double> gradients) {
  const size_t size = num_variables();
  CHECK_EQ(points.size(), losses.size() * size);
  CHECK(gradients.empty() || gradients.size() == points.size());
  const size_t count = losses.size(), lanes = num_lanes_;
  ParallelFor(num_threads(), static_cast<int>((count + lanes - 1) / lanes), [&](int thread, int group) {
    const size_t first = group * lanes, n = std::min(lanes, count - first);
    const std::span<double> gradient = gradients.empty() ? gradients : gradients.subspan(first * size, n * size);
    std::array<bool, kLanes> ok;
    SingleShooting::EvaluateTogether(std::span(shootings_).subspan(thread * lanes, n),
                                     points.subspan(first * size, n * size),
                                     losses.subspan(first, n),
                                     gradient,
                                     std::span(ok).first(n));
    for (size_t i = 0; i < n; ++i) {
      if (ok[i]) continue;
      losses[first + i] = std::numeric_limits<double>::quiet_NaN();
      if (!gradient.empty()) std::ranges::fill(gradient.subspan(i * size, size), losses[first + i]);
    }
  });
}

void Batch::ForEach(int count, const std::function<void(SingleShooting* shooting, int i)>& job) {
  ParallelFor(num_threads(), count, [&](int thread, int i) { job(shootings_[thread * num_lanes_].get(), i); });
}

}  // namespace saltus
