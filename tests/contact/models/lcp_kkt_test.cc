#include "contact/models/lcp_kkt.h"

#include "contact/formulation.h"
#include "contact/models/qcqp.h"
#include "contact/two_contacts.h"

extern template class saltus::ContactStepOf<saltus::LcpKkt, double>;
extern template class saltus::ContactStepOf<saltus::Qcqp, double>;

namespace saltus::testing {
namespace {

const auto kLcpKkt = Compiled<LcpKkt>(), kForceOnce = Compiled<LcpKkt>({{"force_once", 1}}),
           kReleasedBackward = Compiled<LcpKkt>({{"released_backward", 1}});

// Values of an independent implementation.
TEST(LcpKktTest, Tasks) {
  ExpectBounceOnce(kLcpKkt, BounceOnce(), {1.200000, 1, -0.1, -0.0002083});
  ExpectGroundWall(kLcpKkt, GroundWall(0), {8.313500, 1.569179, -0.150568});
  ExpectGroundWall(kLcpKkt, GroundWall(0.1), {11.483688, 3.032857, 0.257902});
  ExpectTwoBalls(kLcpKkt, TwoBalls(), {2.056534, 0, -0.716288, -0.221774, -0.494514, 0.0007880});
}

TEST(LcpKktTest, ForceOnce) {
  ExpectGroundWall(kForceOnce, GroundWall(0.1), {11.496895, 3.038928, 0.256280});
  ExpectTwoBalls(kForceOnce, TwoBalls(), {2.050961, 0, -0.708464, -0.219351, -0.489113, 0.0007930});
}

TEST(LcpKktTest, ReleasedBackward) {
  ExpectGroundWall(kReleasedBackward, GroundWall(0.1), {11.483688, 3.056283, -0.073420});
}

// The exact loss as impacts are found more finely.
TEST(LcpKktTest, ConvergesToExactImpacts) {
  const double exact = 8.316138582;
  const auto error_with = [&](double eps) {
    return std::abs(LossOf(Compiled<LcpKkt>({{"eps", eps}, {"tolerance", 0.1 * eps}}), GroundWall(0)) - exact);
  };
  const double error[] = {error_with(1e-3), error_with(1e-4), error_with(1e-6)};
  EXPECT_LT(error[1], 0.6 * error[0]);
  EXPECT_LT(error[2], error[1]);
  EXPECT_LT(error[2], 3e-3);
}

// A disc that slides as it bounces: its tangential velocity depends on the normal one by mu (1 + e), and not the other
// way round. The source's backward pass has it the other way round.
TEST(LcpKktTest, ReleasedBackwardTransposesFriction) {
  Scene scene = Corner(true);
  scene.bodies[0].position = {0, 0.1 + 5e-7};
  scene.bodies[0].velocity = {5, -3};
  scene.contact.friction = 0.1;
  scene.contact.restitution = 0.92;
  StepArguments<StepJet<double>> arguments = Arguments<StepJet<double>>(scene);
  arguments.x[0].v[0].v[0] = 1;
  arguments.x[0].v[1].v[1] = 1;
  const auto right = StepOnce(kLcpKkt, scene, arguments)[0].v,
             released = StepOnce(kReleasedBackward, scene, arguments)[0].v;
  EXPECT_NEAR(right[0].v[0], 1, 1e-6);
  EXPECT_NEAR(right[0].v[1], 0.192, 1e-6);
  EXPECT_NEAR(right[1].v[0], 0, 1e-6);
  EXPECT_NEAR(right[1].v[1], -0.92, 1e-6);
  EXPECT_NEAR(released[0].v[1], 0, 1e-6);
  EXPECT_NEAR(std::abs(released[1].v[0]), 0.1, 1e-6);
}

TEST(LcpKktTest, DerivativeIsThatOfDifferences) {
  for (const double friction : {0.2, 3.0}) {  // sliding; held
    Scene scene = ObliqueCollision();
    scene.contact.friction = friction;
    ExpectStepDerivative(kLcpKkt, scene);
  }
}

TEST(LcpKktTest, UnequalMassesKeepMomentum) { ExpectMomentumConserved(kLcpKkt, ObliqueCollision()); }

TEST(LcpKktTest, FixedDiscActsAsHeavyOne) { ExpectFixedActsAsHeavy(kLcpKkt, ObliqueCollision()); }

TEST(LcpKktTest, SlidingDiscStops) {
  const SlidingDisc slide = Slide(kLcpKkt);
  EXPECT_NEAR(slide.speed_at_half, 0.51, 1e-6);
  EXPECT_NEAR(slide.speed_at_end, 0, 1e-6);
}

// Without forces it poses the same problem as the staggered programs, on overlapping pairs.
TEST(LcpKktTest, AgreesWithStaggeredProgramsOnTwoContacts) { ExpectAgreement(kLcpKkt, Compiled<Qcqp>(), 1e-8, 1e-6); }

}  // namespace
}  // namespace saltus::testing
