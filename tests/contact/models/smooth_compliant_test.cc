#include "contact/models/smooth_compliant.h"

#include "contact/formulation.h"

extern template class saltus::ContactStepOf<saltus::SmoothCompliant, double>;

namespace saltus::testing {
namespace {

const auto kSmoothCompliant = Compiled<SmoothCompliant>(), kStiffer = Compiled<SmoothCompliant>({{"substeps", 10}}),
           kOneSubstep = Compiled<SmoothCompliant>({{"substeps", 1}}),
           kHertz = Compiled<SmoothCompliant>({{"exponent", 1.5}, {"substeps", 1}});

Scene WithStiffness(Scene scene, double stiffness) {
  scene.contact.stiffness = stiffness;
  return scene;
}

// Values of an independent implementation.
TEST(SmoothCompliantTest, BounceOnce) {
  ExpectBounceOnce(kSmoothCompliant, BounceOnce(), {1.155921, -1.001192, -0.989539, -0.0020599});
  ExpectBounceOnce(kStiffer, WithStiffness(BounceOnce(), 1e5), {1.175207, -0.999992, -0.993801, -0.0020685});
  ExpectBounceOnce(kHertz, BounceOnce(), {1.145065, -2.315839, -1.565547, -0.0032616});
}

// They were computed with d rounded to 0.026069 s/m, which shows in the sixth decimal.
TEST(SmoothCompliantTest, GroundWall) {
  ExpectGroundWall(kSmoothCompliant, GroundWall(0), {8.649727, -3.130507, -0.130793}, 3e-6);
  ExpectGroundWall(kStiffer, WithStiffness(GroundWall(0), 1e5), {8.487781, -3.117333, -0.137288}, 3e-6);
  ExpectGroundWall(kSmoothCompliant, GroundWall(0.1), {11.748358, -3.811790, -0.675428}, 3e-6);
  ExpectGroundWall(kStiffer, WithStiffness(GroundWall(0.1), 1e5), {11.586129, -3.811630, -0.680234}, 3e-6);
}

TEST(SmoothCompliantTest, TwoBalls) {
  ExpectTwoBalls(kSmoothCompliant, TwoBalls(), {2.071400, -0.421095, -0.315655, -0.514564, -0.222186, 0.0001787});
  ExpectTwoBalls(
      kStiffer, WithStiffness(TwoBalls(), 1e5), {2.066072, -0.410692, -0.318790, -0.506834, -0.222648, 0.0001949});
  ExpectTwoBalls(kOneSubstep, TwoBalls(), {2.068787, -0.339220, -0.393974, -0.456963, -0.276231, 0.0002980});
  ExpectTwoBalls(kHertz, TwoBalls(), {2.073077, -0.745019, 0.005997, -0.738509, -0.000513, -0.0002886});
}

// The speed v' after an impact with v solves d (v + v') = ln((1 + d v) / (1 - d v')).
TEST(SmoothCompliantTest, DissipationGivesTheRestitution) {
  EXPECT_NEAR(SmoothCompliant::ScaledDissipation(1.9480484 / 2), 0.02 * 2, 1e-7);
  EXPECT_NEAR(SmoothCompliant::ScaledDissipation(1.7643800 / 2), 0.1 * 2, 1e-6);
  EXPECT_NEAR(SmoothCompliant::ScaledDissipation(0.92) / 5, 0.026069, 5e-7);
  EXPECT_EQ(SmoothCompliant::ScaledDissipation(1), 0);
  for (const double e : {0.2, 0.5, 0.999, 0.9999999, 1.001}) {
    const double x = SmoothCompliant::ScaledDissipation(e);
    EXPECT_NEAR(x * (1 + e), std::log((1 + x) / (1 - e * x)), 1e-12 * std::abs(x * (1 + e)) + 1e-16) << e;
    if (e > 0.99) {
      EXPECT_NEAR(x, 1.5 * (1 - e), 2 * (1 - e) * (1 - e)) << e;
    }
  }
}

// At the reference speed, and with any exponent, the scene's restitution comes out as the step shrinks.
double ReboundSpeed(const Model& model) {
  Scene scene = BounceOnce();
  scene.duration = 0.2;
  scene.steps = 20000;
  scene.bodies[0].position = {0, 0.35};
  scene.bodies[0].velocity = {0, -5};
  scene.contact.restitution = 0.7;
  scene.contact.stiffness = 1e5;
  scene.objective.terminal = {{.body = 0, .quantity = TerminalTerm::Quantity::kVelocity, .component = 1}};
  return LossOf(model, scene);
}
TEST(SmoothCompliantTest, RestitutionAtTheReferenceSpeed) {
  EXPECT_NEAR(ReboundSpeed(kSmoothCompliant), 0.7 * 5, 1e-4);
  EXPECT_NEAR(ReboundSpeed(kHertz), 0.7 * 5, 1e-3);
}

// To the exact loss and gradient of two_balls as the step goes to zero and the stiffness to infinity.
TEST(SmoothCompliantTest, GradientConvergesToThatOfExactImpacts) {
  double error[3];
  for (int i = 0; i < 3; ++i) {
    Scene scene = WithStiffness(TwoBalls(), 1e4 * std::pow(100, i));
    scene.steps = 480 << (2 * i);
    const double gradient = LossDerivative(kSmoothCompliant, scene, "dp1_x");
    error[i] = std::abs(gradient + 0.398668);
  }
  // The contact's length, which is the error, goes with stiffness^(-1/4) at this exponent.
  EXPECT_LT(error[1], 0.45 * error[0]);
  EXPECT_LT(error[2], 0.45 * error[1]);
  EXPECT_LT(error[2], 0.005);
}

TEST(SmoothCompliantTest, DerivativeIsThatOfDifferences) {
  for (const double friction : {0.0, 0.2}) {
    Scene scene = ObliqueCollision(true);
    scene.contact.friction = friction;
    ExpectStepDerivative(kSmoothCompliant, scene);
    ExpectStepDerivative(kSmoothCompliant, Corner(true));
  }
}

TEST(SmoothCompliantTest, JetsHaveScalarBits) {
  ExpectJetsHaveScalarBits(kSmoothCompliant, ObliqueCollision(true));
  ExpectJetsHaveScalarBits(kSmoothCompliant, Corner(true));
}

TEST(SmoothCompliantTest, UnequalMassesKeepMomentum) {
  ExpectMomentumConserved(kSmoothCompliant, ObliqueCollision(true));
}

TEST(SmoothCompliantTest, FixedDiscActsAsHeavyOne) { ExpectFixedActsAsHeavy(kSmoothCompliant, ObliqueCollision(true)); }

// A disc that slides on the ground at 1 m/s: slowed by mu g, then at rest.
TEST(SmoothCompliantTest, SlidingDiscStops) {
  const SlidingDisc slide = Slide(kSmoothCompliant);
  EXPECT_NEAR(slide.speed_at_half, 1 - 0.1 * 9.8 * 0.5, 1e-3);
  EXPECT_NEAR(slide.speed_at_end, 0, 1e-6);
}

}  // namespace
}  // namespace saltus::testing
