// Very many impacts in one step: a light disc between a wall and a heavy disc, all elastic.
//
// With lengths times the square roots of the masses, the two move along a straight line, which is folded into the wedge
// between the wall and the contact of the discs. This gives the motion and the number of impacts in closed form.
#include <gtest/gtest.h>

#include <cmath>
#include <string>

#include "contact/event/event_run.h"
#include "exact/exact_scenes.h"

namespace saltus {
namespace {

using saltus::testing::EventRun;
using saltus::testing::MakeEventSimulator;
using saltus::testing::StartOf;

constexpr double kDuration = 6, kPosition = 3, kVelocity = -1;

Scene Counting(double mass, int steps) {
  Scene scene;
  scene.duration = kDuration;
  scene.steps = steps;
  scene.bodies = {exact_test::Disc("light", 0.1, {1, 0}, {0, 0}),
                  exact_test::Disc("heavy", 0.3, {kPosition, 0}, {kVelocity, 0})};
  scene.bodies[1].mass = mass;
  scene.planes = {{"wall", {0, 0}, {1, 0}}};
  return scene;
}

struct Ending {
  double position = 0;  // of the heavy disc, m
  double impacts = 0;
};
Ending EndOf(double mass, double position = kPosition, double velocity = kVelocity) {
  const double light = 1 - 0.1, heavy = std::sqrt(mass) * (position - 0.5 + kDuration * velocity);
  const double wedge = std::atan(1 / std::sqrt(mass)), angle = std::atan2(light, heavy);
  const double within = std::fmod(angle, 2 * wedge), folded = std::min(within, 2 * wedge - within);
  return {0.5 + std::hypot(light, heavy) * std::cos(folded) / std::sqrt(mass), std::floor(angle / wedge)};
}

TEST(EventCounting, ManyImpactsInOneStepStayElastic) {
  for (const double mass : {1e8, 2279733867.6}) {
    const EventRun run(Counting(mass, 1));
    EXPECT_NEAR(run.End()[4], EndOf(mass).position, 1e-9) << mass;
    EXPECT_NEAR(run.End()[6], -kVelocity, 1e-9) << mass;
    EXPECT_NEAR(static_cast<double>(run.simulator.touches().size()), EndOf(mass).impacts, 1) << mass;
  }
}

TEST(EventCounting, TheirDerivativesAreThoseOfTheClosedForm) {
  for (const double mass : {1e4, 1e6}) {
    EventRun run(Counting(mass, 1));
    const Sensitivity gradient = run.GradientOf(4);
    const double d = 1e-3;
    const double by_position = (EndOf(mass, kPosition + d).position - EndOf(mass, kPosition - d).position) / (2 * d);
    const double by_velocity =
        (EndOf(mass, kPosition, kVelocity + d).position - EndOf(mass, kPosition, kVelocity - d).position) / (2 * d);
    EXPECT_NEAR(gradient.initial[4], by_position, 1e-5) << mass;
    EXPECT_NEAR(gradient.initial[6], by_velocity, 1e-5) << mass;
  }
}

TEST(EventCounting, BeyondTheLimitTheStepFailsAndNamesTheRemedy) {
  const double mass = 1e10;
  ASSERT_GT(EndOf(mass).impacts, 200000);
  const std::unique_ptr<Simulator> simulator = MakeEventSimulator(Counting(mass, 1));
  EXPECT_FALSE(simulator->Rollout(StartOf(simulator->scene()), {}));
  EXPECT_NE(simulator->FailureReason().find("more than 200000 events"), std::string::npos)
      << simulator->FailureReason();
  EXPECT_NE(simulator->FailureReason().find("`steps`"), std::string::npos) << simulator->FailureReason();
  EXPECT_NEAR(EventRun(Counting(mass, 6000)).End()[4], EndOf(mass).position, 1e-8);
}

}  // namespace
}  // namespace saltus
