#include "base/parallel_for.h"

#include <glog/logging.h>
#include <tbb/info.h>
#include <tbb/parallel_for.h>
#include <tbb/task_arena.h>

#include <algorithm>
#include <thread>
#include <vector>

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

int NumThreads(int threads) {
  return threads > 0 ? threads : static_cast<int>(std::max(1u, std::thread::hardware_concurrency()));
}

void ParallelFor(int threads, int count, const std::function<void(int thread, int i)>& job) {
  CHECK_GT(threads, 0);
  if (threads == 1) {
    for (int i = 0; i < count; ++i) job(0, i);
    return;
  }
  // Of more threads than the machine has, TBB gives none, and warns.
  tbb::task_arena arena(std::min(threads, tbb::info::default_concurrency()));
  char begin, end;
  std::vector<char> of_thread(threads);
  OrderBefore(&begin);
  arena.execute([&] {
    tbb::parallel_for(tbb::blocked_range<int>(0, count), [&](const tbb::blocked_range<int>& range) {
      OrderAfter(&begin);
      const int thread = tbb::this_task_arena::current_thread_index();
      OrderAfter(&of_thread[thread]);
      // A job that waits for tasks of its own must not start another job in between.
      tbb::this_task_arena::isolate([&] {
        for (int i = range.begin(); i < range.end(); ++i) job(thread, i);
      });
      OrderBefore(&of_thread[thread]);
      OrderBefore(&end);
    });
  });
  OrderAfter(&end);
}

}  // namespace saltus
