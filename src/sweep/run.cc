#include "sweep/run.h"

#include <algorithm>
#include <chrono>
#include <map>

#include "base/interrupt.h"
#include "sweep/output.h"

namespace saltus {
namespace {

using Clock = std::chrono::steady_clock;

constexpr std::chrono::milliseconds kLookForInterrupts(100);
constexpr std::chrono::seconds kSlow(5);

// "point 3 (stiffness=100, contact=ncp, solver=gd) for 12 s", of the one that was started first if that is long ago.
std::string SlowestOf(const SweepStudy& study, const std::map<int64_t, Clock::time_point>& at_work) {
  const auto first = std::min_element(
      at_work.begin(), at_work.end(), [](const auto& a, const auto& b) { return a.second < b.second; });
  if (first == at_work.end()) return "";
  const auto seconds = std::chrono::duration_cast<std::chrono::seconds>(Clock::now() - first->second);
  if (seconds < kSlow) return "";
  return PlaceOf(study, first->first) + " for " + std::to_string(seconds.count()) + " s";
}

}  // namespace

std::vector<int64_t> PendingPoints(const SweepStudy& study, Shard shard, const SweepStore& store,
                                   const std::function<void()>& tick) {
  constexpr int64_t kPointsATick = 10'000;
  std::vector<int64_t> points;
  for (int64_t point = shard.index - 1; point < study.size(); point += shard.count) {
    if (!store.Has(point)) points.push_back(point);
    if (InterruptGuard::Interrupted()) break;
    if (tick && point / shard.count % kPointsATick == 0) tick();
  }
  return points;
}

Status RunPoints(const SweepStudy& study, const std::vector<int64_t>& points, SweepExecutor* executor,
                 SweepStore* store, Progress* progress) {
  std::map<int64_t, Clock::time_point> at_work;
  for (size_t next = 0; next < points.size() || executor->HasBusy();) {
    // What workers have answered by then is stored after an interrupt, too.
    const bool interrupted = InterruptGuard::Interrupted();
    for (; !interrupted && next < points.size() && executor->HasRoom(); ++next) {
      executor->Start(points[next]);
      at_work[points[next]] = Clock::now();
    }
    for (const FinishedPoint& finished :
         executor->Wait(interrupted ? std::chrono::milliseconds(0) : kLookForInterrupts)) {
      if (Status status = store->Add(finished.point, finished.result); !status.ok()) return status;
      progress->Advance();
      at_work.erase(finished.point);
    }
    if (interrupted) break;
    progress->Advance(0, SlowestOf(study, at_work));
  }
  return Status();
}

}  // namespace saltus
