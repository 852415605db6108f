#include "contact/models/convex.h"

#include "contact/stepping.h"

extern template class saltus::ContactStepOf<saltus::Convex<false>, double>;
extern template class saltus::ContactStepOf<saltus::Convex<true>, double>;

namespace saltus::testing {
namespace {

template <typename M>
class ConvexTest : public ::testing::Test {
 protected:
  const ContactStepOf<M, double> model_ = Compiled<M>();
};
using Models = ::testing::Types<Convex<false>, Convex<true>>;
TYPED_TEST_SUITE(ConvexTest, Models);

TYPED_TEST(ConvexTest, DerivativeAtPlanesIsThatOfDifferences) {
  Scene scene = Corner();
  for (const double friction : {0.2, 1.0, 2.0}) {  // slip on both, stick on one, stick on both
    SCOPED_TRACE(friction);
    scene.contact.friction = friction;
    ExpectStepDerivative(this->model_, scene);
  }
}

TYPED_TEST(ConvexTest, JetsHaveScalarBits) {
  ExpectJetsHaveScalarBits(this->model_, ObliqueCollision());
  for (const double friction : {0.0, 0.2, 1.0, 2.0}) {
    Scene scene = Corner();
    scene.contact.friction = friction;
    ExpectJetsHaveScalarBits(this->model_, scene);
    scene.bodies[0].velocity = {0, -1};  // no sliding
    ExpectJetsHaveScalarBits(this->model_, scene);
  }
}

TYPED_TEST(ConvexTest, UnequalMassesKeepMomentum) { ExpectMomentumConserved(this->model_, ObliqueCollision()); }

TYPED_TEST(ConvexTest, FixedDiscActsAsHeavyOne) { ExpectFixedActsAsHeavy(this->model_, ObliqueCollision()); }

TYPED_TEST(ConvexTest, ContactsOfAStepAdd) { ExpectContactsAdd(this->model_, ObliqueCollision()); }

// f = v-change / (1 + e) is the projection of a on the cone K iff f is in K, (f - a) . f = 0 and (f - a) . k >= 0 for
// the generators k of K.
TYPED_TEST(ConvexTest, ImpulseIsTheProjectionOnTheCone) {
  Scene scene = Corner();
  scene.bodies[0].position = {0, 0.1};
  for (const double friction : {0.0, 0.1, 0.5, 1.5}) {
    for (const double sliding : {-3.0, -0.4, 0.0, 0.05, 0.4, 3.0}) {
      scene.contact.friction = friction;
      scene.bodies[0].velocity = {sliding, -0.8};
      std::vector<Touch> touches;
      const Vec2d dv = StepOnce(this->model_, scene, &touches)[0].v - scene.bodies[0].velocity;
      const Vec2d a = -scene.bodies[0].velocity, f = dv / 1.7;
      const double slack = friction * f[1] - std::abs(f[0]);
      EXPECT_GE(slack, -1e-15);
      EXPECT_NEAR((f - a).dot(f), 0, 1e-14);
      EXPECT_GE((f - a).dot(Vec2d(friction, 1)), -1e-14);
      EXPECT_GE((f - a).dot(Vec2d(-friction, 1)), -1e-14);
      ASSERT_EQ(touches.size(), 1u);
      EXPECT_EQ(touches[0].mode,
                friction == 0                         ? ContactMode::kFrictionless
                : std::abs(sliding) <= 0.8 * friction ? ContactMode::kStick
                                                      : ContactMode::kSlip);
    }
  }
}

TYPED_TEST(ConvexTest, DiscsRubAsPlanesDo) {
  const Scene scene = ObliqueCollision();
  const Vec2d p = scene.bodies[0].position + 0.01 * scene.bodies[0].velocity - scene.bodies[1].position -
                  0.01 * scene.bodies[1].velocity;
  const Vec2d n = p.normalized(), t(-n[1], n[0]), w = scene.bodies[0].velocity - scene.bodies[1].velocity;
  const double c = (-n.dot(w) + 0.2 * std::abs(t.dot(w))) / (1 + 0.2 * 0.2);
  ASSERT_GT(std::abs(t.dot(w)), 0.2 * -n.dot(w));  // slides
  const Vec2d impulse = 1.7 * 0.75 * c * (n - 0.2 * (t.dot(w) > 0 ? 1 : -1) * t);
  ExpectNear(ContactChange(this->model_, scene, 0).v, impulse, 1e-14);
  ExpectNear(ContactChange(this->model_, scene, 1).v, -impulse / 3, 1e-14);
}

// The impulse of two discs has no derivative by position; that of the time of impact is complete.
TYPED_TEST(ConvexTest, FrameOfTwoDiscsIsAConstant) {
  const Scene scene = ObliqueCollision();
  const auto lever_at = [&](double dx) {  // s, by how much the impulse moves disc 0
    Scene moved = scene;
    moved.bodies[0].position[0] += dx;
    const BodyState<double, 0> change = ContactChange(this->model_, moved, 0);
    return change.p[0] / change.v[0];
  };
  const double slope = (lever_at(1e-6) - lever_at(-1e-6)) / 2e-6;
  StepArguments<StepJet<double>> arguments = Arguments<StepJet<double>>(scene);
  arguments.x[0].p[0].v[0] = 1;
  const auto next = StepOnce(this->model_, scene, arguments);
  const Vec2d dv = ContactChange(this->model_, scene, 0).v;
  EXPECT_EQ(next[0].v[0].v[0], 0);
  EXPECT_EQ(next[0].v[1].v[0], 0);
  EXPECT_NEAR(next[0].p[0].v[0], 1 + slope * dv[0], 1e-6);
  EXPECT_NEAR(next[0].p[1].v[0], slope * dv[1], 1e-6);
}

TEST(ConvexTest, PositionMovesWithTheOldVelocity) {
  Scene scene = Corner();
  scene.gravity = {0, -10};
  const BodyState<double, 0> next = StepOnce(Compiled<Convex<false>>(), scene)[0];
  EXPECT_EQ(next.p, Vec2d(0.895 + 0.01 * 1.5, 0.103 + 0.01 * -1.0));
}

// Slower than 1e-3 m/s the time after the impact is taken as that of 1e-3 m/s; never longer than the step.
TEST(ConvexToiTest, SlowContactUsesTheClampedSpeed) {
  Scene scene = Corner();
  scene.bodies[0].position = {0, 0.1 - 2e-6};
  scene.bodies[0].velocity = {0, -4e-4};
  const double dv = 1.7 * 4e-4, time_left = (2e-6 + 4e-6) / 1e-3, old = 0.1 - 2e-6 - 0.01 * 4e-4;
  EXPECT_NEAR(StepOnce(Compiled<Convex<true>>(), scene)[0].p[1], old + (time_left - 0.01) * dv, 1e-15);
  ExpectStepDerivative(Compiled<Convex<true>>(), scene);
  scene.bodies[0].position[1] -= 1e-5;
  EXPECT_NEAR(StepOnce(Compiled<Convex<true>>(), scene)[0].p[1], old - 1e-5, 1e-15);
}

// Losses of an independent implementation.
TEST(ConvexTest, InitialLosses) {
  EXPECT_NEAR(InitialLoss(Compiled<Convex<true>>(), TwoBalls()), 2.068272, 1e-6);
  EXPECT_NEAR(InitialLoss(Compiled<Convex<false>>(), TwoBalls()), 2.065766, 1e-6);
  EXPECT_NEAR(InitialLoss(Compiled<Convex<true>>(), GroundWall(0.1)), 11.832704, 1e-6);
  EXPECT_NEAR(InitialLoss(Compiled<Convex<false>>(), GroundWall(0.1)), 11.729337, 1e-6);
}

}  // namespace
}  // namespace saltus::testing
