// Gradient descent against published results and a recurrence by hand.
#include <gmock/gmock.h>

#include <algorithm>
#include <cmath>
#include <memory>

#include "saltus/control/objective.h"
#include "saltus/simulate/registry.h"
#include "saltus/solve/solver.h"
#include "test_scenes.h"

namespace saltus {
namespace {

using testing::HasSubstr;

// One disc at rest; its initial position is free, so the loss is quadratic in it.
Scene FlightScene() {
  Scene scene;
  scene.name = "flight";
  scene.duration = 1;
  scene.steps = 10;
  Body body;
  body.name = "ball";
  body.radius = 0.1;
  scene.bodies = {body};
  TerminalTerm term;
  term.target = {1, -2};
  term.weight = 3;
  scene.objective.terminal = {term};
  scene.optimize = Optimize::kPosition;
  scene.free = {0};
  return scene;
}

TEST(GradientDescent, ReachesPublishedLossOfTwoBalls) {
  const SolveReport report = Solve("gd", {ProblemScene("two_balls"), "direct_toi"}, {.descent = {.learning_rate = 10}});
  ASSERT_EQ(report.history.losses.size(), 1001u);
  EXPECT_NEAR(report.history.losses[0], 2.0585, 5e-5);
  EXPECT_NEAR(report.history.losses[999], 1.39581298828, 1e-5);
  EXPECT_EQ(report.solution.loss, report.history.losses[1000]);
  EXPECT_EQ(report.work.evaluations, 1000);
  EXPECT_EQ(report.work.iterations, 1000);
  EXPECT_EQ(report.termination, Termination::kIterationLimit);
}

TEST(GradientDescent, ReachesPublishedVelocityOfGroundWall) {
  const SolveReport report =
      Solve("gd", {ProblemScene("ground_wall"), "direct_toi"}, {.descent = {.learning_rate = 0.01}});
  EXPECT_NEAR(report.solution.initial_state[2], 10.18414593, 1e-6);
  EXPECT_NEAR(report.solution.initial_state[3], -4.16055489, 1e-6);
}

// loss = 3 |p - target|^2, so z <- z - 6 rate (z - target), in the arithmetic asked for.
TEST(GradientDescent, UpdatesInTheArithmeticAskedFor) {
  const SolverOptions options{.limits = {.iterations = 7}, .descent = {.learning_rate = 0.037}};
  const SolveReport wide = Solve("gd", {FlightScene(), "direct_toi"}, options);
  const SolveReport narrow = Solve("gd", {FlightScene(), "direct_toi", Precision::kFloat}, options);
  double z = 0;
  float zf = 0;
  for (int k = 0; k < 7; ++k) {
    z -= 0.037 * 6 * (z - 1);
    zf -= 0.037f * static_cast<float>(6.0 * (static_cast<double>(zf) - 1));
  }
  EXPECT_NEAR(wide.solution.initial_state[0], z, 1e-15);
  EXPECT_EQ(narrow.solution.initial_state[0], zf);
  EXPECT_NE(narrow.solution.initial_state[0], z);
}

// One iteration is the same function of time, whatever the step.
TEST(GradientDescent, RatePerUnitOfTimeDoesNotDependOnTheStep) {
  Scene scene = ProblemScene("two_balls");
  SolverOptions options{.limits = {.iterations = 1}, .descent = {.learning_rate = 10.0 / 480}};
  options.descent.rate_per_time = true;
  std::vector<SolveReport> reports;
  for (int steps : {480, 960}) {
    scene.steps = steps;
    reports.push_back(Solve("gd", {scene, "event"}, options));
    EXPECT_EQ(reports.back().work.evaluations, 1);
  }
  for (int k = 0; k < 480; k += 60) {
    EXPECT_NEAR(reports[0].solution.control[2 * k], reports[1].solution.control[4 * k], 2e-3) << k;
  }
  // At the paper's number of steps it is the paper's rate.
  scene.steps = 480;
  const SolveReport published =
      Solve("gd", {scene, "event"}, {.limits = {.iterations = 1}, .descent = {.learning_rate = 10}});
  for (size_t i = 0; i < published.solution.control.size(); ++i) {
    EXPECT_NEAR(published.solution.control[i], reports[0].solution.control[i], 1e-13);
  }
}

TEST(GradientDescent, TakesARatePerUnitOfTimeForControlsOnly) {
  SolverOptions options;
  options.descent.rate_per_time = true;
  const SolveReport report = Solve("gd", {FlightScene(), "event"}, options);
  EXPECT_EQ(report.termination, Termination::kNotApplicable);
  EXPECT_THAT(report.reason, HasSubstr("rate_per_time"));
}

TEST(GradientDescent, ConvergedOnlyWhereNothingMovesAnyMore) {
  const SolveRequest request{FlightScene(), "direct_toi"};
  EXPECT_EQ(Solve("gd", request, {.limits = {.iterations = 5}, .descent = {.learning_rate = 0.1}}).termination,
            Termination::kIterationLimit);
  EXPECT_EQ(Solve("gd", request, {.limits = {.iterations = 500}, .descent = {.learning_rate = 0.1}}).termination,
            Termination::kConverged);
}

// With so large a rate it jumps about.
TEST(GradientDescent, ReportsTheBestIterateToo) {
  const Scene scene = ProblemScene("two_balls");
  const SolveReport report =
      Solve("gd", {scene, "direct_toi"}, {.limits = {.iterations = 60}, .descent = {.learning_rate = 4000}});
  const auto least = std::min_element(report.history.losses.begin(), report.history.losses.end());
  ASSERT_TRUE(report.history.best);
  EXPECT_EQ(report.history.best->solution.loss, *least);
  EXPECT_EQ(report.history.best->iteration, least - report.history.losses.begin());
  ASSERT_LT(0, report.history.best->iteration);
  ASSERT_LT(report.history.best->iteration, report.work.iterations);
  const std::unique_ptr<Simulator> simulator = MakeSimulator("direct_toi", scene, Precision::kDouble);
  ASSERT_TRUE(simulator->Rollout(report.history.best->solution.initial_state, report.history.best->solution.control));
  std::vector<double> end(simulator->state_size());
  simulator->GetState(simulator->num_steps(), end);
  EXPECT_NEAR(TerminalLoss(scene.objective, end, simulator->body_size()) +
                  EffortLoss(scene.objective, report.history.best->solution.control, simulator->step()),
              *least,
              1e-12 * *least);
}

TEST(GradientDescent, StopsWhenTold) {
  int calls = 0;
  SolverOptions options{.limits = {.iterations = 20}, .descent = {.learning_rate = 0.1}};
  options.monitor.callback = [&](int iteration, double loss) {
    EXPECT_EQ(iteration, calls++);
    EXPECT_GT(loss, 0);
    return iteration < 3;
  };
  const SolveReport report = Solve("gd", {FlightScene(), "direct_toi"}, options);
  EXPECT_EQ(report.termination, Termination::kInterrupted);
  EXPECT_EQ(report.history.losses.size(), 4u);
  EXPECT_NEAR(report.solution.initial_state[0], 1 - std::pow(1 - 0.6, 3), 1e-15);
}

TEST(GradientDescent, FailsAtTheLastFiniteIterate) {
  Scene velocity = FlightScene();  // may be anything
  velocity.optimize = Optimize::kVelocity;
  // A position so far away that numbers are rounded too much there is refused.
  for (const auto& [scene, rate] : {std::pair{velocity, 1e60}, std::pair{FlightScene(), 100.0}}) {
    const SolveReport report = Solve("gd", {scene, "direct_toi"}, {.descent = {.learning_rate = rate}});
    EXPECT_EQ(report.termination, Termination::kFailed);
    EXPECT_THAT(report.reason, HasSubstr("iteration " + std::to_string(report.history.losses.size())));
    EXPECT_TRUE(std::isfinite(report.solution.loss));
    EXPECT_GT(report.history.losses.size(), 1u);
    for (double value : report.solution.initial_state) EXPECT_TRUE(std::isfinite(value));
  }
}

TEST(Solve, SaysWhyNot) {
  const SolveReport report = Solve("gd", {ProblemScene("bounce_once"), "direct_toi"}, {});
  EXPECT_EQ(report.termination, Termination::kNotApplicable);
  EXPECT_THAT(report.reason, HasSubstr("nothing to optimize"));
  EXPECT_TRUE(report.history.losses.empty());
}

TEST(Solve, EverySolverIsFoundByItsName) {
  for (const SolverEntry& solver : AllSolvers()) EXPECT_EQ(FindSolver(solver.name), &solver);
  EXPECT_EQ(FindSolver("newton"), nullptr);
}

}  // namespace
}  // namespace saltus
