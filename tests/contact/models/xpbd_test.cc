#include "contact/models/xpbd.h"

#include "contact/formulation.h"
#include "contact/models/pbd_warp.h"

extern template class saltus::ContactStepOf<saltus::PbdWarp, double>;
extern template class saltus::ContactStepOf<saltus::Xpbd, double>;

namespace saltus::testing {
namespace {

const auto kXpbd = Compiled<Xpbd>(), kCompliant = Compiled<Xpbd>({{"compliance", 1e-4}}),
           kPublishedBound = Compiled<Xpbd>({{"published_bound", 1}}), kOneSubstep = Compiled<Xpbd>({{"substeps", 1}});

// Values of an independent implementation.
TEST(XpbdTest, BounceOnce) {
  ExpectBounceOnce(kXpbd, BounceOnce(), {1.199583, 0, -0.549792, -0.0011454});
  ExpectBounceOnce(kCompliant, BounceOnce(), {1.199167, 0.999566, -0.099779, -0.0002098});
}

TEST(XpbdTest, GroundWall) {
  ExpectGroundWall(kXpbd, GroundWall(0), {8.321554, -0.896310, -0.245808});
  ExpectGroundWall(kCompliant, GroundWall(0), {8.326905, 1.570618, -0.151247});
  ExpectGroundWall(kXpbd, GroundWall(0.1), {11.484542, -0.494537, -0.294758});
  ExpectGroundWall(kPublishedBound, GroundWall(0.1), {9.509192, -17.398013, -882.329369}, 2e-5);
}

TEST(XpbdTest, TwoBalls) {
  ExpectTwoBalls(kXpbd, TwoBalls(), {2.058989, -0.359854, -0.359854, -0.470883, -0.248824, 0.0002697});
  ExpectTwoBalls(kCompliant, TwoBalls(), {2.059155, -0.000312, -0.719625, -0.222347, -0.497591, 0.0007868});
}

// With one substep, no compliance and restitution 1 it is the plain position-based model.
TEST(XpbdTest, OneSubstepIsPlainPbd) {
  EXPECT_NEAR(LossOf(kOneSubstep, TwoBalls()), LossOf(Compiled<PbdWarp>(), TwoBalls()), 1e-9);
  for (const char* quantity : {"dp1_x", "dp2_x", "dv1_x", "dv2_x"}) {
    EXPECT_NEAR(LossDerivative(kOneSubstep, TwoBalls(), quantity),
                LossDerivative(Compiled<PbdWarp>(), TwoBalls(), quantity),
                1e-9)
        << quantity;
  }
  // The first penetrating step is the 217th; from there on the velocity counts, not the position.
  EXPECT_NEAR(LossDerivative(kOneSubstep, BounceOnce(), "dv_y"), -(480 - 217) / 480.0, 1e-12);
}

// Compliance leaves the position free: the share that the projection takes falls as compliance / h_s^2 grows.
TEST(XpbdTest, PositionDerivativeByCompliance) {
  const auto derivative = [](double compliance) {
    return LossDerivative(Compiled<Xpbd>({{"compliance", compliance}}), BounceOnce(), "dp_y");
  };
  EXPECT_NEAR(derivative(1e-2), 1.000, 5e-4);
  EXPECT_NEAR(derivative(1e-6), 0.958, 5e-4);
  EXPECT_NEAR(derivative(1e-8), 0.187, 5e-4);
  EXPECT_NEAR(derivative(1e-10), 0.0023, 5e-5);
}

TEST(XpbdTest, DerivativeIsThatOfDifferences) {
  for (const double friction : {0.2, 3.0}) {
    Scene scene = ObliqueCollision();
    scene.contact.friction = friction;
    ExpectStepDerivative(kXpbd, scene);
    scene = Corner();
    scene.bodies[0].position += Vec2d(3e-4, 4e-4);  // no impact at the end of a substep
    scene.contact.friction = friction;
    ExpectStepDerivative(kXpbd, scene);
  }
}

TEST(XpbdTest, JetsHaveScalarBits) {
  for (const double friction : {0.0, 0.2, 3.0}) {
    Scene scene = ObliqueCollision();
    scene.contact.friction = friction;
    ExpectJetsHaveScalarBits(kXpbd, scene);
    scene = Corner();
    scene.contact.friction = friction;
    ExpectJetsHaveScalarBits(kXpbd, scene);
  }
}

TEST(XpbdTest, UnequalMassesKeepMomentum) { ExpectMomentumConserved(kXpbd, ObliqueCollision()); }

TEST(XpbdTest, FixedDiscActsAsHeavyOne) { ExpectFixedActsAsHeavy(kXpbd, ObliqueCollision()); }

TEST(XpbdTest, SlidingDiscStops) {
  for (const SlidingDisc& slide : {Slide(kXpbd), Slide(kPublishedBound)}) {
    EXPECT_NEAR(slide.speed_at_half, 1 - 0.1 * 9.8 * 0.5, 1e-3);
    EXPECT_NEAR(slide.speed_at_end, 0, 1e-9);
  }
}

}  // namespace
}  // namespace saltus::testing
