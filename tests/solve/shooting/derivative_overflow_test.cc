// Derivatives of a step with so many impacts that they overflow: a light disc between a wall and a heavy disc.
#include <gmock/gmock.h>

#include <cmath>

#include "exact/exact_scenes.h"
#include "saltus/control/single_shooting.h"
#include "saltus/solve/solver.h"

namespace saltus {
namespace {

using testing::HasSubstr;

constexpr double kMass = 1e8, kDuration = 6, kTarget = 3;

// 31415 impacts.
Scene Counting(int steps) {
  Scene scene;
  scene.duration = kDuration;
  scene.steps = steps;
  scene.bodies = {exact_test::Disc("light", 0.1, {1, 0}, {0, 0}), exact_test::Disc("heavy", 0.3, {3, 0}, {-1, 0})};
  scene.bodies[1].mass = kMass;
  scene.planes = {{"wall", {0, 0}, {1, 0}}};
  TerminalTerm term;
  term.body = 1;
  term.target = {kTarget, 0};
  scene.objective.terminal = {term};
  scene.optimize = Optimize::kVelocity;
  scene.free = {1};
  return scene;
}

// Where the heavy disc ends: with lengths times the square roots of the masses, the two discs move along a straight
// line, which is folded into the wedge between the wall and the contact of the discs.
double EndOf(double velocity) {
  const double light = 1 - 0.1, heavy = std::sqrt(kMass) * (3 - 0.5 + kDuration * velocity);
  const double wedge = std::atan(1 / std::sqrt(kMass)), angle = std::atan2(light, heavy);
  const double within = std::fmod(angle, 2 * wedge), folded = std::min(within, 2 * wedge - within);
  return 0.5 + std::hypot(light, heavy) * std::cos(folded) / std::sqrt(kMass);
}

// The velocity across is multiplied at each impact with the curved disc.
TEST(DerivativeOverflow, NamesTheStepAndTheRemedy) {
  for (const char* solver : {"gd", "ceres_lm", "ceres_lbfgs"}) {
    const SolveReport report = Solve(solver, {Counting(1), "event"}, {.limits = {.iterations = 2}});
    EXPECT_EQ(report.termination, Termination::kFailed) << solver;
    EXPECT_THAT(report.reason, HasSubstr("step 0 of event: the derivatives of a state overflow, as 31415 contacts"))
        << solver;
    EXPECT_THAT(report.reason, HasSubstr("use more `steps`")) << solver;
  }
}

TEST(DerivativeOverflow, MoreStepsHaveTheDerivative) {
  SingleShooting shooting(MakeSimulator("event", Counting(12), Precision::kDouble));
  double loss = 0, gradient[2];
  ASSERT_TRUE(shooting.Evaluate(shooting.initial_guess(), &loss, gradient));
  EXPECT_EQ(shooting.FailureReason(), "");
  const double by_velocity = (EndOf(-1 + 1e-6) - EndOf(-1 - 1e-6)) / 2e-6;
  EXPECT_NEAR(gradient[0], 2 * (EndOf(-1) - kTarget) * by_velocity, 1e-2);
  EXPECT_NEAR(by_velocity, -6, 0.01);
}

}  // namespace
}  // namespace saltus
