#include "contact/models/ncp.h"

#include "contact/formulation.h"
#include "contact/models/qcqp.h"
#include "contact/two_contacts.h"

extern template class saltus::ContactStepOf<saltus::Ncp<false>, double>;
extern template class saltus::ContactStepOf<saltus::Ncp<true>, double>;
extern template class saltus::ContactStepOf<saltus::Qcqp, double>;

namespace saltus::testing {
namespace {

const auto kPlastic = Compiled<Ncp<false>>();
const auto kBouncing = Compiled<Ncp<true>>();

ContactStepOf<Ncp<false>, double> AtKappa(double kappa) { return Compiled<Ncp<false>>({{"kappa", kappa}}); }

// Values of an independent implementation.
TEST(NcpTest, BounceOnce) {
  // The gap predicted for the step of the impact is exactly zero: the derivative hangs on kappa.
  ExpectBounceOnce(kPlastic, BounceOnce(), {0.103833, -1.397005, -0.628653, -0.0013097});
  ExpectBounceOnce(AtKappa(1e-4), BounceOnce(), {0.477159, -1.371245, -0.636862, -0.0013268});
}

TEST(NcpTest, GroundWall) {
  ExpectGroundWall(kPlastic, GroundWall(0), {15.275040, 0.000029, 0});
  ExpectGroundWall(kPlastic, GroundWall(0.1), {15.282444, -0.005373, -0.000537});
}

TEST(NcpTest, TwoBalls) {
  ExpectTwoBalls(kPlastic, TwoBalls(), {2.536935, -0.607015, -0.607015, -0.607015, -0.607015, -0.0000146});
  ExpectTwoBalls(AtKappa(1e-4), TwoBalls(), {2.448901, -0.794515, -0.344696, -0.732104, -0.407107, -0.0002752});
}

// Rebound with 3.55 sqrt(kappa / h) as kappa goes to zero, and no derivative of what is left off the tie.
double ReboundSpeed(double kappa) {
  Scene scene = BounceOnce();
  scene.objective.terminal = {{.body = 0, .quantity = TerminalTerm::Quantity::kVelocity, .component = 1}};
  return LossOf(AtKappa(kappa), scene);
}
TEST(NcpTest, TendsToAPlasticImpact) {
  EXPECT_NEAR(ReboundSpeed(1e-6), 0.0779, 1e-4);
  EXPECT_NEAR(ReboundSpeed(1e-8), 0.00778, 1e-5);
  EXPECT_NEAR(ReboundSpeed(1e-10), 0.000778, 1e-5);
  Scene off_the_tie = BounceOnce();
  off_the_tie.bodies[0].position[1] = 1.001;
  EXPECT_NEAR(LossDerivative(kPlastic, off_the_tie, "dp_y"), 7e-4, 1e-4);
  EXPECT_NEAR(LossDerivative(AtKappa(1e-10), off_the_tie, "dp_y"), 1e-5, 5e-6);
}

// Resting on the ground: gap = kappa / (h m g).
TEST(NcpTest, RestsAtAGap) {
  Scene scene = BounceOnce();
  scene.gravity = {0, -9.8};
  scene.bodies[0].position = {0, 0.1005};
  scene.bodies[0].velocity = {0, 0};
  EXPECT_NEAR(LossOf(kPlastic, scene) - 0.1, 1e-8 * 480 / 9.8, 1e-10);
}

TEST(NcpTest, SlidingDiscStops) {
  const SlidingDisc slide = Slide(kPlastic, 0.1 + 4.9e-7);
  EXPECT_NEAR(slide.speed_at_half, 0.51, 1e-5);
  EXPECT_NEAR(slide.speed_at_end, 0, 1e-4);
}

TEST(NcpTest, DerivativeIsThatOfDifferences) {
  for (const double friction : {0.2, 3.0}) {
    Scene scene = ObliqueCollision();
    scene.contact.friction = friction;
    ExpectStepDerivative(AtKappa(1e-5), scene);
    scene = Corner();
    scene.contact.friction = friction;
    ExpectStepDerivative(AtKappa(1e-5), scene);
  }
}

// Values from kappa, derivatives from a larger one.
TEST(NcpTest, RelaxedGradientKeepsTheValue) {
  const auto with_relaxed_gradient = Compiled<Ncp<false>>({{"kappa", 1e-8}, {"kappa_grad", 1e-4}});
  Scene scene = ObliqueCollision();
  const auto relaxed = StepOnce(with_relaxed_gradient, scene), hard = StepOnce(AtKappa(1e-8), scene);
  EXPECT_EQ(relaxed[0].v, hard[0].v);
  StepArguments<StepJet<double>> arguments = Arguments<StepJet<double>>(scene);
  arguments.x[0].p[0].v[0] = 1;
  const double own = StepOnce(AtKappa(1e-4), scene, arguments)[0].v[0].v[0];
  EXPECT_NEAR(StepOnce(with_relaxed_gradient, scene, arguments)[0].v[0].v[0], own, 1e-9 * std::abs(own));
  EXPECT_GT(std::abs(StepOnce(AtKappa(1e-8), scene, arguments)[0].v[0].v[0] - own), 1e-3);
}

TEST(NcpTest, UnequalMassesKeepMomentum) { ExpectMomentumConserved(kPlastic, ObliqueCollision()); }

TEST(NcpTest, FixedDiscActsAsHeavyOne) { ExpectFixedActsAsHeavy(kPlastic, ObliqueCollision()); }

TEST(NcpRestitutionTest, Tasks) {
  ExpectBounceOnce(kBouncing, BounceOnce(), {1.200000, 1, -0.1, -0.0002083});
  ExpectGroundWall(kBouncing, GroundWall(0), {8.277101, 1.555840, -0.159872});
  ExpectGroundWall(kBouncing, GroundWall(0.1), {11.436126, 3.013627, 0.248284});
  ExpectTwoBalls(kBouncing, TwoBalls(), {2.054692, 0, -0.713711, -0.221548, -0.492163, 0.0007884});
}

TEST(NcpRestitutionTest, DerivativeIsThatOfDifferences) {
  Scene scene = ObliqueCollision();
  ExpectStepDerivative(kBouncing, scene);
  ExpectStepDerivative(kBouncing, Corner());
}

TEST(NcpRestitutionTest, UnequalMassesKeepMomentum) { ExpectMomentumConserved(kBouncing, ObliqueCollision()); }

// Without forces and at old positions that overlap, it poses the same problem as the staggered programs.
TEST(NcpRestitutionTest, AgreesWithStaggeredProgramsOnTwoContacts) {
  ExpectAgreement(Compiled<Ncp<true>>({{"kappa", 1e-12}}), Compiled<Qcqp>(), 1e-8, 1e-6);
}

}  // namespace
}  // namespace saltus::testing
