// Audits where rounding takes digits of the exact gradient: a small disc in a square with a fixed disc in the middle
// (Sinai's billiard), whose exact Lyapunov exponent is 2.2 1/s.
#include <gmock/gmock.h>

#include <cmath>
#include <random>

#include "saltus/audit/audit.h"
#include "saltus/audit/refinement.h"

namespace saltus {
namespace {

using testing::HasSubstr;

constexpr double kExponent = 2.2, kEpsilon = 2.2e-16;

Scene Billiard(double duration, const Vec2d& position, const Vec2d& velocity) {
  Scene scene;
  scene.name = "sinai";
  scene.duration = duration;
  scene.steps = static_cast<int>(30 * duration);
  scene.bodies.resize(2);
  scene.bodies[0] = {.name = "p", .radius = 0.05, .mass = 1};
  scene.bodies[0].position = position;
  scene.bodies[0].velocity = velocity;
  scene.bodies[1] = {.name = "s", .radius = 0.25, .mass = 1, .fixed = true};
  scene.bodies[1].position = {0.5, 0.5};
  scene.planes = {{"l", {0, 0}, {1, 0}}, {"r", {1, 0}, {-1, 0}}, {"b", {0, 0}, {0, 1}}, {"t", {0, 1}, {0, -1}}};
  scene.objective.terminal = {{.body = 0, .target = {0.5, 0.9}}};
  scene.optimize = Optimize::kVelocity;
  scene.free = {0};
  return scene;
}

// The exact model beside itself, from 20 starts near the left wall, at four durations.
TEST(Chaos, TheExactModelIsNeverWrong) {
  std::mt19937 random(7);
  std::uniform_real_distribution<double> height(0.1, 0.9), angle(-1.2, 1.2);
  RefinementOptions options;
  options.levels = 5;
  options.parameters = false;
  int ill_conditioned = 0;  // after 20 s
  for (int start = 0; start < 20; ++start) {
    const double a = angle(random);
    const Vec2d position(0.1, height(random)), velocity(std::cos(a), std::sin(a));
    for (const double duration : {5.0, 10.0, 14.0, 20.0}) {
      const RefinementStudy study = StudyRefinement("event", Billiard(duration, position, velocity), options);
      ASSERT_TRUE(study.ok()) << study.reason;
      EXPECT_TRUE(study.verdict == Verdict::kRight || study.verdict == Verdict::kIllConditioned)
          << start << " " << duration << " " << VerdictToString(study.verdict);
      ill_conditioned += duration == 20 && study.verdict == Verdict::kIllConditioned;
    }
  }
  EXPECT_GE(ill_conditioned, 15);
}

// Rounding grows with the exponent, and the estimate is not far below the errors that are seen.
TEST(Chaos, TheRoundingIsThatOfTheExponent) {
  RefinementOptions options;
  options.parameters = false;
  int measured = 0;
  for (const double duration : {9.0, 10.0, 11.0, 12.0}) {
    const RefinementStudy study = StudyRefinement("event", Billiard(duration, {0.1, 0.2}, {0.8, 0.6}), options);
    if (!study.conditioning) continue;
    ++measured;
    const double expected = kEpsilon * std::exp(kExponent * duration), rounding = study.conditioning->rounding;
    EXPECT_GT(rounding, expected) << duration;
    EXPECT_LT(rounding, 1e6 * expected) << duration;
    EXPECT_LE(study.Find(Quantity::kVelocity)->decisive, 10 * rounding) << duration;
    EXPECT_NEAR(study.conditioning->DigitsLost(), std::log10(rounding / 2.220446049250313e-16), 1e-9);
  }
  EXPECT_GT(measured, 0);
}

TEST(Chaos, NoDigitsAreLeftAfterTwentySeconds) {
  const Scene scene = Billiard(20, {0.1, 0.2}, {0.8, 0.6});
  const ModelAudit audit =
      AuditModel("event", scene, Precision::kDouble, ComputeExactGradient(scene), {.attribution = false});
  EXPECT_EQ(audit.verdict, Verdict::kIllConditioned);
  EXPECT_THAT(audit.VerdictReason(), HasSubstr("16 of 16 digits are lost"));
}

// A model that is wrong remains so where rounding takes a few digits only.
TEST(Chaos, AWrongModelIsWrongWhereDigitsAreLeft) {
  for (const double duration : {2.0, 3.0}) {
    const RefinementStudy study = StudyRefinement("direct", Billiard(duration, {0.1, 0.2}, {0.8, 0.6}));
    EXPECT_TRUE(IsWrong(study.verdict)) << duration << " " << VerdictToString(study.verdict);
  }
}

}  // namespace
}  // namespace saltus
