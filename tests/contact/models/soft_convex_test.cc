#include "contact/models/soft_convex.h"

#include "contact/formulation.h"
#include "contact/models/compliant_warp.h"

extern template class saltus::ContactStepOf<saltus::CompliantWarp, double>;
extern template class saltus::ContactStepOf<saltus::SoftConvex, double>;

namespace saltus::testing {
namespace {

const auto kSoftConvex = Compiled<SoftConvex>(), kSmooth = Compiled<SoftConvex>({{"dmin", 1e-4}, {"width", 0.01}});
// MuJoCo's own default: critically damped.
const auto kCritical = Compiled<SoftConvex>({{"damping", 100}});

Scene WithStiffness(Scene scene, double stiffness) {
  scene.contact.stiffness = stiffness;
  return scene;
}

// Values of an independent implementation.
TEST(SoftConvexTest, BounceOnce) {
  ExpectBounceOnce(kSoftConvex, BounceOnce(), {1.138184, -2.361910, -1.581975, -0.0032958});
  ExpectBounceOnce(kSmooth, BounceOnce(), {1.137111, 0.021101, -0.508857, -0.0010601});
  ExpectBounceOnce(kCritical, WithStiffness(BounceOnce(), 2500), {0.233110, -7.058874, -3.243048, -0.0067564});
}

TEST(SoftConvexTest, GroundWall) {
  ExpectGroundWall(kSoftConvex, GroundWall(0), {9.129635, -3.260951, -0.263034});
  ExpectGroundWall(kSmooth, GroundWall(0), {9.125507, -1.823150, -0.677883});
  ExpectGroundWall(kCritical, WithStiffness(GroundWall(0), 2500), {14.849879, -4.437973, 0});
  ExpectGroundWall(kSoftConvex, GroundWall(0.1), {12.111338, -7.311663, -3.188644});
  ExpectGroundWall(kSmooth, GroundWall(0.1), {12.173009, -2.633782, 0.103077});
}

TEST(SoftConvexTest, TwoBalls) {
  ExpectTwoBalls(kSoftConvex, TwoBalls(), {2.083250, -0.867491, 0.114828, -0.820158, 0.067496, -0.0004587});
  ExpectTwoBalls(kSmooth, TwoBalls(), {2.082646, -2.250100, 1.498242, -1.777433, 1.025574, -0.0024530});
  ExpectTwoBalls(
      kCritical, WithStiffness(TwoBalls(), 2500), {2.537098, -0.608965, -0.605200, -0.608400, -0.605765, -0.0000175});
}

// With a constant impedance and without forces a contact is a linear spring.
TEST(SoftConvexTest, ConstantImpedanceIsASpring) {
  Scene scene = ObliqueCollision(true);
  scene.control = {};
  scene.contact = {.restitution = 1, .friction = 0, .stiffness = 1e4, .damping = 0};
  const SoftConvex defaults;
  const auto constant_impedance = Compiled<SoftConvex>({{"damping", 0}, {"dmin", defaults.impedance.at_width}});
  const auto soft = StepOnce(constant_impedance, scene);
  scene.contact.stiffness *= 0.75;  // of the pair's effective mass
  const auto spring = StepOnce(Compiled<CompliantWarp>(), scene);
  for (int i = 0; i < 2; ++i) {
    ExpectNear(soft[i].v, spring[i].v, 1e-12);
    ExpectNear(soft[i].p, spring[i].p, 1e-13);
  }
}

TEST(SoftConvexTest, DerivativeIsThatOfDifferences) {
  for (const double friction : {0.2, 3.0}) {  // sliding; held
    Scene scene = ObliqueCollision(true);
    scene.contact.friction = friction;
    ExpectStepDerivative(kSoftConvex, scene);
    scene = Corner(true);
    scene.contact.friction = friction;
    ExpectStepDerivative(kSoftConvex, scene);
  }
}

TEST(SoftConvexTest, CoupledContactsShareTheLoad) {
  // A disc in a right-angled corner: the two normals do not couple, so each plane pushes as it would alone.
  Scene corner = Corner(true);
  corner.contact.friction = 0;
  const Vec2d both = StepOnce(kSoftConvex, corner)[0].v;
  Scene ground = corner, wall = corner;
  ground.planes.resize(1);
  wall.planes.erase(wall.planes.begin());
  EXPECT_NEAR(both[1], StepOnce(kSoftConvex, ground)[0].v[1], 1e-13);
  EXPECT_NEAR(both[0], StepOnce(kSoftConvex, wall)[0].v[0], 1e-13);
  // Two planes at 60 degrees that are pressed alike push alike, and less than one of them alone would.
  Scene wedge = corner;
  wedge.bodies[0].position = {0, 0.199};
  wedge.bodies[0].velocity = {0, -1};
  const double s = std::sqrt(3) / 2;
  wedge.planes = {{.name = "left", .point = {0, 0}, .normal = {s, 0.5}},
                  {.name = "right", .point = {0, 0}, .normal = {-s, 0.5}}};
  const Vec2d v = StepOnce(kSoftConvex, wedge)[0].v;
  EXPECT_NEAR(v[0], 0, 1e-14);
  EXPECT_GT(v[1], -1);
}

TEST(SoftConvexTest, JetsHaveScalarBits) {
  for (const double friction : {0.0, 0.2}) {
    Scene scene = ObliqueCollision(true);
    scene.contact.friction = friction;
    ExpectJetsHaveScalarBits(kSoftConvex, scene);
    scene = Corner(true);
    scene.contact.friction = friction;
    ExpectJetsHaveScalarBits(kSoftConvex, scene);
  }
}

TEST(SoftConvexTest, UnequalMassesKeepMomentum) { ExpectMomentumConserved(kSoftConvex, ObliqueCollision(true)); }

TEST(SoftConvexTest, FixedDiscActsAsHeavyOne) { ExpectFixedActsAsHeavy(kSoftConvex, ObliqueCollision(true)); }

TEST(SoftConvexTest, SlidingDiscStops) {
  const SlidingDisc slide = Slide(kCritical);
  EXPECT_NEAR(slide.speed_at_half, 0.5092, 2e-3);
  EXPECT_NEAR(slide.speed_at_end, 0, 1e-6);
}

}  // namespace
}  // namespace saltus::testing
