#include "base/parallel_for.h"

#include <glog/logging.h>
#include <tbb/info.h>
#include <tbb/parallel_for.h>
#include <tbb/task_arena.h>

#include <algorithm>
#include <map>
#include <memory>
#include <mutex>
#include <thread>
#include <utility>
#include <vector>

#ifdef __SANITIZE_THREAD__
#include <sanitizer/tsan_interface.h>
#endif

namespace saltus {
namespace {

// Writes before OrderBefore(at) happen before reads after OrderAfter(at). oneTBB guarantees this order, but is not
// built with ThreadSanitizer, which must be told.
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

// A task arena with room for `threads` threads, in use by one call. oneTBB keeps a few KiB of every arena that is ever
// made, so arenas are not destroyed: their number is that of the calls that run at the same time.
class ArenaOfCall {
 public:
  explicit ArenaOfCall(int threads) : threads_(threads) {
    const std::lock_guard lock(Idle().mutex);
    if (auto found = Idle().arenas.extract(threads)) {
      arena_ = std::move(found.mapped());
    } else {
      arena_ = std::make_unique<tbb::task_arena>(threads);
    }
  }
  ~ArenaOfCall() {
    const std::lock_guard lock(Idle().mutex);
    Idle().arenas.emplace(threads_, std::move(arena_));
  }
  ArenaOfCall(const ArenaOfCall&) = delete;
  ArenaOfCall& operator=(const ArenaOfCall&) = delete;

  tbb::task_arena& operator*() { return *arena_; }

 private:
  struct IdleArenas {
    std::mutex mutex;
    std::multimap<int, std::unique_ptr<tbb::task_arena>> arenas;  // by their number of threads
  };
  // Never destroyed, because threads of oneTBB may outlive static objects.
  static IdleArenas& Idle() {
    static IdleArenas& idle = *new IdleArenas;
    return idle;
  }

  const int threads_;
  std::unique_ptr<tbb::task_arena> arena_;
};

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
  // TBB provides no more threads than the machine has, and prints a warning if more are asked for.
  ArenaOfCall arena(std::min(threads, tbb::info::default_concurrency()));
  char begin, end;
  std::vector<char> of_thread(threads);
  OrderBefore(&begin);
  (*arena).execute([&] {
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
