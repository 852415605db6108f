// Independent jobs on all cores, with progress.
#pragma once

#include <tbb/parallel_for.h>
#include <tbb/task_arena.h>

#include <atomic>
#include <exception>
#include <functional>
#include <string>

#include "saltus/io/interrupt.h"
#include "saltus/io/progress.h"

namespace saltus {

// Calls job(i) for i = 0..count-1 on `threads` threads, each once, until interrupted. Jobs must write to
// places of their own, so that results do not depend on the number of threads. Returns how many were done.
inline int RunJobs(int count, int threads, Progress* progress, const std::function<void(int)>& job) {
  std::atomic<int> done = 0;
  tbb::task_arena arena(threads);
  arena.execute([&] {
    tbb::parallel_for(
        tbb::blocked_range<int>(0, count, 1),
        [&](const tbb::blocked_range<int>& range) {
          for (int i = range.begin(); i < range.end(); ++i) {
            if (InterruptGuard::Interrupted()) return;
            job(i);
            ++done;
            progress->Advance();
          }
        },
        tbb::simple_partitioner());
  });
  return done;
}

}  // namespace saltus
