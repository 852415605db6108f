#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

#include <csignal>
#include <cstdlib>
#include <map>
#include <set>
#include <stdexcept>

#include "sweep/executor.h"

namespace saltus {
namespace {

using namespace std::chrono_literals;
using testing::HasSubstr;

// Returns the result of each task, in any order.
std::map<int64_t, WorkerPool::Result> RunAll(int tasks, WorkerPool* pool) {
  std::map<int64_t, WorkerPool::Result> results;
  for (int next = 0; next < tasks || pool->HasBusy();) {
    while (next < tasks && pool->HasIdle()) pool->Start(next++);
    for (const WorkerPool::Result& result : pool->Wait(10s)) {
      EXPECT_TRUE(results.emplace(result.task, result).second) << result.task << " came back twice";
    }
  }
  return results;
}

// Precondition: the pool is idle.
WorkerPool::Result RunOne(int64_t task, WorkerPool* pool) {
  pool->Start(task);
  std::vector<WorkerPool::Result> results;
  while (results.empty()) results = pool->Wait(10s);
  return results.at(0);
}

TEST(WorkerPool, AnswersEveryTask) {
  WorkerPool pool(3, 0, [](int64_t task) { return std::string(static_cast<size_t>(task) + 1, 'x'); });
  const std::map<int64_t, WorkerPool::Result> results = RunAll(500, &pool);
  ASSERT_EQ(results.size(), 500u);
  for (const auto& [task, result] : results) {
    EXPECT_EQ(result.end, WorkerPool::End::kAnswered);
    EXPECT_EQ(result.text.size(), static_cast<size_t>(task) + 1);
  }
}

TEST(WorkerPool, SaysThatTheSystemHasNoSocketForAWorker) {
  rlimit limit;
  ASSERT_EQ(getrlimit(RLIMIT_NOFILE, &limit), 0);
  const rlimit none = {3, limit.rlim_max};
  ASSERT_EQ(setrlimit(RLIMIT_NOFILE, &none), 0);
  try {
    WorkerPool pool(2, 0, [](int64_t) { return std::string(); });
    ADD_FAILURE() << "it has";
    ASSERT_EQ(setrlimit(RLIMIT_NOFILE, &limit), 0);
  } catch (const std::runtime_error& error) {
    // First of all: UndefinedBehaviorSanitizer opens files to check the type of `error`.
    ASSERT_EQ(setrlimit(RLIMIT_NOFILE, &limit), 0);
    EXPECT_THAT(error.what(), HasSubstr("cannot start a process that computes: Too many open files"));
  }
}

TEST(WorkerPool, ComputesInOtherProcesses) {
  WorkerPool pool(2, 0, [](int64_t) { return std::to_string(getpid()); });
  std::set<std::string> processes;
  for (const auto& [task, result] : RunAll(50, &pool)) processes.insert(result.text);
  EXPECT_FALSE(processes.contains(std::to_string(getpid())));
  EXPECT_LE(processes.size(), 2u);
}

TEST(WorkerPool, ATaskThatCrashesTakesNoOtherWithIt) {
  WorkerPool pool(2, 0, [](int64_t task) {
    if (task == 3) raise(SIGKILL);
    if (task == 7) _exit(5);
    return std::string("fine");
  });
  const std::map<int64_t, WorkerPool::Result> results = RunAll(20, &pool);
  ASSERT_EQ(results.size(), 20u);
  for (const auto& [task, result] : results) {
    EXPECT_EQ(result.end, task == 3 || task == 7 ? WorkerPool::End::kDied : WorkerPool::End::kAnswered) << task;
  }
  EXPECT_THAT(results.at(3).text, HasSubstr("killed by signal 9 (Killed)"));
  EXPECT_THAT(results.at(7).text, HasSubstr("exit code 5"));
}

TEST(WorkerPool, StopsWhatTakesTooLong) {
  WorkerPool pool(2, 0.05, [](int64_t task) {
    while (task == 1) pause();
    return std::string("fine");
  });
  std::map<int64_t, WorkerPool::Result> results = RunAll(6, &pool);
  ASSERT_EQ(results.size(), 6u);
  EXPECT_EQ(results.at(1).end, WorkerPool::End::kTooLate);
  for (auto& [task, result] : results) {
    // On a machine that is busy enough anything is late: then once more.
    while (task != 1 && result.end == WorkerPool::End::kTooLate) result = RunOne(task, &pool);
    if (task != 1) {
      EXPECT_EQ(result.end, WorkerPool::End::kAnswered) << task;
    }
  }
}

TEST(WorkerPool, ReplacesAnIdleWorkerThatWasKilled) {
  WorkerPool pool(1, 0, [](int64_t) { return std::to_string(getpid()); });
  const pid_t first = std::stoi(RunOne(0, &pool).text);
  ASSERT_EQ(kill(first, SIGKILL), 0);
  siginfo_t end;
  ASSERT_EQ(waitid(P_PID, static_cast<id_t>(first), &end, WEXITED | WNOWAIT), 0);  // it is gone; the pool has to see it
  const WorkerPool::Result result = RunOne(0, &pool);
  ASSERT_EQ(result.end, WorkerPool::End::kAnswered) << result.text;
  EXPECT_NE(result.text, std::to_string(first));
}

TEST(WorkerPool, WaitEndsWithItsTime) {
  WorkerPool pool(1, 0, [](int64_t) {
    while (true) pause();
    return std::string();
  });
  pool.Start(0);
  EXPECT_TRUE(pool.Wait(1ms).empty());
  EXPECT_TRUE(pool.HasBusy());
}  // and the worker with the object

}  // namespace
}  // namespace saltus
