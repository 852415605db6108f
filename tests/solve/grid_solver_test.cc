// The optimum on a time grid: published values, and that a rollout confirms them.
#include <gmock/gmock.h>

#include "saltus/simulate/exact_run.h"
#include "saltus/solve/solver.h"
#include "test_scenes.h"

namespace saltus {
namespace {

using testing::HasSubstr;

SolveReport SolveOnGrid(const std::string& problem, int steps, const std::string& contact = "event") {
  Scene scene = ProblemScene(problem);
  scene.steps = steps;
  return Solve("grid_optimum", {scene, contact}, {});
}

// Values from 50-digit arithmetic.
TEST(GridOptimumSolver, EqualsReferences) {
  const struct {
    const char* problem;
    int steps;
    double loss;
    const char* node;
  } cases[] = {{"two_balls", 480, 1.39654310059879899, "node 328"},
               {"two_balls", 1000, 1.39654323006339811, "node 683"},
               {"single_collision", 480, 0.311418376820024856, "node 221"},
               {"single_collision", 1000, 0.311417611534206008, "node 461"},
               {"multiple_collisions", 480, 0.373638157781687484, "node 270"},
               {"multiple_collisions", 1000, 0.373636619954344380, "node 562"}};
  for (const auto& [problem, steps, loss, node] : cases) {
    const SolveReport report = SolveOnGrid(problem, steps);
    EXPECT_EQ(report.termination, Termination::kConverged) << report.reason;
    EXPECT_NEAR(report.solution.loss, loss, 1e-9) << problem << steps;
    EXPECT_THAT(report.reason, HasSubstr(node));
    Scene scene = ProblemScene(problem);
    scene.steps = steps;
    const ExactRun exact = SimulateExactly(scene, report.solution.initial_state, report.solution.control);
    ASSERT_TRUE(exact.ok) << exact.reason;
    EXPECT_NEAR(exact.loss, loss, 1e-9);
    EXPECT_EQ(exact.events.size(), std::string(problem) == "multiple_collisions" ? 2u : 1u);
    EXPECT_EQ(report.history.losses.size(), 2u);
    EXPECT_GT(report.guess.loss, report.solution.loss);
  }
}

TEST(GridOptimumSolver, SaysWhyNot) {
  EXPECT_THAT(SolveOnGrid("two_balls", 480, "direct_toi").reason, HasSubstr("exact event-driven dynamics"));
  EXPECT_THAT(SolveOnGrid("ground_wall", 288).reason, HasSubstr("control"));
  Scene scene = ProblemScene("two_balls");
  scene.gravity = {0, -1};
  const SolveReport report = Solve("grid_optimum", {scene, "event"}, {});
  EXPECT_EQ(report.termination, Termination::kNotApplicable);
  EXPECT_THAT(report.reason, HasSubstr("gravity"));
}

}  // namespace
}  // namespace saltus
