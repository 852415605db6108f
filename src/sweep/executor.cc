#include "sweep/executor.h"

#include "sweep/point.h"

namespace saltus {
namespace {

// A solver that looks at the clock itself returns what it has reached; only what does not is stopped from outside.
constexpr double kGraceSeconds = 0.5;

}  // namespace

LocalExecutor::LocalExecutor(const SweepStudy& study, int workers, double seconds)
    : study_(study),
      seconds_(seconds),
      pool_(workers, seconds > 0 ? seconds + kGraceSeconds : 0,
            [&study, seconds](int64_t point) { return Encode(ComputePoint(study, point, seconds)); }) {}

std::vector<FinishedPoint> LocalExecutor::Wait(std::chrono::microseconds timeout) {
  std::vector<FinishedPoint> points;
  for (const WorkerPool::Result& result : pool_.Wait(timeout)) points.push_back({result.task, ToPoint(result)});
  return points;
}

PointResult LocalExecutor::ToPoint(const WorkerPool::Result& result) const {
  switch (result.end) {
    case WorkerPool::End::kAnswered:
      return DecodePointResult(result.text);
    case WorkerPool::End::kTooLate:
      return FailedPoint(study_, result.task, TimeLimitReason(seconds_));
    case WorkerPool::End::kDied:
      break;
  }
  return FailedPoint(study_, result.task, "its process died: " + result.text);
}

}  // namespace saltus
