#include "contact/models/pbd_brax.h"

#include <gtest/gtest.h>

#include "contact/one_step.h"
#include "saltus/control/single_shooting.h"
#include "test_scenes.h"

namespace saltus {
namespace {

using contact_test::DiscScene;
using contact_test::OneStep;

constexpr double kEps = 1e-6;
const Plane kGround = {"ground", {0, 0}, {0, 1}};
const Plane kWall = {"wall", {0, 0}, {1, 0}};

struct Evaluation {
  double loss;
  Sensitivity gradient;
};
Evaluation EvaluateScene(const Scene& scene, Precision precision) {
  SingleShooting shooting(MakeSimulator("pbd_brax", scene, precision));
  Evaluation result;
  EXPECT_TRUE(shooting.EvaluateAll(shooting.initial_guess(), &result.loss, &result.gradient));
  return result;
}

TEST(PbdBrax, LossInSinglePrecision) {
  EXPECT_NEAR(EvaluateScene(ProblemScene("bounce_once"), Precision::kFloat).loss, 1.191653, 6e-7);
  EXPECT_NEAR(EvaluateScene(ProblemScene("two_balls"), Precision::kFloat).loss, 2.0606112, 6e-7);
  Scene scene = ProblemScene("ground_wall");
  EXPECT_NEAR(EvaluateScene(scene, Precision::kFloat).loss, 8.678955, 1.5e-6);
  scene.contact.friction = 0.1;
  EXPECT_NEAR(EvaluateScene(scene, Precision::kFloat).loss, 8.710405, 6e-7);
}

// Compares these quantities in double with an independent implementation.
TEST(PbdBrax, DoublePrecision) {
  const Evaluation balls = EvaluateScene(ProblemScene("two_balls"), Precision::kDouble);
  EXPECT_NEAR(balls.loss, 2.05762876, 6e-9);
  EXPECT_NEAR(balls.gradient.initial[0], -0.359248, 6e-7);
  EXPECT_NEAR(balls.gradient.initial[4], -0.358567, 6e-7);
  EXPECT_NEAR(balls.gradient.initial[2], -0.469804, 6e-7);
  EXPECT_NEAR(balls.gradient.initial[6], -0.248010, 6e-7);
  EXPECT_NEAR(balls.gradient.control[0], 0.00054404, 6e-9);
  Scene scene = ProblemScene("ground_wall");
  const Evaluation smooth = EvaluateScene(scene, Precision::kDouble);
  EXPECT_NEAR(smooth.loss, 8.67895693, 6e-9);
  EXPECT_NEAR(smooth.gradient.initial[2], -0.831188, 6e-7);
  EXPECT_NEAR(smooth.gradient.initial[3], -0.066429, 6e-7);
  scene.contact.friction = 0.1;
  const Evaluation rough = EvaluateScene(scene, Precision::kDouble);
  EXPECT_NEAR(rough.loss, 8.710288, 6e-7);
  EXPECT_NEAR(rough.gradient.initial[2], -0.862287, 6e-7);
  EXPECT_NEAR(rough.gradient.initial[3], -0.382626, 6e-7);
  EXPECT_NEAR(rough.gradient.initial[1], -2.008, 1e-3);
}

// The regularisers are all that is left of the derivative by the initial height.
TEST(PbdBrax, RegularisersInOneBounce) {
  Scene scene = ProblemScene("bounce_once");
  scene.bodies[0].position[1] = 1.001;
  const Sensitivity away = EvaluateScene(scene, Precision::kDouble).gradient;
  EXPECT_NEAR(away.initial[1], -0.000521999, 6e-10);
  EXPECT_NEAR(away.initial[3], -0.546068, 6e-7);
  EXPECT_NEAR(away.control[1], -0.00227528, 6e-9);
  scene.bodies[0].position[1] = 1 + 8.7e-7;
  const Sensitivity near = EvaluateScene(scene, Precision::kDouble).gradient;
  EXPECT_NEAR(near.initial[1], -0.00196, 6e-6);
  EXPECT_NEAR(near.initial[3], -0.54672, 6e-6);
  EXPECT_NEAR(near.control[1], -0.0022780, 6e-8);
}

TEST(PbdBrax, OddNumberOfStepsIsRefused) {
  Scene scene = ProblemScene("bounce_once");
  scene.steps = 481;
  EXPECT_FALSE(ReasonNotApplicable("pbd_brax", scene).empty());
}

// Each integrator step turns q by the angle atan(h w / 2) and finds the spin 2 sin of it / h.
TEST(PbdBrax, FreeRotation) {
  OneStep step("pbd_brax", DiscScene({{.name = "a", .radius = 0.1}}));
  step.start(0, 4) = 50;
  step.start(0, 5) = std::cos(0.3);
  step.start(0, 6) = std::sin(0.3);
  step.Run();
  const double h = step.h() / 2;
  const double first = std::atan(h * 50 / 2);
  const double spin = 2 * std::sin(first) / h;
  const double second = std::atan(h * spin / 2);
  EXPECT_NEAR(step.after(0, 4), 2 * std::sin(second) / h, 1e-12);
  EXPECT_NEAR(step.after(0, 5), std::cos(0.3 + first + second), 1e-15);
  EXPECT_NEAR(step.after(0, 6), std::sin(0.3 + first + second), 1e-15);
  step.ExpectDerivative({4, 5, 6}, {4, 5, 6}, 1e-6, 1e-7);
}

// One frictionless hit of a disc of mass m, every regulariser written out.
TEST(PbdBrax, BounceStepWithRegularisers) {
  const double m = 1e-3, e = 0.64;  // light, so that the regulariser of lambda and that of P differ from one another
  Scene scene =
      DiscScene({{.name = "a", .radius = 0.1, .mass = m, .position = {0, 0.1}, .velocity = {0, -2}}}, {kGround});
  scene.contact.restitution = 0.8;
  OneStep step("pbd_brax", scene);
  step.Run();
  const double h = step.h() / 2;
  const double depth = 2 * h * 2;
  const double old = 0.1 - 2 * h;
  const double raised = 0.1 - depth + depth / (1 / m + kEps) / m / (1 + kEps);
  const double after = (raised - old) / h;
  const double s = -after + e * 2;
  const double impulse = s * std::abs(s) / (std::abs(s) + kEps) / (1 / m + kEps);
  EXPECT_NEAR(step.after(0, 1), raised, 1e-16);
  EXPECT_NEAR(step.after(0, 3), after + impulse / m / (1 + kEps), 1e-13);
  ASSERT_EQ(step.touches().size(), 1u);
  EXPECT_EQ(step.touches()[0].mode, ContactMode::kFrictionless);
  step.ExpectDerivative({0, 1, 2, 3, 4, 5, 6}, {0, 1, 2, 3, 4, 5, 6, 7, 8}, 1e-6, 1e-7);
}

// A disc that overlaps but already leaves is moved out, and keeps the velocity that this gives: no restitution.
TEST(PbdBrax, LeavingDiscGetsNoRestitution) {
  OneStep step("pbd_brax",
               DiscScene({{.name = "a", .radius = 0.1, .position = {0, 0.08}, .velocity = {0, 1}}}, {kGround}));
  step.Run();
  const double h = step.h() / 2;
  const double depth = 0.1 - (0.08 + 2 * h);
  const double raised = 0.1 - depth + depth / (1 + kEps) / (1 + kEps);
  EXPECT_NEAR(step.after(0, 1), raised, 1e-16);
  EXPECT_NEAR(step.after(0, 3), (raised - (0.08 + h)) / h, 1e-12);
  step.ExpectDerivative({0, 1, 2, 3}, {0, 1, 2, 3}, 1e-6, 1e-7);
}

// Contacts are looked for in the second integrator step only.
TEST(PbdBrax, ContactOfTheFirstHalfIsNotSeen) {
  OneStep step("pbd_brax",
               DiscScene({{.name = "a", .radius = 0.1, .position = {0, 0.0975}, .velocity = {0, 1}}}, {kGround}));
  ASSERT_LT(0.0975 + step.h() / 2, 0.1);
  step.Run();
  EXPECT_NEAR(step.after(0, 1), 0.0975 + step.h(), 1e-16);
  EXPECT_TRUE(step.touches().empty());
}

// Static friction at a plane takes the material point back, sharing the way between moving and turning; the velocity
// pass then takes what slip remains.
TEST(PbdBrax, StaticFrictionAtAPlane) {
  const double m = 2, r = 0.5, mu = 0.36, v = 0.05;
  Scene scene =
      DiscScene({{.name = "a", .radius = r, .mass = m, .position = {0, r - 0.001}, .velocity = {v, -1}}}, {kGround});
  scene.contact.friction = 0.6;
  scene.contact.restitution = 0;
  OneStep step("pbd_brax", scene);
  step.Run();
  const double h = step.h() / 2;
  const double depth = 0.001 + 2 * h;
  const double lambda = depth / (1 / m + kEps);
  const double slide = h * v;
  const double t = slide / (slide + kEps);
  const double hold = slide / (1 / m + r * t * r * t);
  ASSERT_LT(hold, mu * lambda);
  const double back = hold * t / m / (1 + kEps);
  const double x = 2 * h * v - back;
  const double turn = r * hold * t / (1 + kEps);  // the force at the arm (0, -r) points to -x
  const double y = r - depth + lambda / m / (1 + kEps);
  const double angle = std::atan(turn / 2);
  EXPECT_NEAR(step.after(0, 0), x, 1e-16);
  EXPECT_NEAR(step.after(0, 1), y, 1e-16);
  EXPECT_NEAR(step.after(0, 5), std::cos(angle), 1e-15);
  EXPECT_NEAR(step.after(0, 6), std::sin(angle), 1e-15);

  const double spin = 2 * std::sin(angle) / h;
  const Vec2d arm(2 * h * v - x, r - depth - r - y);
  const Vec2d point((x - h * v) / h + spin * arm[1], (y - (r - 0.001 - h)) / h - spin * arm[0]);
  const double slip = std::abs(point[0]);
  const double direction = point[0] / (slip + kEps);
  const double lever = arm[1] * direction;
  const double friction = std::min(mu * lambda / (2 * h), slip) / (1 / m + lever * lever + kEps) * direction;
  const double missing = -point[1];  // no restitution
  const double d = missing / (std::abs(missing) + kEps);
  const double normal = std::abs(missing) / (1 / m + arm[0] * d * arm[0] * d + kEps) * d;
  EXPECT_NEAR(step.after(0, 2), (x - h * v) / h - friction / m / (1 + kEps), 1e-12);
  EXPECT_NEAR(step.after(0, 3), (y - (r - 0.001 - h)) / h + normal / m / (1 + kEps), 1e-12);
  EXPECT_NEAR(step.after(0, 4), spin + (-arm[1] * friction - arm[0] * normal) / (1 + kEps), 1e-12);
  ASSERT_EQ(step.touches().size(), 1u);
  EXPECT_EQ(step.touches()[0].mode, ContactMode::kStick);
  step.ExpectDerivative({0, 1, 2, 3, 4, 5, 6}, {0, 1, 2, 3, 4, 5, 6, 7, 8}, 1e-7, 1e-5);
}

// The material point of a spinning disc does slide where its centre rests, whatever its orientation.
TEST(PbdBrax, SpinSlidesAndOrientationDoesNotMatter) {
  Scene scene =
      DiscScene({{.name = "a", .radius = 0.3, .mass = 2, .position = {0, 0.3}, .velocity = {0, -1}}}, {kGround});
  scene.contact.friction = 0.3;
  scene.contact.restitution = 0.5;
  OneStep step("pbd_brax", scene);
  step.start(0, 4) = 20;
  step.Run();
  // With the clockwise spin the lowest point moves to -x, so friction pushes to +x and brakes the spin.
  EXPECT_GT(step.after(0, 2), 0.01);
  EXPECT_LT(step.after(0, 4), 20);
  EXPECT_EQ(step.touches().at(0).mode, ContactMode::kSlip);
  step.ExpectDerivative({0, 1, 2, 3, 4, 5, 6}, {0, 1, 2, 3, 4, 5, 6, 7, 8}, 1e-6, 1e-5);

  OneStep turned("pbd_brax", scene);
  turned.start(0, 4) = 20;
  turned.start(0, 5) = std::cos(1.0);
  turned.start(0, 6) = std::sin(1.0);
  turned.Run();
  for (int j = 0; j < 5; ++j) EXPECT_NEAR(turned.after(0, j), step.after(0, j), 1e-11);
}

TEST(PbdBrax, TwoContactsAreAveraged) {
  const double m = 3;
  const Scene scene = DiscScene({{.name = "a", .radius = 0.1, .mass = m, .position = {0.1, 0.1}, .velocity = {-1, -2}}},
                                {kGround, kWall});
  OneStep step("pbd_brax", scene);
  step.Run();
  const double h = step.h() / 2;
  const double velocity[] = {-1, -2};
  const double count = 2 + kEps;
  const auto lift = [&](int j) { return -2 * h * velocity[j] / (1 / m + kEps) / m / count; };
  for (int j : {0, 1}) {
    const double v = velocity[j];
    const double raised = 0.1 + 2 * h * v + lift(j);
    const double after = (raised - (0.1 + h * v)) / h;
    const double s = -after - v;
    const double d = s / (std::abs(s) + kEps);
    const double lever = d * lift(1 - j);  // the other contact has moved the disc off the point of this one
    const double impulse = std::abs(s) * d / (1 / m + lever * lever + kEps);
    EXPECT_NEAR(step.after(0, j), raised, 1e-15);
    EXPECT_NEAR(step.after(0, 2 + j), after + impulse / m / count, 1e-12);
  }
  EXPECT_EQ(step.touches().size(), 2u);
}

// Overlap is shared by inverse mass, and momentum is conserved.
TEST(PbdBrax, UnequalMasses) {
  const double ma = 3, mb = 0.5;
  Scene scene = DiscScene({{.name = "a", .radius = 0.2, .mass = ma, .position = {0, 0}, .velocity = {1, 0}},
                           {.name = "b", .radius = 0.1, .mass = mb, .position = {0.3, 0}, .velocity = {-1, 0}}});
  OneStep step("pbd_brax", scene);
  step.Run();
  const double h = step.h() / 2;
  const double distance = 0.3 - 4 * h;
  const double n = distance / (distance + kEps);
  const double depth = 0.3 - distance;
  const double lambda = depth / (1 / ma + 1 / mb + kEps);
  // The remainder of the relative displacement across the slightly short normal counts as sliding.
  const double slide = 2 * h - 2 * h * n * n;
  ASSERT_GT(slide, 1e-8);  // so small a sliding counts as none
  const double grip = slide / (1 / ma + 1 / mb) * slide / (slide + kEps);
  EXPECT_NEAR(step.after(0, 0), 2 * h - (lambda * n + grip) / ma / (1 + kEps), 1e-15);
  EXPECT_NEAR(step.after(1, 0), 0.3 - 2 * h + (lambda * n + grip) / mb / (1 + kEps), 1e-15);
  EXPECT_NEAR(ma * step.after(0, 2) + mb * step.after(1, 2), ma - mb, 1e-12);
  EXPECT_NEAR(step.after(1, 2) - step.after(0, 2), 2, 1e-4);
}

// Spinning discs grip each other, even without friction in the scene.
TEST(PbdBrax, StaticFrictionBetweenSpinningDiscs) {
  const double r = 0.2, spin = 0.01;
  const Scene scene = DiscScene({{.name = "a", .radius = r, .position = {0, 0}, .velocity = {1, 0}},
                                 {.name = "b", .radius = r, .position = {0.4, 0}, .velocity = {-1, 0}}});
  OneStep step("pbd_brax", scene);
  step.start(0, 4) = step.start(1, 4) = spin;
  step.Run();
  const double h = step.h() / 2;
  const double arm = 0.2 - 2 * h;
  const double slide = 2 * h * spin * arm;  // a's point goes down and b's goes up
  const double t = slide / (slide + kEps);
  const double grip = slide / (2 + 2 * arm * t * arm * t) * t;
  EXPECT_NEAR(step.after(0, 1), grip, 1e-3 * grip);
  EXPECT_NEAR(step.after(1, 1), -grip, 1e-3 * grip);
  EXPECT_NEAR(step.after(0, 6), h * spin - arm * grip / 2, 1e-3 * arm * grip);
}

TEST(PbdBrax, GlancingHitWithSpin) {
  Scene scene = DiscScene({{.name = "a", .radius = 0.2, .mass = 3, .position = {0, 0}, .velocity = {1, 0.5}},
                           {.name = "b", .radius = 0.1, .mass = 0.5, .position = {0.24, 0.18}, .velocity = {-1, 0.2}}});
  scene.contact.restitution = 0.9;
  scene.contact.friction = 0.3;
  OneStep step("pbd_brax", scene);
  step.start(0, 4) = 2;
  step.start(1, 4) = -5;
  step.Run();
  for (int j : {2, 3}) {
    EXPECT_NEAR(3 * step.after(0, j) + 0.5 * step.after(1, j), 3 * step.start(0, j) + 0.5 * step.start(1, j), 1e-12);
  }
  EXPECT_EQ(step.touches().size(), 1u);
  step.ExpectDerivative({0, 1, 2, 3, 4, 5, 6}, {0, 1, 2, 3, 4, 5, 6, 7, 8}, 1e-6, 1e-5);
}

TEST(PbdBrax, FixedDiscIsAnInfiniteMass) {
  const double m = 0.5;
  Scene scene = DiscScene({{.name = "post", .radius = 0.2, .fixed = true, .position = {0, 0}},
                           {.name = "b", .radius = 0.1, .mass = m, .position = {0, 0.3}, .velocity = {0, -1}}});
  scene.contact.restitution = 0.5;
  OneStep step("pbd_brax", scene);
  step.Run();
  EXPECT_NEAR(step.after(1, 1), 0.3, 1e-7);
  EXPECT_NEAR(step.after(1, 3), 0.25, 1e-4);
  const double expected[] = {0, 0, 0, 0, 0, 1, 0};
  for (int j = 0; j < 7; ++j) EXPECT_EQ(step.after(0, j), expected[j]);
}

}  // namespace
}  // namespace saltus
