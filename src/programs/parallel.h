// Independent jobs on all cores, with progress, that an interrupt ends within a second.
#pragma once

#include <exception>
#include <functional>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "output/progress.h"

namespace saltus {

// Called by a job to report, for people, its present work.
using SayNote = std::function<void(const std::string& note)>;
using Job = std::function<void(int index, const SayNote& say)>;

// The name of a job, for a person.
using JobName = std::function<std::string(int index)>;

// For jobs to ask: InterruptGuard::Interrupted().
bool IsStopRequested();

struct JobsEnd {
  std::vector<char> started;  // of each job
  bool complete = false;      // all are done
  bool abandoned = false;     // some are at work still, and go on until the process ends
  std::exception_ptr thrown;  // by the first job that has thrown, if any has
};

// Calls job(i) for i = 0..count-1 on `threads` threads, each once, until interrupted. Which jobs are at work
// stands in the progress, and after an interrupt on stderr: then no more are started, and those at work, which should
// ask IsStopRequested(), have 0.7 s to come back before the program goes on without them. What they use must therefore
// not go away; RunMain ends the process without waiting for them. After one has thrown no more are started.
JobsEnd RunJobsOrAbandon(int count, const JobName& name, int threads, Progress* progress, const Job& job);
// Runs jobs with these names. They take seconds and minutes, so that the progress does not estimate the time left.
JobsEnd RunJobsOrAbandon(const std::vector<std::string>& names, int threads, Progress* progress, const Job& job);

// Runs jobs that use data of the caller: if they do not return, the process ends here, with the exit code of a failed
// answer, whatever another job has thrown. Throws what a job has thrown. Returns true if all are done.
bool RunJobs(const std::vector<std::string>& names, int threads, Progress* progress, const Job& job);

template <typename Result>
struct JobResults {
  std::vector<std::optional<Result>> results;  // in the order of jobs, whatever the number of threads
  std::vector<char> started;
  bool complete = false;
};

// Runs jobs with results: compute(i, say, keep) returns one, and may call keep() before with the result that counts if
// it does not return. It must own whatever it uses. Throws what a job has thrown.
template <typename Result>
JobResults<Result> ComputeAll(const std::vector<std::string>& names, int threads, Progress* progress,
                              std::function<Result(int, const SayNote&, const std::function<void(Result)>&)> compute) {
  struct Slots {
    std::mutex mutex;
    bool taken = false;
    std::vector<std::optional<Result>> results;
  };
  const auto slots = std::make_shared<Slots>();
  slots->results.resize(names.size());
  const JobsEnd end =
      RunJobsOrAbandon(names, threads, progress, [slots, compute = std::move(compute)](int i, const SayNote& say) {
        const auto keep = [&](Result result) {
          const std::lock_guard lock(slots->mutex);
          if (!slots->taken) slots->results[i] = std::move(result);
        };
        keep(compute(i, say, keep));
      });
  if (end.thrown) std::rethrow_exception(end.thrown);
  const std::lock_guard lock(slots->mutex);
  slots->taken = true;
  return {std::move(slots->results), end.started, end.complete};
}

}  // namespace saltus
