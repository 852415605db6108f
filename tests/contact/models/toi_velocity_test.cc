#include "contact/models/toi_velocity.h"

#include "contact/stepping.h"

extern template class saltus::ContactStepOf<saltus::ToiVelocity, double>;

namespace saltus::testing {
namespace {

const auto kToiVelocity = Compiled<ToiVelocity>();

// Loss and derivatives of independent implementations. In single precision the terminal part alone is compared: how the
// sum of 480 running costs is rounded depends on its order.
TEST(ToiVelocityTest, TwoBalls) {
  EXPECT_NEAR(InitialLoss(kToiVelocity, TwoBalls()), 2.0574282224457, 1e-12);
  Scene terminal = TwoBalls();
  terminal.objective.effort = 0;
  EXPECT_NEAR(InitialLoss(kToiVelocity, terminal, Precision::kFloat), 0.2574226, 5e-7);
  const Sensitivity gradient = Gradient(kToiVelocity, TwoBalls()).gradient;
  EXPECT_NEAR(gradient.initial[0], -0.3951, 5e-5);
  EXPECT_NEAR(gradient.initial[4], -0.3225, 5e-5);
  EXPECT_NEAR(gradient.initial[2], -0.4949, 5e-5);
  EXPECT_NEAR(gradient.initial[6], -0.2226, 5e-5);
  EXPECT_NEAR(gradient.control[0], 0.0002, 5e-5);
}

TEST(ToiVelocityTest, DerivativeIsThatOfDifferences) {
  ExpectStepDerivative(kToiVelocity, ObliqueCollision());
  Scene scene = Corner();
  scene.gravity = {3, -10};
  ExpectStepDerivative(kToiVelocity, scene);
}

TEST(ToiVelocityTest, JetsHaveScalarBits) {
  ExpectJetsHaveScalarBits(kToiVelocity, ObliqueCollision());
  ExpectJetsHaveScalarBits(kToiVelocity, Corner());
}

TEST(ToiVelocityTest, UnequalMassesKeepMomentum) { ExpectMomentumConserved(kToiVelocity, ObliqueCollision()); }

TEST(ToiVelocityTest, FixedDiscActsAsHeavyOne) { ExpectFixedActsAsHeavy(kToiVelocity, ObliqueCollision()); }

TEST(ToiVelocityTest, ContactsOfAStepAdd) { ExpectContactsAdd(kToiVelocity, ObliqueCollision()); }

// Without force the impact is found where it is, and reported.
TEST(ToiVelocityTest, ForceFreeBounceIsExact) {
  std::vector<Touch> touches;
  const BodyState<double, 0> next = StepOnce(kToiVelocity, Corner(), &touches)[0];
  const double on_wall = (0.9 - 0.895) / 1.5, on_ground = (0.103 - 0.1) / 1;  // s
  ExpectNear(next.p, Vec2d(0.9 - 0.7 * 1.5 * (0.01 - on_wall), 0.1 + 0.7 * (0.01 - on_ground)), 1e-15);
  ExpectNear(next.v, Vec2d(-0.7 * 1.5, 0.7), 1e-14);
  ASSERT_EQ(touches.size(), 2u);
  EXPECT_NEAR(touches[0].time, on_ground, 1e-15);
  EXPECT_NEAR(touches[1].time, on_wall, 1e-15);
}

// With gravity g the speed at the impact is that after b, and b is found with the velocity at the end of the step.
TEST(ToiVelocityTest, ImpulseUsesTheVelocityAtTheImpact) {
  Scene scene = Corner();
  scene.bodies[0].position = {0, 0.103};
  scene.bodies[0].velocity = {0, -1};
  scene.gravity = {0, -10};
  const double end_speed = 1 + 0.1, b = 0.01 - (0.01 * end_speed - 0.003) / end_speed, dv = 1.7 * (1 + 10 * b);
  const BodyState<double, 0> next = StepOnce(kToiVelocity, scene)[0];
  EXPECT_NEAR(next.v[1], -end_speed + dv, 1e-14);
  EXPECT_NEAR(next.p[1], 0.103 - 0.01 * end_speed + (0.01 - b) * dv, 1e-15);
}

// The normal is that at the impact: the tangential relative velocity there does not change.
TEST(ToiVelocityTest, NormalIsThatAtTheImpact) {
  Scene scene = ObliqueCollision();
  scene.control = {};
  std::vector<Touch> touches;
  const auto next = StepOnce(kToiVelocity, scene, &touches);
  ASSERT_EQ(touches.size(), 1u);
  const Vec2d w = scene.bodies[0].velocity - scene.bodies[1].velocity;
  const Vec2d n = (scene.bodies[0].position - scene.bodies[1].position + touches[0].time * w).normalized();
  const Vec2d after = next[0].v - next[1].v;
  EXPECT_NEAR(n.dot(after), -0.7 * n.dot(w), 1e-14);
  EXPECT_NEAR(n[0] * after[1] - n[1] * after[0], n[0] * w[1] - n[1] * w[0], 1e-14);
}

// Slower than 1e-3 m/s the time after the impact is taken as that of 1e-3 m/s.
TEST(ToiVelocityTest, SlowContactUsesTheClampedSpeed) {
  Scene scene = Corner();
  scene.bodies[0].position = {0, 0.1 - 2e-6};
  scene.bodies[0].velocity = {0, -4e-4};
  const double dv = 1.7 * 4e-4, time_left = (2e-6 + 4e-6) / 1e-3;
  EXPECT_NEAR(StepOnce(kToiVelocity, scene)[0].p[1], 0.1 - 2e-6 - 0.01 * 4e-4 + time_left * dv, 1e-15);
  ExpectStepDerivative(kToiVelocity, scene);
}

// An impact found before the step begins is put at its beginning.
TEST(ToiVelocityTest, ImpactIsNotBeforeTheStep) {
  Scene scene = Corner();
  scene.bodies[0].position = {0, 0.09};
  scene.bodies[0].velocity = {0, -0.5};
  std::vector<Touch> touches;
  const BodyState<double, 0> next = StepOnce(kToiVelocity, scene, &touches)[0];
  EXPECT_EQ(touches.at(0).time, 0);
  EXPECT_NEAR(next.p[1], 0.09 + 0.01 * 0.35, 1e-15);
}

}  // namespace
}  // namespace saltus::testing
