// The loop of a sweep: hands points to an executor and stores what comes back.
#pragma once

#include <cstdint>
#include <functional>
#include <vector>

#include "output/progress.h"
#include "sweep/executor.h"
#include "sweep/store.h"

namespace saltus {

// One of several parts of a study: the points whose number leaves the remainder index - 1 when divided by count.
struct Shard {
  int index = 1;
  int count = 1;
};

// The points of a part that are not stored yet, in ascending order. Calls `tick` now and then: there may be many.
std::vector<int64_t> PendingPoints(const SweepStudy& study, Shard shard, const SweepStore& store,
                                   const std::function<void()>& tick = nullptr);

// Computes and stores `points` until all are stored or the program is interrupted. The progress names the point that
// takes longest. Returns the store's error, if it takes no more.
Status RunPoints(const SweepStudy& study, const std::vector<int64_t>& points, SweepExecutor* executor,
                 SweepStore* store, Progress* progress);

}  // namespace saltus
