// Runs from an initial guess that does not meet the constraints: its loss is no yardstick for the answer.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <limits>

#include "saltus/simulate/exact_run.h"
#include "saltus/solve/solver.h"
#include "test_scenes.h"

namespace saltus {
namespace {

// One disc strikes another, which falls meanwhile and shall end at a place. Without a force the loss is 0, and the
// second disc ends elsewhere.
Scene HardFromRest() {
  Scene scene;
  scene.name = "hard_from_rest";
  scene.duration = 1;
  scene.steps = 50;
  scene.gravity = {0, -1};
  scene.bodies = {{.name = "a", .radius = 0.1, .mass = 1, .position = {0, 1}, .velocity = {1, 0}},
                  {.name = "b", .radius = 0.1, .mass = 1, .position = {0.5, 1}}};
  scene.planes = {{.name = "ground", .point = {0, 0}, .normal = {0, 1}}};
  scene.contact.restitution = 0.9;
  scene.control = {{0}, {{0, 0}}};
  scene.objective.terminal = {{.body = 1, .target = {1, 0.6}, .hard = true}};
  scene.objective.effort = 0.1;
  scene.optimize = Optimize::kControl;
  return scene;
}

double LossFromRest(const Scene& scene) {
  return SimulateExactly(scene, InitialState(scene), InitialControl(scene, scene.steps)).loss;
}

TEST(InfeasibleGuess, AnAnswerThatMeetsTheConstraintsIsBetterThanItsGuess) {
  const Scene scene = HardFromRest();
  EXPECT_EQ(LossFromRest(scene), 0);
  for (const char* solver : {"ceres_phases", "mode_search"}) {
    const SolveReport report = Solve(solver, {scene, "event"}, {});
    ASSERT_EQ(report.termination, Termination::kConverged) << solver << ": " << report.reason;
    const ExactRun run =
        SimulateExactly(scene, report.solution.initial_state, report.solution.control, report.solution.durations);
    ASSERT_TRUE(run.ok) << run.reason;
    EXPECT_NEAR(run.end[4], 1, 1e-7) << solver;
    EXPECT_NEAR(run.end[5], 0.6, 1e-7) << solver;
    EXPECT_GT(report.solution.loss, report.guess.loss) << solver;
    EXPECT_GT(report.guess.violation, 1e-3) << solver;
    EXPECT_LE(report.solution.violation, kFeasible) << solver;
    EXPECT_FALSE(EndsWorse(report)) << solver;
  }
}

// With a force beyond its bound the guess has a loss that no control within the bound has.
TEST(InfeasibleGuess, AForceBeyondItsBoundIsAViolation) {
  Scene scene = ProblemScene("two_balls");
  scene.steps = 60;
  const SolveReport free = Solve("ceres_phases", {scene, "event"}, {});
  ASSERT_EQ(free.termination, Termination::kConverged) << free.reason;
  double largest = 0;
  for (const double force : free.solution.control) largest = std::max(largest, std::abs(force));
  scene.control.max = {0.9 * largest};
  SolverOptions options;
  options.guess = ControlGuess{free.solution.control, free.solution.durations};
  const SolveReport bounded = Solve("ceres_phases", {scene, "event"}, options);
  ASSERT_EQ(bounded.termination, Termination::kConverged) << bounded.reason;
  EXPECT_GT(bounded.solution.loss, bounded.guess.loss);
  EXPECT_GT(bounded.guess.violation, 0);
  EXPECT_EQ(bounded.solution.violation, 0);
  EXPECT_FALSE(EndsWorse(bounded));
}

// Violation first, then loss.
TEST(InfeasibleGuess, RunsAreComparedByViolationAndThenByLoss) {
  const double inf = std::numeric_limits<double>::infinity(), rounding = 0.5 * kFeasible;
  const struct {
    double violation_before, violation_after, loss_before, loss_after;
    bool worse;
  } cases[] = {
      {0, 0, 1, 0.5, false},
      {0, 0, 0.5, 1, true},
      {0, 0, 1, 1 + 1e-12, false},
      {0.1, 0, 0, 1, false},
      {0, 0.1, 1, 0, true},
      {0.1, 0.2, 1, 0, true},
      {0.2, 0.1, 0, 1, false},
      {inf, 0, 0, 1, false},
      {0, inf, 1, 0, true},
      {rounding, 0, 1, 0.5, false},
      {0, rounding, 1, 0.5, false},
      {rounding, 0, 0.5, 1, true},
      {inf, inf, 1, 0.5, false},
      {inf, inf, 0.5, 1, true},
  };
  for (const auto& [before, after, loss_before, loss_after, worse] : cases) {
    SolveReport report;
    report.guess.violation = before;
    report.solution.violation = after;
    report.guess.loss = loss_before;
    report.solution.loss = loss_after;
    EXPECT_EQ(EndsWorse(report), worse) << before << " " << after << " " << loss_before << " " << loss_after;
  }
}

// Without constraints there is no violation, whatever the motion does.
TEST(InfeasibleGuess, WithoutConstraintsLossesAloneAreCompared) {
  const SolveReport report = Solve("mode_search", {ProblemScene("two_balls"), "event"}, {});
  EXPECT_EQ(report.guess.violation, 0);
  EXPECT_EQ(report.solution.violation, 0);
  EXPECT_LT(report.solution.loss, report.guess.loss);
}

}  // namespace
}  // namespace saltus
