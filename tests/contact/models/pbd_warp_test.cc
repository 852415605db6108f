#include "contact/models/pbd_warp.h"

#include "contact/stepping.h"

extern template class saltus::ContactStepOf<saltus::PbdWarp, double>;

namespace saltus::testing {
namespace {

const auto kPbdWarp = Compiled<PbdWarp>();

// A disc on the ground, 0.1 m high, in the scene of Corner() but far from the wall.
Scene OnGround(double height, const Vec2d& velocity) {
  Scene scene = Corner();
  scene.bodies[0].position = {0, 0.1 + height};
  scene.bodies[0].velocity = velocity;
  return scene;
}

// Losses and gradients of an independent implementation.
TEST(PbdWarpTest, InitialLossesAndGradients) {
  EXPECT_NEAR(InitialLoss(kPbdWarp, TwoBalls()), 2.057624, 1e-6);
  EXPECT_NEAR(InitialLoss(kPbdWarp, GroundWall(0.1)), 10.814347, 1e-6);
  EXPECT_NEAR(InitialLoss(kPbdWarp, GroundWall(0.1), Precision::kFloat), 10.77617931, 2e-6);
  const std::vector<double> two_balls = Gradient(kPbdWarp, TwoBalls()).gradient.initial;
  EXPECT_NEAR(two_balls[0], -0.358904, 1e-6);
  EXPECT_NEAR(two_balls[6], -0.248242, 1e-6);
  const std::vector<double> frictionless = Gradient(kPbdWarp, GroundWall(0)).gradient.initial;
  EXPECT_NEAR(frictionless[2], -16.714758, 1e-6);
  EXPECT_NEAR(frictionless[3], -2.082768, 1e-6);
  const std::vector<double> with_friction = Gradient(kPbdWarp, GroundWall(0.1)).gradient.initial;
  EXPECT_NEAR(with_friction[2], -12.939468, 1e-6);
  EXPECT_NEAR(with_friction[3], 127.154078, 1e-6);
}

TEST(PbdWarpTest, DerivativeIsThatOfDifferences) {
  for (const double friction : {0.2, 3.0}) {  // sliding; held
    Scene scene = ObliqueCollision();
    scene.contact.friction = friction;
    ExpectStepDerivative(kPbdWarp, scene);
    scene = Corner();
    scene.contact.friction = friction;
    ExpectStepDerivative(kPbdWarp, scene);
  }
  ExpectStepDerivative(kPbdWarp, OnGround(-0.001, {0.01, -0.5}));
}

TEST(PbdWarpTest, JetsHaveScalarBits) {
  for (const double friction : {0.0, 0.2, 3.0}) {
    Scene scene = ObliqueCollision();
    scene.contact.friction = friction;
    ExpectJetsHaveScalarBits(kPbdWarp, scene);
    scene = Corner();
    scene.contact.friction = friction;
    ExpectJetsHaveScalarBits(kPbdWarp, scene);
    scene.bodies[0].velocity = {0, -1};  // no sliding
    ExpectJetsHaveScalarBits(kPbdWarp, scene);
  }
}

TEST(PbdWarpTest, UnequalMassesKeepMomentum) { ExpectMomentumConserved(kPbdWarp, ObliqueCollision()); }

TEST(PbdWarpTest, FixedDiscActsAsHeavyOne) { ExpectFixedActsAsHeavy(kPbdWarp, ObliqueCollision()); }

// Two discs end at contact distance, their centre of mass where it flew.
TEST(PbdWarpTest, ProjectionIsSplitByInverseMass) {
  Scene scene = ObliqueCollision();
  scene.control = {};
  const auto next = StepOnce(kPbdWarp, scene);
  EXPECT_NEAR((next[0].p - next[1].p).norm(), 0.5, 1e-14);
  const Vec2d centre = Vec2d(0.002 + 0.01 * 1, 0.001 + 0.01 * 0.2) + 3 * Vec2d(0.404 - 0.01 * 1, 0.303 - 0.01 * 0.1);
  ExpectNear(next[0].p + 3 * next[1].p, centre, 1e-14);
}

// A disc leaves with (1 - e) v_b - v*, v_b being what the projection left of the approach.
TEST(PbdWarpTest, SeparationUsesTheSwappedVelocities) {
  Scene scene = OnGround(0.004, {0, -1});
  EXPECT_NEAR(StepOnce(kPbdWarp, scene)[0].v[1], 0.3 * -0.4 + 1, 1e-13);
  scene.contact.restitution = 1;
  EXPECT_NEAR(StepOnce(kPbdWarp, scene)[0].v[1], 1, 1e-13);
}

// Sliding friction of restitution 0.7 and coefficient 0.2, bounded by mu (1 + e) |v_b|.
TEST(PbdWarpTest, SlidingFrictionAtTheFirstPlane) {
  std::vector<Touch> touches;
  const auto next = StepOnce(kPbdWarp, OnGround(0.004, {2, -1}), Arguments<double>(OnGround(0.004, {2, -1})), &touches);
  EXPECT_NEAR(next[0].v[0], 2 - 0.2 * 1.7 * 0.4, 1e-13);
  ASSERT_EQ(touches.size(), 1u);
  EXPECT_EQ(touches[0].mode, ContactMode::kSlip);
  // Slower than the bound, it takes all of v*_t; the position is not held.
  const Scene slow = OnGround(0.004, {0.125, -1});
  EXPECT_NEAR(StepOnce(kPbdWarp, slow)[0].v[0], 0, 1e-13);
  EXPECT_NEAR(StepOnce(kPbdWarp, slow)[0].p[0], 0.00125, 1e-15);
}

TEST(PbdWarpTest, StaticFrictionHoldsThePosition) {
  const Scene scene = OnGround(-0.001, {0.01, -0.5});
  std::vector<Touch> touches;
  const BodyState<double, 0> next = StepOnce(kPbdWarp, scene, &touches)[0];
  const double slid = 1e-4 - 1e-4 * 1e-4 / (1e-4 + 1e-6);
  ExpectNear(next.p, Vec2d(slid, 0.1), 1e-15);
  ExpectNear(next.v, Vec2d(slid / 0.01 - 0.01, 0.1 + 0.5), 1e-13);  // v_b is outwards, so e has no part in it
  ASSERT_EQ(touches.size(), 1u);
  EXPECT_EQ(touches[0].mode, ContactMode::kStick);
}

TEST(PbdWarpTest, NoVelocityFrictionBelowTheSlidingGuard) {
  for (const double sliding : {0.9e-6, 1.1e-6}) {
    const BodyState<double, 0> next = StepOnce(kPbdWarp, OnGround(0.004, {sliding, -1}))[0];
    const double slid = next.p[0] / 0.01;  // v_b
    EXPECT_NEAR(next.v[0], sliding < 1e-6 ? slid : slid - sliding, 1e-18);
  }
}

TEST(PbdWarpTest, OnlyTheFirstPlaneOfTheSceneRubs) {
  Scene scene = Corner();
  scene.bodies[0].position[1] = 5;
  EXPECT_NEAR(StepOnce(kPbdWarp, scene)[0].v[1], -1, 1e-12);
  std::swap(scene.planes[0], scene.planes[1]);
  EXPECT_NEAR(StepOnce(kPbdWarp, scene)[0].v[1], -1 + 0.2 * 1.7 * 0.5, 1e-12);
}

// In a corner the wall rubs along the ground, by the size of its own friction.
TEST(PbdWarpTest, WallInACornerRubsAlongTheGround) {
  const BodyState<double, 0> next = StepOnce(kPbdWarp, Corner())[0];
  ExpectNear(next.p, Vec2d(0.9, 0.1), 1e-15);
  const Vec2d v_b(0.5, -0.3);
  const double ground = 0.2 * 1.7 * 0.3, wall = 0.2 * 1.7 * 0.5;
  const Vec2d restitution(-1.5 - 0.7 * 0.5 + 0.0, 1 + 0.7 * 0.3);
  ExpectNear(next.v, v_b + restitution - Vec2d(ground + wall, 0), 1e-12);
}

// Discs rub along their own tangent, whatever plane comes first.
TEST(PbdWarpTest, FrictionBetweenDiscs) {
  Scene scene;
  scene.duration = 0.01;
  scene.steps = 1;
  scene.contact = {.restitution = 0.7, .friction = 0.2};
  scene.bodies = {{.name = "a", .radius = 0.2, .mass = 1, .position = {0, 0.006}, .velocity = {2, -1}},
                  {.name = "b", .radius = 0.3, .mass = 3, .position = {0.02, -0.5}}};
  const auto next = StepOnce(kPbdWarp, scene);  // centres are above each other at the end of the step
  EXPECT_NEAR(next[0].v[0], 2 - 0.75 * 0.2 * 1.7 * 0.6, 1e-12);
  EXPECT_NEAR(next[1].v[0], 0.25 * 0.2 * 1.7 * 0.6, 1e-12);
}

}  // namespace
}  // namespace saltus::testing
