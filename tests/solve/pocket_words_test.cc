// The message of a run that ends with a disc in a pocket: the loss has no slope there, whether or not it is the least.
#include <gmock/gmock.h>

#include "saltus/solve/solver.h"

namespace saltus {
namespace {

using testing::HasSubstr;
using testing::Not;

// A ball that rolls towards a pocket, or past it.
Scene TowardsAPocket(const Vec2d& velocity) {
  Scene scene;
  scene.name = "pocket";
  scene.duration = 1;
  scene.steps = 50;
  scene.bodies = {{.name = "ball", .radius = 0.1, .mass = 1, .position = {0, 0}, .velocity = velocity}};
  scene.pockets = {{"corner", {1, 0}, 0.2}};
  scene.objective.terminal = {{.body = 0, .target = {1, 0}, .weight = 1}};
  scene.optimize = Optimize::kVelocity;
  scene.free = {0};
  return scene;
}

TEST(PocketWords, SayWhichDiscLiesInWhichPocket) {
  for (const char* solver : {"ceres_lbfgs", "ceres_lm", "gd"}) {
    SolverOptions options;
    options.limits.iterations = 20;
    const SolveReport in = Solve(solver, {TowardsAPocket({2, 0.1}), "event"}, options);
    ASSERT_EQ(in.termination, Termination::kConverged) << solver << ": " << in.reason;
    EXPECT_THAT(in.reason, HasSubstr("ball lies in the pocket corner, where the loss has no slope")) << solver;
  }
}

TEST(PocketWords, AreNotSaidOfADiscThatIsInNone) {
  // The target is off the pocket, at which the free flight ends exactly.
  Scene scene = TowardsAPocket({-0.5, 0});
  scene.objective.terminal[0].target = {-1, 0.5};
  const SolveReport report = Solve("ceres_lm", {scene, "event"}, {});
  ASSERT_EQ(report.termination, Termination::kConverged) << report.reason;
  EXPECT_THAT(report.reason, Not(HasSubstr("pocket")));
}

}  // namespace
}  // namespace saltus
