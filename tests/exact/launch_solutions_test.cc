#include <gtest/gtest.h>

#include "exact/closed_forms.h"
#include "exact/exact_scenes.h"
#include "parameter_name.h"

namespace saltus {
namespace {

using namespace exact_test;

std::string Branch(const LaunchSolution& solution) {
  std::string branch;
  for (const ExactEvent& event : solution.events) branch += (branch.empty() ? "" : "+") + event.b;
  return branch.empty() ? "none" : branch;
}

class LaunchSolutionsTest : public ::testing::TestWithParam<double> {};

// Exactly four, one per branch.
TEST_P(LaunchSolutionsTest, EqualReference) {
  const Scene scene = GroundWall(GetParam());
  const auto& reference = References()["task2"][GetParam() > 0 ? "minima_mu0.1" : "minima_frictionless"];
  const std::vector<LaunchSolution> solutions = FindLaunchSolutions(scene);
  ASSERT_EQ(solutions.size(), reference.size());
  for (const LaunchSolution& solution : solutions) {
    ASSERT_TRUE(reference.contains(Branch(solution))) << Branch(solution);
    const Vec2d expected = Vector(reference[Branch(solution)]);
    EXPECT_LT((solution.velocity - expected).norm(), 1e-12 * expected.norm()) << Branch(solution);
  }
}

TEST_P(LaunchSolutionsTest, HaveZeroLossAndIncreasingSpeed) {
  const Scene scene = GroundWall(GetParam());
  double speed = 0;
  for (const LaunchSolution& solution : FindLaunchSolutions(scene)) {
    Scene launched = scene;
    launched.bodies[0].velocity = solution.velocity;
    const auto form = EvaluateClosedForm(launched);
    ASSERT_TRUE(form);
    EXPECT_LT(form->loss, 1e-26);
    EXPECT_EQ(form->events.size(), solution.events.size());
    EXPECT_GT(solution.velocity.norm(), speed);
    speed = solution.velocity.norm();
  }
  EXPECT_NEAR(FindLaunchSolutions(scene).front().velocity.squaredNorm(), 20.4880444444444, 1e-12);
}

INSTANTIATE_TEST_SUITE_P(Friction, LaunchSolutionsTest, ::testing::Values(0.0, 0.1), ParameterName());

TEST(LaunchSolutionsRefusalTest, OtherProblems) {
  std::string reason_not_applicable;
  EXPECT_TRUE(FindLaunchSolutions(BounceOnce(), 3, &reason_not_applicable).empty());
  EXPECT_EQ(reason_not_applicable, "the objective must be the disc's squared distance to a point");
  EXPECT_TRUE(FindLaunchSolutions(TwoBalls(), 3, &reason_not_applicable).empty());
  EXPECT_EQ(reason_not_applicable, "there must be one moving disc");
}

}  // namespace
}  // namespace saltus
