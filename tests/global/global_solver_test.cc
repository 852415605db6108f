#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>

#include "saltus/solve/solver.h"
#include "saltus/solve/solvers_by_name.h"
#include "test_scenes.h"

namespace saltus {
namespace {

using testing::HasSubstr;

constexpr double kTwoBalls = 1.396542160123;

SolverOptions Limited(double work) {
  SolverOptions options;
  options.limits.iterations = 20;
  options.sequences.limits.work = work;
  options.sequences.limits.starts = 1;
  return options;
}

TEST(GlobalSolver, ProvesTheOptimumOfTwoBalls) {
  const SolveReport report = Solve("global", {ProblemScene("two_balls"), "event"}, Limited(2e6));
  EXPECT_EQ(report.solver, "global");
  EXPECT_EQ(report.termination, Termination::kConverged) << report.reason;
  EXPECT_NEAR(report.solution.loss, kTwoBalls, 1e-8);
  ASSERT_TRUE(report.certificate);
  EXPECT_EQ(report.certificate->verdict, Certificate::Verdict::kGlobal);
  EXPECT_THAT(report.certificate->reason, HasSubstr("no control has a loss below 1.39654"));
  EXPECT_THAT(report.certificate->reason, HasSubstr("excluded: "));
  ASSERT_TRUE(report.searched);
  EXPECT_LE(report.searched->lower_bound, kTwoBalls + 1e-11);
  EXPECT_GE(report.searched->lower_bound, kTwoBalls - 2e-6);
}

// In other units the same is proved.
TEST(GlobalSolver, ProvesItInMillimetres) {
  Scene scene = ProblemScene("two_balls");
  constexpr double kUnit = 1024;
  for (Body& body : scene.bodies) {
    body.radius *= kUnit;
    body.position *= kUnit;
  }
  for (Vec2d& force : scene.control.initial) force *= kUnit;
  scene.objective.effort /= kUnit * kUnit;
  scene.objective.terminal[0].weight /= kUnit * kUnit;
  const SolveReport report = Solve("global", {scene, "event"}, Limited(2e6));
  EXPECT_EQ(report.termination, Termination::kConverged) << report.reason;
  ASSERT_TRUE(report.searched);
  EXPECT_NEAR(report.searched->lower_bound, kTwoBalls, 2e-6);
  EXPECT_LE(report.searched->lower_bound, kTwoBalls + 1e-11);
}

TEST(GlobalSolver, ReportsTheGapThatItsLimitLeaves) {
  const SolveReport report = Solve("global", {ProblemScene("two_balls"), "event"}, Limited(1e4));
  EXPECT_EQ(report.termination, Termination::kIterationLimit);
  EXPECT_THAT(report.reason, HasSubstr("no control has a loss below"));
  EXPECT_THAT(report.reason, HasSubstr("left: striker-target"));
  ASSERT_TRUE(report.searched);
  EXPECT_LT(report.searched->lower_bound, kTwoBalls);
  ASSERT_TRUE(report.certificate);
  EXPECT_NE(report.certificate->verdict, Certificate::Verdict::kGlobal);
}

TEST(GlobalSolver, IsRunOnlyWhereItIsNamed) {
  const auto is_global = [](const SolverEntry& solver) { return solver.name == "global"; };
  EXPECT_EQ(std::ranges::count_if(AllSolvers(), is_global), 0);
  EXPECT_EQ(std::ranges::count_if(SolversByName(), is_global), 1);
  EXPECT_NE(FindSolver("global"), nullptr);
  Scene scene = ProblemScene("two_balls");
  scene.contact.friction = 0.2;
  const SolveReport report = Solve("global", {scene, "event"}, {});
  EXPECT_EQ(report.termination, Termination::kNotApplicable);
  EXPECT_THAT(report.reason, HasSubstr("friction"));
}

}  // namespace
}  // namespace saltus
