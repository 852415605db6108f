// Solvers that are told to stop in the middle of an iteration.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <atomic>
#include <cstdint>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "saltus/control/single_shooting.h"
#include "saltus/simulate/registry.h"
#include "saltus/solve/solver.h"
#include "test_scenes.h"

namespace saltus {
namespace {

// True from the question after the first `most` on.
StopRequest StopAfter(int64_t most, std::shared_ptr<std::atomic<int64_t>> asked) {
  return [most, asked = std::move(asked)] { return ++*asked > most; };
}

StopRequest StopAfter(int64_t most) { return StopAfter(most, std::make_shared<std::atomic<int64_t>>(0)); }

constexpr int64_t kMostQuestions = 3'000'000;

double LossAt(const SolveRequest& request, const std::vector<double>& control) {
  SingleShooting shooting(MakeSimulator(request.contact, request.scene, request.precision));
  double loss = std::nan("");
  shooting.Evaluate(control, &loss, nullptr);
  return loss;
}

class InterruptedTest : public testing::TestWithParam<std::string> {
 protected:
  void StopEverywhere(const std::string& contact);
};

TEST_P(InterruptedTest, ReportsTheLastWholeIterateWheneverItIsStopped) {
  for (const std::string contact : {"event", "direct_toi"}) {
    if (contact == "event" || !FindSolver(GetParam())->exact_only) StopEverywhere(contact);
  }
}

void InterruptedTest::StopEverywhere(const std::string& contact) {
  const SolverEntry& solver = *FindSolver(GetParam());
  SolveRequest request{ProblemScene("two_balls"), contact};
  request.scene.steps = 48;
  SolverOptions options;
  options.limits.iterations = 200;  // ceres_shooting then moves its impact along nodes
  options.descent.learning_rate = 10;
  const auto asked = std::make_shared<std::atomic<int64_t>>(0);
  options.monitor.stop = StopAfter(kMostQuestions, asked);
  Solve(solver.name, request, options);
  // Solvers are stopped at the first questions, with growing distances, and at three times as many that are evenly
  // spaced.
  std::vector<int64_t> ends;
  for (int64_t most = 0; most < *asked; most += 1 + most / 2) ends.push_back(most);
  const int64_t num_even = 3 * static_cast<int64_t>(ends.size());
  for (int64_t i = 0; i < num_even; ++i) ends.push_back(*asked * i / num_even);
  int interrupted = 0, with_progress = 0;
  for (const int64_t most : ends) {
    options.monitor.stop = StopAfter(most);
    const SolveReport report = Solve(solver.name, request, options);
    ASSERT_NE(report.termination, Termination::kFailed) << most << ": " << report.reason;
    if (report.termination != Termination::kInterrupted) continue;
    ++interrupted;
    if (report.history.losses.empty()) continue;
    with_progress += report.history.losses.size() > 1;
    EXPECT_EQ(report.guess.loss, report.history.losses.front());
    EXPECT_EQ(report.work.iterations, static_cast<int>(report.history.losses.size()) - 1);
    if (!report.solution.durations.empty()) continue;  // its control has other intervals
    EXPECT_NEAR(LossAt(request, report.solution.control), report.solution.loss, 1e-12 * report.guess.loss) << most;
  }
  EXPECT_GT(interrupted, 3);
  if (GetParam() != "grid_optimum" && GetParam() != "ceres_lm") {
    EXPECT_GT(with_progress, 0);
  }
}

std::vector<std::string> Names() {
  std::vector<std::string> names;
  for (const SolverEntry& solver : AllSolvers()) names.emplace_back(solver.name);
  return names;
}
INSTANTIATE_TEST_SUITE_P(All, InterruptedTest, testing::ValuesIn(Names()), [](const auto& test) { return test.param; });

TEST(Interrupted, SmoothedGradientsStopInTheMiddleOfTheirSamples) {
  SolverOptions options;
  options.descent.learning_rate = 10;
  options.surrogate = Surrogate{.kind = SurrogateKind::kSmoothedZeroth, .sigma = 0.1, .samples = 1'000'000};
  options.threads = 2;
  options.monitor.stop = StopAfter(1000);
  const SolveReport report = Solve("gd", {ProblemScene("two_balls"), "direct"}, options);
  EXPECT_EQ(report.termination, Termination::kInterrupted);
  EXPECT_EQ(report.history.losses.size(), 1u);
}

}  // namespace
}  // namespace saltus
