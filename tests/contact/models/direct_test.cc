#include "contact/models/direct.h"

#include "contact/stepping.h"

extern template class saltus::ContactStepOf<saltus::Direct<false>, double>;
extern template class saltus::ContactStepOf<saltus::Direct<true>, double>;

namespace saltus::testing {
namespace {

template <typename M>
class DirectTest : public ::testing::Test {
 protected:
  const ContactStepOf<M, double> model_ = Compiled<M>();
};
using Models = ::testing::Types<Direct<false>, Direct<true>>;
TYPED_TEST_SUITE(DirectTest, Models);

TYPED_TEST(DirectTest, DerivativeIsThatOfDifferences) {
  ExpectStepDerivative(this->model_, ObliqueCollision());
  ExpectStepDerivative(this->model_, Corner());
}

TYPED_TEST(DirectTest, JetsHaveScalarBits) {
  ExpectJetsHaveScalarBits(this->model_, ObliqueCollision());
  ExpectJetsHaveScalarBits(this->model_, Corner());
}

TYPED_TEST(DirectTest, UnequalMassesKeepMomentum) { ExpectMomentumConserved(this->model_, ObliqueCollision()); }

TYPED_TEST(DirectTest, FixedDiscActsAsHeavyOne) { ExpectFixedActsAsHeavy(this->model_, ObliqueCollision()); }

TYPED_TEST(DirectTest, ContactsOfAStepAdd) { ExpectContactsAdd(this->model_, ObliqueCollision()); }

TYPED_TEST(DirectTest, RestitutionIsExactInACorner) {
  const BodyState<double, 0> next = StepOnce(this->model_, Corner())[0];
  ExpectNear(next.v, Vec2d(-0.7 * 1.5, 0.7 * 1), 1e-14);
}

TYPED_TEST(DirectTest, ForcesDoNotEnterThePrediction) {
  Scene scene = Corner();
  scene.bodies[0].velocity = {0, 0};
  scene.gravity = {1e3, -1e3};
  std::vector<Touch> touches;
  StepOnce(this->model_, scene, &touches);
  EXPECT_TRUE(touches.empty());
}

// Without force the impact is found where it is: the disc is where an exact bounce takes it.
TEST(DirectToiTest, ForceFreeBounceIsExact) {
  const Scene scene = Corner();
  const BodyState<double, 0> next = StepOnce(Compiled<Direct<true>>(), scene)[0];
  const double on_wall = 0.01 - (0.9 - 0.895) / 1.5, on_ground = 0.01 - (0.103 - 0.1) / 1;  // s after the impacts
  ExpectNear(next.p, Vec2d(0.9 - 0.7 * 1.5 * on_wall, 0.1 + 0.7 * on_ground), 1e-15);
}

// Slower than 1e-3 m/s the time after the impact is taken as that of 1e-3 m/s.
TEST(DirectToiTest, SlowContactUsesTheClampedSpeed) {
  Scene scene = Corner();
  scene.bodies[0].position = {0, 0.1 - 2e-6};
  scene.bodies[0].velocity = {0, -4e-4};
  const double dv = 1.7 * 4e-4, time_left = (2e-6 + 4e-6) / 1e-3;
  const BodyState<double, 0> next = StepOnce(Compiled<Direct<true>>(), scene)[0];
  EXPECT_NEAR(next.v[1], -4e-4 + dv, 1e-16);
  EXPECT_NEAR(next.p[1], 0.1 - 2e-6 - 0.01 * 4e-4 + time_left * dv, 1e-15);
  ExpectStepDerivative(Compiled<Direct<true>>(), scene);
}

}  // namespace
}  // namespace saltus::testing
