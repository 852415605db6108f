// Jobs of the programs on several threads.
#include "programs/parallel.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <chrono>
#include <csignal>
#include <iostream>
#include <stdexcept>
#include <string>
#include <thread>
#include <vector>

#include "base/interrupt.h"
#include "programs/program.h"

namespace saltus {
namespace {

std::vector<std::string> Names(int count) {
  std::vector<std::string> names;
  for (int i = 0; i < count; ++i) names.push_back("job " + std::to_string(i));
  return names;
}

TEST(ComputeAll, ResultsAreInTheOrderOfJobsOnAnyNumberOfThreads) {
  for (const int threads : {1, 2, 4}) {
    Progress progress(ProgressMode::kNone, stderr, "jobs", 200);
    const auto done =
        ComputeAll<std::string>(Names(200), threads, &progress, [](int i, const SayNote& say, const auto& keep) {
          say("at " + std::to_string(i));
          keep("not yet");
          return std::string(static_cast<size_t>(i), 'x');
        });
    EXPECT_TRUE(done.complete);
    EXPECT_EQ(done.started, std::vector<char>(200, 1));
    ASSERT_EQ(done.results.size(), 200u);
    for (size_t i = 0; i < done.results.size(); ++i) EXPECT_EQ(done.results[i], std::string(i, 'x'));
  }
}

TEST(RunJobs, WhatAJobThrowsIsThrownWhenTheOthersAreDone) {
  Progress progress(ProgressMode::kNone, stderr, "jobs", 20);
  const Job job = [](int i, const SayNote&) {
    if (i == 3) throw std::runtime_error("job 3");
  };
  EXPECT_THROW(RunJobs(Names(20), 4, &progress, job), std::runtime_error);
}

// Neither returns to its caller nor unwinds it: jobs that are abandoned use what stands there.
TEST(RunJobs, EndsTheProcessIfOneJobThrowsAndAnotherDoesNotComeBack) {
  GTEST_FLAG_SET(death_test_style, "threadsafe");
  const auto run = [] {
    struct Caller {
      ~Caller() { std::cerr << "unwound" << std::endl; }
    };
    std::signal(SIGINT, SIG_DFL);
    const InterruptGuard guard;
    const Caller caller;
    Progress progress(ProgressMode::kNone, stderr, "jobs", 2);
    RunJobs(Names(2), 2, &progress, [](int i, const SayNote&) {
      if (i == 0) std::this_thread::sleep_for(std::chrono::hours(1));
      raise(SIGINT);
      throw std::runtime_error("job 1");
    });
  };
  EXPECT_EXIT(run(), testing::ExitedWithCode(kAnswerFailed), testing::Not(testing::HasSubstr("unwound")));
}

}  // namespace
}  // namespace saltus
