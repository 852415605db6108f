#include "contact/models/xpbd.h"

#include "contact/formulation.h"
#include "contact/models/pbd_warp.h"

namespace saltus::testing {
namespace {

struct Compliant : Xpbd {
  Compliant() { compliance = 1e-4; }
};
struct PublishedBound : Xpbd {
  PublishedBound() { friction_bound = FrictionBound::kPublished; }
};
struct OneSubstep : Xpbd {
  OneSubstep() { substeps = 1; }
};

template <int kPower>
struct WithCompliance : Xpbd {
  WithCompliance() { compliance = std::pow(10, kPower); }
};

// Values of an independent implementation.
TEST(XpbdTest, BounceOnce) {
  ExpectBounceOnce<Xpbd>(BounceOnce(), {1.199583, 0, -0.549792, -0.0011454});
  ExpectBounceOnce<Compliant>(BounceOnce(), {1.199167, 0.999566, -0.099779, -0.0002098});
}

TEST(XpbdTest, GroundWall) {
  ExpectGroundWall<Xpbd>(GroundWall(0), {8.321554, -0.896310, -0.245808});
  ExpectGroundWall<Compliant>(GroundWall(0), {8.326905, 1.570618, -0.151247});
  ExpectGroundWall<Xpbd>(GroundWall(0.1), {11.484542, -0.494537, -0.294758});
  ExpectGroundWall<PublishedBound>(GroundWall(0.1), {9.509192, -17.398013, -882.329369}, 2e-5);
}

TEST(XpbdTest, TwoBalls) {
  ExpectTwoBalls<Xpbd>(TwoBalls(), {2.058989, -0.359854, -0.359854, -0.470883, -0.248824, 0.0002697});
  ExpectTwoBalls<Compliant>(TwoBalls(), {2.059155, -0.000312, -0.719625, -0.222347, -0.497591, 0.0007868});
}

// With one substep, no compliance and restitution 1 it is the plain position-based model.
TEST(XpbdTest, OneSubstepIsPlainPbd) {
  EXPECT_NEAR(LossOf<OneSubstep>(TwoBalls()), LossOf<PbdWarp>(TwoBalls()), 1e-9);
  for (const char* quantity : {"dloss/dp1_x", "dloss/dp2_x", "dloss/dv1_x", "dloss/dv2_x"}) {
    EXPECT_NEAR(
        (LossDerivative<OneSubstep>(TwoBalls(), quantity)), (LossDerivative<PbdWarp>(TwoBalls(), quantity)), 1e-9)
        << quantity;
  }
  // The first penetrating step is the 217th; from there on the velocity counts, not the position.
  EXPECT_NEAR((LossDerivative<OneSubstep>(BounceOnce(), "dloss/dv_y")), -(480 - 217) / 480.0, 1e-12);
}

// Compliance leaves the position free: the share that the projection takes falls as compliance / h_s^2 grows.
TEST(XpbdTest, PositionDerivativeByCompliance) {
  const auto derivative = [](const auto& model) {
    return LossDerivative<std::decay_t<decltype(model)>>(BounceOnce(), "dloss/dp_y");
  };
  EXPECT_NEAR(derivative(WithCompliance<-2>()), 1.000, 5e-4);
  EXPECT_NEAR(derivative(WithCompliance<-6>()), 0.958, 5e-4);
  EXPECT_NEAR(derivative(WithCompliance<-8>()), 0.187, 5e-4);
  EXPECT_NEAR(derivative(WithCompliance<-10>()), 0.0023, 5e-5);
}

TEST(XpbdTest, DerivativeIsThatOfDifferences) {
  for (const double friction : {0.2, 3.0}) {
    Scene scene = ObliqueCollision();
    scene.contact.friction = friction;
    ExpectStepDerivative<Xpbd>(scene);
    scene = Corner();
    scene.bodies[0].position += Vec2d(3e-4, 4e-4);  // no impact at the end of a substep
    scene.contact.friction = friction;
    ExpectStepDerivative<Xpbd>(scene);
  }
}

TEST(XpbdTest, JetsHaveScalarBits) {
  for (const double friction : {0.0, 0.2, 3.0}) {
    Scene scene = ObliqueCollision();
    scene.contact.friction = friction;
    ExpectJetsHaveScalarBits<Xpbd>(scene);
    scene = Corner();
    scene.contact.friction = friction;
    ExpectJetsHaveScalarBits<Xpbd>(scene);
  }
}

TEST(XpbdTest, UnequalMassesKeepMomentum) { ExpectMomentumConserved<Xpbd>(ObliqueCollision()); }

TEST(XpbdTest, FixedDiscActsAsHeavyOne) { ExpectFixedActsAsHeavy<Xpbd>(ObliqueCollision()); }

TEST(XpbdTest, SlidingDiscStops) {
  for (const SlidingDisc& slide : {Slide<Xpbd>(), Slide<PublishedBound>()}) {
    EXPECT_NEAR(slide.speed_at_half, 1 - 0.1 * 9.8 * 0.5, 1e-3);
    EXPECT_NEAR(slide.speed_at_end, 0, 1e-9);
  }
}

}  // namespace
}  // namespace saltus::testing
