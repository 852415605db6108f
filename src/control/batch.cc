#include "saltus/control/batch.h"

#include <glog/logging.h>
#include <tbb/info.h>
#include <tbb/parallel_for.h>
#include <tbb/task_arena.h>

#include <algorithm>
#include <limits>
#include <thread>

#include "saltus/dynamics/registry.h"

#ifdef __SANITIZE_THREAD__
#include <sanitizer/tsan_interface.h>
#endif

namespace saltus {
namespace {

// What happens before OrderBefore(at) happens before what follows OrderAfter(at). oneTBB sees to that; ThreadSanitizer,
// with which it is not built, must be told.
void OrderBefore([[maybe_unused]] void* at) {
#ifdef __SANITIZE_THREAD__
  __tsan_release(at);
#endif
}
void OrderAfter([[maybe_unused]] void* at) {
#ifdef __SANITIZE_THREAD__
  __tsan_acquire(at);
#endif
}

}  // namespace

Batch::Batch(const Contact& contact, const Scene& scene, Precision precision, int threads,
             SingleShooting::Variables variables) {
  CHECK_GE(threads, 0);
  if (threads == 0) threads = std::max(1u, std::thread::hardware_concurrency());
  for (int i = 0; i < threads; ++i) {
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
  if (num_threads() == 1) {
    for (int i = 0; i < count; ++i) job(shootings_.front().get(), i);
    return;
  }
  // Of more threads than the machine has, TBB gives none, and warns.
  tbb::task_arena arena(std::min(num_threads(), tbb::info::default_concurrency()));
  char begin, end;
  OrderBefore(&begin);
  arena.execute([&] {
    tbb::parallel_for(tbb::blocked_range<int>(0, count), [&](const tbb::blocked_range<int>& range) {
      OrderAfter(&begin);
      SingleShooting* shooting = shootings_[tbb::this_task_arena::current_thread_index()].get();
      OrderAfter(shooting);
      // A job that waits for tasks of its own must not start another job in between.
      tbb::this_task_arena::isolate([&] {
        for (int i = range.begin(); i < range.end(); ++i) job(shooting, i);
      });
      OrderBefore(shooting);
      OrderBefore(&end);
    });
  });
  OrderAfter(&end);
}

}  // namespace saltus
