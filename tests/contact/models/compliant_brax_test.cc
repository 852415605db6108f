#include "contact/models/compliant_brax.h"

#include <gtest/gtest.h>

#include "contact/one_step.h"
#include "saltus/control/single_shooting.h"
#include "test_scenes.h"

namespace saltus {
namespace {

using contact_test::DiscScene;
using contact_test::OneStep;

constexpr double kTolerance = 1e-14;
const Plane kGround = {"ground", {0, 0}, {0, 1}};
const Plane kWall = {"wall", {0, 0}, {1, 0}};

// The released implementation computes in single precision; with friction its loss shows that.
TEST(CompliantBrax, LossInSinglePrecision) {
  Scene scene = ProblemScene("ground_wall");
  scene.contact.friction = 0.1;
  double loss;
  for (const auto& [precision, expected] : {std::pair(Precision::kFloat, 8.901242), {Precision::kDouble, 8.901251}}) {
    SingleShooting shooting(MakeSimulator("compliant_brax", scene, precision));
    ASSERT_TRUE(shooting.Evaluate(shooting.initial_guess(), &loss, nullptr));
    EXPECT_NEAR(loss, expected, 6e-7);
  }
}

// With n1 the integrator step of the hit: d/dv = h (2 n1 - N), d/du_0 = h^2 (4 n1 - 2 N - 3).
TEST(CompliantBrax, ClosedFormOfOneBounce) {
  Scene scene = ProblemScene("bounce_once");
  scene.bodies[0].position[1] = 1.001;
  SingleShooting shooting(MakeSimulator("compliant_brax", scene, Precision::kDouble));
  double loss;
  Sensitivity gradient;
  ASSERT_TRUE(shooting.EvaluateAll({}, &loss, &gradient));
  const double h = 1.0 / 480;
  EXPECT_NEAR(gradient.initial[1], 1, 1e-7);
  EXPECT_NEAR(gradient.initial[3], h * (2 * 217 - 480), 1e-7);
  EXPECT_NEAR(gradient.control[1], h * h * (4 * 217 - 2 * 480 - 3), 1e-9);
}

TEST(CompliantBrax, OddNumberOfStepsIsRefused) {
  Scene scene = ProblemScene("bounce_once");
  scene.steps = 481;
  EXPECT_FALSE(ReasonNotApplicable("compliant_brax", scene).empty());
}

// A spinning disc of mass 2 strikes the ground and slips: the friction is mu^2 of the impulse.
TEST(CompliantBrax, SlipChangesSpin) {
  Scene scene =
      DiscScene({{.name = "a", .radius = 0.1, .mass = 2, .position = {0, 0.0999}, .velocity = {2, -1}}}, {kGround});
  scene.contact.restitution = 0.5;
  scene.contact.friction = 0.6;
  OneStep step("compliant_brax", scene);
  step.start(0, 4) = 3;
  step.Run();
  const double count = 1 + 1e-8;
  const double normal = (1 + 0.25) * 2;  // impulse
  const double slip = 2 - 3 * 0.1;       // m/s: the point of contact moves by (w r_y, -w r_x)
  const double friction = 0.36 * normal * slip / (slip + 1e-6);
  EXPECT_NEAR(step.after(0, 2), 2 - friction / 2 / count, kTolerance);
  EXPECT_NEAR(step.after(0, 3), -1 + normal / 2 / count, kTolerance);
  EXPECT_NEAR(step.after(0, 4), 3 + 0.1 * friction / count, kTolerance);
  const double h = step.h() / 2;
  EXPECT_NEAR(step.after(0, 0), h * 2 + h * step.after(0, 2), kTolerance);
  EXPECT_NEAR(step.after(0, 1), 0.0999 - h + h * step.after(0, 3), kTolerance);
  ASSERT_EQ(step.touches().size(), 1u);
  EXPECT_EQ(step.touches()[0].mode, ContactMode::kSlip);
  step.ExpectDerivative({0, 1, 2, 3, 4}, {0, 1, 2, 3, 4, 5, 6}, 1e-6, 1e-8);
}

// Friction never takes more than the tangential momentum, and nothing up to 0.01 m/s.
TEST(CompliantBrax, StickAndSlowSlip) {
  for (const double speed : {0.009, 0.011}) {
    Scene scene = DiscScene({{.name = "a", .radius = 0.1, .mass = 2, .position = {0, 0.0999}, .velocity = {speed, -1}}},
                            {kGround});
    scene.contact.friction = 0.6;
    OneStep step("compliant_brax", scene);
    step.Run();
    const double stopped = speed > 0.01 ? speed * speed / (speed + 1e-6) / (1 + 1e-8) : 0;
    EXPECT_NEAR(step.after(0, 2), speed - stopped, kTolerance);
    EXPECT_NEAR(step.after(0, 4), 0.1 * 2 * stopped, kTolerance);
    ASSERT_EQ(step.touches().size(), 1u);
    EXPECT_EQ(step.touches()[0].mode, ContactMode::kStick);
  }
}

// Two contacts at once are averaged: each takes away half of what it would alone.
TEST(CompliantBrax, TwoContactsAreAveraged) {
  const Scene scene = DiscScene(
      {{.name = "a", .radius = 0.1, .mass = 3, .position = {0.0995, 0.0995}, .velocity = {-1, -2}}}, {kGround, kWall});
  OneStep step("compliant_brax", scene);
  step.Run();
  // Restitution 1 averaged leaves the disc at rest up to the regulariser, and the next half finds no approach.
  const double halved = 2 / (2 + 1e-8);
  double vx = -1 + halved, vy = -2 + 2 * halved;
  ASSERT_LT(vx, 0);
  vx += -2 * vx / (2 + 1e-8);
  vy += -2 * vy / (2 + 1e-8);
  EXPECT_NEAR(step.after(0, 2), vx, kTolerance);
  EXPECT_NEAR(step.after(0, 3), vy, kTolerance);
  EXPECT_EQ(step.touches().size(), 2u);
}

TEST(CompliantBrax, UnequalMasses) {
  Scene scene =
      DiscScene({{.name = "a", .radius = 0.2, .mass = 3, .position = {0, 0}, .velocity = {1, 0.5}},
                 {.name = "b", .radius = 0.1, .mass = 0.5, .position = {0.239, 0.179}, .velocity = {-1, 0.2}}});
  scene.contact.restitution = 0.8;
  scene.contact.friction = 0.3;
  OneStep step("compliant_brax", scene);
  step.start(0, 4) = 2;
  step.start(1, 4) = -5;
  step.Run();
  for (int j : {2, 3}) {
    EXPECT_NEAR(3 * step.after(0, j) + 0.5 * step.after(1, j), 3 * step.start(0, j) + 0.5 * step.start(1, j), 1e-13);
  }
  const double h = step.h() / 2;
  const Vec2d apart = Vec2d(-0.239, -0.179) + h * Vec2d(2, 0.3);
  const Vec2d n = apart.normalized();
  const double before = n.dot(Vec2d(2, 0.3));
  const double after = n.dot(Vec2d(step.after(0, 2) - step.after(1, 2), step.after(0, 3) - step.after(1, 3)));
  EXPECT_NEAR(after, -0.64 * before, 1e-4);  // up to the spin's share, as the middle of the centres is not on the rims
  step.ExpectDerivative({0, 1, 2, 3, 4}, {0, 1, 2, 3, 4, 5, 6}, 1e-6, 1e-7);
}

TEST(CompliantBrax, FixedDiscIsAnInfiniteMass) {
  Scene scene = DiscScene({{.name = "post", .radius = 0.2, .fixed = true, .position = {0, 0}},
                           {.name = "b", .radius = 0.1, .mass = 0.5, .position = {0, 0.2999}, .velocity = {0, -1}}});
  scene.contact.restitution = 0.5;
  OneStep step("compliant_brax", scene);
  step.Run();
  const double h = step.h() / 2;
  const double distance = 0.2999 - h;
  const double n = distance / (distance + 1e-6);
  EXPECT_NEAR(step.after(1, 3), -1 + 1.25 * n * n / (1 + 1e-8), kTolerance);
  for (int j = 0; j < 5; ++j) EXPECT_EQ(step.after(0, j), 0);
}

// A disc hit in the first half of a step hits the next one in the second half.
TEST(CompliantBrax, ImpactIsPassedOnWithinAStep) {
  OneStep step("compliant_brax",
               DiscScene({{.name = "a", .radius = 0.1, .position = {0, 0}, .velocity = {4, 0}},
                          {.name = "b", .radius = 0.1, .position = {0.201, 0}},
                          {.name = "c", .radius = 0.1, .position = {0.402, 0}}}));
  step.Run();
  EXPECT_NEAR(step.after(0, 2), 0, 1e-4);
  EXPECT_NEAR(step.after(1, 2), 0, 1e-4);
  EXPECT_NEAR(step.after(2, 2), 4, 1e-4);
  step.ExpectDerivative({0, 1, 2, 3, 4}, {0, 1, 2, 3, 4, 5, 6}, 1e-6, 1e-7);
}

}  // namespace
}  // namespace saltus
