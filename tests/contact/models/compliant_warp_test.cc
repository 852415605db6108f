#include "contact/models/compliant_warp.h"

#include "contact/stepping.h"

extern template class saltus::ContactStepOf<saltus::CompliantWarp, double>;

namespace saltus::testing {
namespace {

const auto kCompliantWarp = Compiled<CompliantWarp>();

// Losses of an independent implementation.
TEST(CompliantWarpTest, InitialLossWithFriction) {
  EXPECT_NEAR(InitialLoss(kCompliantWarp, GroundWall(0.1)), 12.14042941, 1e-7);
  EXPECT_NEAR(InitialLoss(kCompliantWarp, GroundWall(0.1), Precision::kFloat), 12.14046955, 5e-6);
}

TEST(CompliantWarpTest, DerivativeIsThatOfDifferences) {
  ExpectStepDerivative(kCompliantWarp, ObliqueCollision(true));
  ExpectStepDerivative(kCompliantWarp, Corner(true));
}

TEST(CompliantWarpTest, JetsHaveScalarBits) {
  for (const double friction : {0.0, 0.2}) {
    Scene scene = ObliqueCollision(true);
    scene.contact.friction = friction;
    ExpectJetsHaveScalarBits(kCompliantWarp, scene);
    scene = Corner(true);
    scene.contact.friction = friction;
    ExpectJetsHaveScalarBits(kCompliantWarp, scene);
    scene.bodies[0].velocity = {0, 0};
    ExpectJetsHaveScalarBits(kCompliantWarp, scene);
  }
}

TEST(CompliantWarpTest, UnequalMassesKeepMomentum) { ExpectMomentumConserved(kCompliantWarp, ObliqueCollision(true)); }

TEST(CompliantWarpTest, FixedDiscActsAsHeavyOne) { ExpectFixedActsAsHeavy(kCompliantWarp, ObliqueCollision(true)); }

TEST(CompliantWarpTest, ContactsOfAStepAdd) { ExpectContactsAdd(kCompliantWarp, ObliqueCollision(true)); }

TEST(CompliantWarpTest, CornerForces) {
  std::vector<Touch> touches;
  const BodyState<double, 0> next = StepOnce(kCompliantWarp, Corner(true), &touches)[0];
  const double ground = 2e3 * 0.006 + 5 * 1, wall = 2e3 * 0.01 + 5 * 1.5;  // N
  const Vec2d force(-wall - 0.2 * ground, ground + 0.2 * wall);
  const Vec2d v = Vec2d(1.5, -1) + 0.01 * force / 2;
  ExpectNear(next.v, v, 1e-14);
  ExpectNear(next.p, Vec2d(0.91, 0.094) + 0.01 * v, 1e-14);
  ASSERT_EQ(touches.size(), 2u);
  EXPECT_EQ(touches[0].mode, ContactMode::kSlip);
  EXPECT_EQ(touches[1].candidate, (Candidate{0, 1, true}));
}

// The damper only resists approach.
TEST(CompliantWarpTest, SeparatingDiscIsNotDamped) {
  Scene scene = Corner(true);
  scene.bodies[0].position[0] = 0;
  scene.bodies[0].velocity = {0, 1};
  EXPECT_NEAR(StepOnce(kCompliantWarp, scene)[0].v[1], 1 + 0.01 * 2e3 * 0.006 / 2, 1e-14);
}

TEST(CompliantWarpTest, NoFrictionBelowTheSlidingGuard) {
  Scene scene = Corner(true);
  scene.bodies[0].position[0] = 0;
  std::vector<Touch> touches;
  scene.bodies[0].velocity = {0.9e-6, 0};
  EXPECT_EQ(StepOnce(kCompliantWarp, scene, &touches)[0].v[0], 0.9e-6);
  scene.bodies[0].velocity = {1.1e-6, 0};
  EXPECT_NEAR(StepOnce(kCompliantWarp, scene, &touches)[0].v[0], 1.1e-6 - 0.01 * 0.2 * 2e3 * 0.006 / 2, 1e-15);
  ASSERT_EQ(touches.size(), 2u);
  EXPECT_EQ(touches[0].mode, ContactMode::kStick);
  EXPECT_EQ(touches[1].mode, ContactMode::kSlip);
}

// A disc that just touches is not in contact, whatever its speed.
TEST(CompliantWarpTest, ZeroGapIsOpen) {
  Scene scene = Corner();
  scene.bodies[0].position = {0, 0.1};
  std::vector<Touch> touches;
  EXPECT_EQ(StepOnce(kCompliantWarp, scene, &touches)[0].v, Vec2d(1.5, -1));
  EXPECT_TRUE(touches.empty());
}

}  // namespace
}  // namespace saltus::testing
