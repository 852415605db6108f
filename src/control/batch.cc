#include "saltus/control/batch.h"

#include <glog/logging.h>

#include <algorithm>
#include <limits>

#include "base/parallel_for.h"
#include "saltus/simulate/registry.h"

namespace saltus {

Batch::Batch(const Contact& contact, const Scene& scene, Precision precision, int threads,
             SingleShooting::Variables variables) {
  CHECK_GE(threads, 0);
  for (int i = 0; i < NumThreads(threads); ++i) {
    shootings_.push_back(std::make_unique<SingleShooting>(MakeSimulator(contact, scene, precision), variables));
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
  ForEach(static_cast<int>(losses.size()), [&](SingleShooting* shooting, int i) {
    const std::span<double> gradient = gradients.empty() ? gradients : gradients.subspan(i * size, size);
    const bool ok =
        shooting->Evaluate(points.subspan(i * size, size), &losses[i], gradient.empty() ? nullptr : gradient.data());
    if (ok) return;
    losses[i] = std::numeric_limits<double>::quiet_NaN();
    std::fill(gradient.begin(), gradient.end(), losses[i]);
  });
}

void Batch::ForEach(int count, const std::function<void(SingleShooting* shooting, int i)>& job) {
  ParallelFor(num_threads(), count, [&](int thread, int i) { job(shootings_[thread].get(), i); });
}

}  // namespace saltus
