#include "contact/models/qcqp.h"

#include "contact/formulation.h"
#include "contact/models/lcp_pgs.h"
#include "contact/two_contacts.h"

extern template class saltus::ContactStepOf<saltus::Qcqp, double>;
extern template class saltus::ContactStepOf<saltus::LcpPgs<false>, double>;

namespace saltus::testing {
namespace {

const auto kQcqp = Compiled<Qcqp>();

// Values of an independent implementation.
TEST(QcqpTest, Tasks) {
  ExpectBounceOnce(kQcqp, BounceOnce(), {1.191667, 1, -0.095833, -0.0001997});
  ExpectGroundWall(kQcqp, GroundWall(0), {8.386549, 1.589760, -0.152994});
  ExpectGroundWall(kQcqp, GroundWall(0.1), {11.543684, 3.055882, 0.258351});
  ExpectTwoBalls(kQcqp, TwoBalls(), {2.058114, 0, -0.718490, -0.221534, -0.496955, 0.0007885});
}

TEST(QcqpTest, DerivativeIsThatOfDifferences) {
  for (const double friction : {0.2, 3.0}) {  // sliding; held
    Scene scene = ObliqueCollision(true);
    scene.contact.friction = friction;
    ExpectStepDerivative(kQcqp, scene);
  }
  ExpectStepDerivative(kQcqp, Corner(true));
}

TEST(QcqpTest, JetsHaveScalarBits) {
  ExpectJetsHaveScalarBits(kQcqp, ObliqueCollision(true));
  ExpectJetsHaveScalarBits(kQcqp, Corner(true));
}

// Two walls that hold a disc by friction of 3 on both: the passes do not end, and the step says so.
TEST(QcqpTest, NoResultWithoutConvergence) {
  Scene scene = Corner(true);
  scene.contact.friction = 3;
  EXPECT_TRUE(std::isnan(StepOnce(kQcqp, scene)[0].v[0]));
}

TEST(QcqpTest, UnequalMassesKeepMomentum) { ExpectMomentumConserved(kQcqp, ObliqueCollision(true)); }

TEST(QcqpTest, FixedDiscActsAsHeavyOne) { ExpectFixedActsAsHeavy(kQcqp, ObliqueCollision(true)); }

TEST(QcqpTest, SlidingDiscStops) {
  const SlidingDisc slide = Slide(kQcqp);
  EXPECT_NEAR(slide.speed_at_half, 0.51, 1e-9);
  EXPECT_NEAR(slide.speed_at_end, 0, 1e-9);
}

// A program whose solution is known: one coordinate at each bound, one inside.
TEST(BoxQpTest, BoundsHold) {
  Eigen::MatrixXd A(3, 3);
  A << 2, 0.5, 0, 0.5, 1, 0.2, 0, 0.2, 4;
  const Eigen::VectorXd low = Eigen::VectorXd::Zero(3), high = Eigen::VectorXd::Ones(3);
  const Eigen::VectorXd x = SolveBoxQp(A, Eigen::Vector3d(-5, 1, -1), low, high, low).value();
  EXPECT_EQ(x[0], 1);
  EXPECT_EQ(x[1], 0);
  EXPECT_NEAR(x[2], 0.25, 1e-15);
}

// Without forces restitution before and after them is the same, and the two solvers must agree, in value and
// derivative, on two coupled contacts.
TEST(QcqpTest, AgreesWithGaussSeidelOnTwoContacts) {
  ExpectAgreement(kQcqp, Compiled<LcpPgs<false>>({{"erp", 0}, {"sweeps", 5000}}), 1e-12, 1e-10);
}

}  // namespace
}  // namespace saltus::testing
