// Processes that compute, one task at a time each.
//
// Processes rather than threads: a task that crashes, or does not end in time, takes nothing with it but its process,
// which is replaced.
#pragma once

#include <sys/types.h>

#include <chrono>
#include <cstdint>
#include <functional>
#include <string>
#include <vector>

namespace saltus {

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

}  // namespace saltus
