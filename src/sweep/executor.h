// What computes the points of a sweep: worker processes of this machine, or those and the ranks of a cluster.
#pragma once

#include <chrono>
#include <cstdint>
#include <vector>

#include "sweep/study.h"
#include "sweep/workers.h"

namespace saltus {

struct FinishedPoint {
  int64_t point = 0;
  PointResult result;
};

class SweepExecutor {
 public:
  virtual ~SweepExecutor() = default;
  virtual bool HasRoom() const = 0;
  virtual bool HasBusy() const = 0;
  // Precondition: HasRoom().
  virtual void Start(int64_t point) = 0;
  // Waits until a point is finished or the time is over. Every point that was started comes back once.
  virtual std::vector<FinishedPoint> Wait(std::chrono::microseconds timeout) = 0;
};

// Worker processes of this machine. A point whose process dies, or that is not done `seconds` (0: any time) after it
// started, fails.
class LocalExecutor : public SweepExecutor {
 public:
  // `study` must outlive the object.
  LocalExecutor(const SweepStudy& study, int workers, double seconds);

  int size() const { return pool_.size(); }
  bool HasRoom() const override { return pool_.HasIdle(); }
  bool HasBusy() const override { return pool_.HasBusy(); }
  void Start(int64_t point) override { pool_.Start(point); }
  std::vector<FinishedPoint> Wait(std::chrono::microseconds timeout) override;

 private:
  PointResult ToPoint(const WorkerPool::Result& result) const;

  const SweepStudy& study_;
  double seconds_;
  WorkerPool pool_;
};

}  // namespace saltus
