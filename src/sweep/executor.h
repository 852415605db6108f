// The executors of the points of a sweep (worker processes of this machine, or those and the ranks of a cluster), and
// the loop that hands points to them and stores the results.
#pragma once

#include <sys/types.h>

#include <chrono>
#include <cstdint>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "output/progress.h"
#include "sweep/store.h"
#include "sweep/study.h"

namespace saltus {

// A pool of worker processes, each with one task at a time. A task that crashes, or does not end in time, ends its
// process only, which is replaced; threads would take the program with them.
class WorkerPool {
 public:
  using Clock = std::chrono::steady_clock;
  // Runs in a worker, which has everything that the program had when the worker started, but none of its threads.
  // Answers have at most kLongestAnswer bytes.
  using Work = std::function<std::string(int64_t task)>;
  static constexpr size_t kLongestAnswer = 100'000;

  enum class End { kAnswered, kDied, kTooLate };
  struct Result {
    int64_t task = 0;
    End end = End::kAnswered;
    std::string text;  // the answer; or how the process died: "killed by signal 11 (Segmentation fault)"
  };

  // `seconds` is what a task may take (0: any time). Precondition: workers > 0, and no other threads that hold locks
  // which `work` needs, neither now nor when a worker must be replaced. This, Start and Wait throw std::runtime_error
  // if the system has no process or socket for a worker.
  WorkerPool(int workers, double seconds, Work work);
  // Ends the workers, and with them what they were computing.
  ~WorkerPool();
  WorkerPool(const WorkerPool&) = delete;
  WorkerPool& operator=(const WorkerPool&) = delete;

  int size() const { return static_cast<int>(workers_.size()); }
  bool HasIdle() const { return busy_ < size(); }
  bool HasBusy() const { return busy_ > 0; }

  // Precondition: HasIdle().
  void Start(int64_t task);

  // Waits until a task is finished or the time is over; returns those that are. A signal ends the wait too.
  std::vector<Result> Wait(std::chrono::microseconds timeout);

 private:
  struct Worker {
    pid_t process = -1;
    int socket = -1;
    bool busy = false;
    int64_t task = 0;
    Clock::time_point deadline;
  };

  void Launch(Worker* worker);
  // Ends the process; returns how it ended.
  std::string Reap(Worker* worker);
  Result Finish(Worker* worker);
  Clock::duration UntilDeadline() const;

  double seconds_;
  Work work_;
  int busy_ = 0;
  std::vector<Worker> workers_;
};

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

// The ranks of an MPI job, among which the points of a sweep are shared out as they become free. Rank 0 has the store,
// hands out points, stores what comes back, and computes too. A rank that falls silent (its process was killed, its
// machine is gone) loses only what it was computing: those points go to others. For the job to outlive a rank, Open
// MPI's mpirun needs --enable-recovery; without, it ends all ranks, and what is stored stays.
class SweepCluster {
 public:
  // On rank 0, ends the others' Serve; then leaves the job together with them.
  virtual ~SweepCluster() = default;

  virtual int rank() const = 0;
  // Returns how many of the ranks share this machine.
  virtual int ranks_here() const = 0;

  // On rank 0, before there is an executor: to be called at short intervals, lest others believe that it is gone.
  virtual void Tick() = 0;

  // On rank 0: `local` and all other ranks as one executor. Ranks that have another study are left out. `local` must
  // outlive the executor, this object too.
  virtual std::unique_ptr<SweepExecutor> Share(const SweepStudy& study, LocalExecutor* local) = 0;

  // On other ranks: computes what rank 0 asks for until it is done. False if rank 0 is gone.
  virtual bool Serve(const SweepStudy& study, LocalExecutor* local) = 0;

  // On other ranks: computes nothing; rank 0 logs why, unless the same keeps it from working too.
  virtual void Decline(const std::string& why) = 0;
};

// The job that mpirun started, or nothing if this program was started by itself. Throws InputError if it was built
// without MPI and started by mpirun. Precondition: called at most once.
std::unique_ptr<SweepCluster> JoinCluster();
// Joins the cluster of an MPI job; only if this was built with MPI (mpi_cluster.cc).
std::unique_ptr<SweepCluster> JoinMpi();

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
