#include "contact/models/ipc_barrier.h"

#include "contact/formulation.h"

extern template class saltus::ContactStepOf<saltus::IpcBarrier, double>;

namespace saltus::testing {
namespace {

const auto kIpcBarrier = Compiled<IpcBarrier>(), kOneSubstep = Compiled<IpcBarrier>({{"substeps", 1}}),
           kTrapezoidal = Compiled<IpcBarrier>({{"trapezoidal", 1}}),
           kTrapezoidalOnce = Compiled<IpcBarrier>({{"trapezoidal", 1}, {"substeps", 1}}),
           kStiff = Compiled<IpcBarrier>({{"substeps", 1}, {"range", 1e-3}, {"kappa", 1e8}});

// Values of an independent implementation.
TEST(IpcBarrierTest, BounceOnce) {
  ExpectBounceOnce(kIpcBarrier, BounceOnce(), {1.016769, -0.943815, -0.833740, -0.0017351});
  ExpectBounceOnce(kOneSubstep, BounceOnce(), {0.413224, 0.693613, 0.209052, 0.0004355});
  ExpectBounceOnce(kTrapezoidal, BounceOnce(), {1.205818, -1.436741, -1.191104, -0.0024783});
  ExpectBounceOnce(kTrapezoidalOnce, BounceOnce(), {1.202342, 21.301302, 8.962491, 0.0186256});
}

TEST(IpcBarrierTest, GroundWall) {
  ExpectGroundWall(kIpcBarrier, GroundWall(0), {9.431048, -2.260489, 0.141542});
  ExpectGroundWall(kOneSubstep, GroundWall(0), {14.082940, 0.067432, 0.000360});
  ExpectGroundWall(kTrapezoidal, GroundWall(0), {8.131952, -3.363930, -0.364493});
  ExpectGroundWall(kIpcBarrier, GroundWall(0.1), {11.611951, -2.947864, -0.212151});
  ExpectGroundWall(kTrapezoidal, GroundWall(0.1), {11.644113, -3.956199, -0.948615});
}

TEST(IpcBarrierTest, TwoBalls) {
  ExpectTwoBalls(kIpcBarrier, TwoBalls(), {2.174986, -0.464993, -0.401016, -0.544185, -0.321824, 0.0001172});
  ExpectTwoBalls(kOneSubstep, TwoBalls(), {2.526300, -0.722582, -0.482656, -0.682088, -0.523150, -0.0001710});
  ExpectTwoBalls(kTrapezoidal, TwoBalls(), {2.057596, -0.290515, -0.427254, -0.422382, -0.295386, 0.0003707});
  ExpectTwoBalls(kTrapezoidalOnce, TwoBalls(), {2.068628, -1.361136, 0.628159, -1.173041, 0.440063, -0.0011909});
}

// Stiff and with implicit Euler: the plastic impact.
TEST(IpcBarrierTest, StiffImplicitEulerIsPlastic) {
  EXPECT_NEAR(LossOf(kStiff, BounceOnce()), 0.112, 5e-4);
  EXPECT_NEAR(LossOf(kStiff, TwoBalls()), 2.536, 1e-3);
  EXPECT_NEAR(LossDerivative(kStiff, TwoBalls(), "dp1_x"), -0.6067, 1e-3);
}

// In the range of the barrier, not overlapping.
Scene Near(Scene scene) {
  for (Body& body : scene.bodies) body.velocity *= 0.3;
  return scene;
}

TEST(IpcBarrierTest, DerivativeIsThatOfDifferences) {
  ExpectStepDerivative(kIpcBarrier, ObliqueCollision());
  ExpectStepDerivative(kIpcBarrier, Near(ObliqueCollision()));
  ExpectStepDerivative(kTrapezoidal, Near(ObliqueCollision()));
  ExpectStepDerivative(kIpcBarrier, Near(Corner()));
}

TEST(IpcBarrierTest, UnequalMassesKeepMomentum) {
  Scene scene = ObliqueCollision();
  Vec2d expected(0, 0);
  for (const Body& body : scene.bodies) expected += body.mass * body.velocity;
  for (const Vec2d& force : scene.control.initial) expected += scene.dt() * force;
  ExpectNear(Momentum(scene, StepOnce(kIpcBarrier, scene)), expected, 1e-10);
}

TEST(IpcBarrierTest, FixedDiscActsAsHeavyOne) { ExpectFixedActsAsHeavy(kIpcBarrier, ObliqueCollision()); }

TEST(IpcBarrierTest, NoGapEverCloses) {
  Scene scene = ObliqueCollision();
  for (Body& body : scene.bodies) body.velocity *= 50;
  const auto next = StepOnce(kIpcBarrier, scene);
  EXPECT_GT((next[0].p - next[1].p).norm(), 0.5);
  EXPECT_LT((next[0].p - next[1].p)[0], 0);  // not passed through
}

// From the gap that carries the weight.
TEST(IpcBarrierTest, SlidingDiscStops) {
  const SlidingDisc slide = Slide(kIpcBarrier, 0.1 + 9.439e-3);
  EXPECT_NEAR(slide.speed_at_half, 0.51, 1e-4);
  EXPECT_NEAR(slide.speed_at_end, 0, 1e-4);
}

TEST(IpcBarrierTest, TouchingSceneIsNotApplicable) {
  EXPECT_EQ(IpcBarrier::ReasonNotApplicable(GroundWall(0)), "");
  Scene scene = GroundWall(0);
  scene.bodies[0].position[1] = 0.1;
  EXPECT_THAT(IpcBarrier::ReasonNotApplicable(scene), ::testing::HasSubstr("touches ground"));
  scene = TwoBalls();
  scene.bodies[0].position = {-1.4, -1};
  EXPECT_THAT(IpcBarrier::ReasonNotApplicable(scene), ::testing::HasSubstr("touch at the start"));
}

}  // namespace
}  // namespace saltus::testing
