#include "programs/sweep/run.h"

#include "saltus/io/interrupt.h"

namespace saltus {
namespace {

constexpr std::chrono::milliseconds kLookForInterrupts(100);

}  // namespace

std::vector<int64_t> PendingPoints(const SweepStudy& study, Shard shard, const SweepStore& store) {
  std::vector<int64_t> points;
  for (int64_t point = shard.index - 1; point < study.size(); point += shard.count) {
    if (!store.Has(point)) points.push_back(point);
  }
  return points;
}

Status RunPoints(const std::vector<int64_t>& points, SweepExecutor* executor, SweepStore* store, Progress* progress) {
  for (size_t next = 0; next < points.size() || executor->HasBusy();) {
    if (InterruptGuard::Interrupted()) break;
    while (next < points.size() && executor->HasRoom()) executor->Start(points[next++]);
    for (const FinishedPoint& finished : executor->Wait(kLookForInterrupts)) {
      if (Status status = store->Add(finished.point, finished.result); !status.ok()) return status;
      progress->Advance();
    }
  }
  return Status();
}

}  // namespace saltus
