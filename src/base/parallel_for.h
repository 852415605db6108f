// Parallel loops over independent jobs.
#pragma once

#include <functional>

namespace saltus {

// Returns `threads`, or the number of cores if it is 0.
int NumThreads(int threads);

// Calls job(thread, i) for i = 0 .. count - 1, each once, on up to `threads` threads, and returns when all are done. No
// two jobs that run at the same time have the same `thread`, a number below `threads`. Results must not share a place.
// Precondition: threads > 0.
void ParallelFor(int threads, int count, const std::function<void(int thread, int i)>& job);

}  // namespace saltus
