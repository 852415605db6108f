#include "physics/scene_generators.h"

#include <gtest/gtest.h>

#include <cmath>
#include <numbers>

namespace saltus {
namespace {

TEST(SceneGenerators, MakeValidScenesOfAnySize) {
  for (int discs : {1, 2, 3, 10, 99, 100, 1000}) {
    for (double fraction : {0.05, 0.35}) {
      const Scene gas = GasInABox({.discs = discs, .fraction = fraction}, 7);
      EXPECT_EQ(gas.num_bodies(), discs);
      const std::optional<SceneError> error = Validate(gas);
      EXPECT_FALSE(error) << error->key << " " << error->message;
    }
    if (discs < 2) continue;
    const Scene rack = BilliardBreak({.discs = discs}, 7);
    EXPECT_EQ(rack.num_bodies(), discs);
    const std::optional<SceneError> error = Validate(rack);
    EXPECT_FALSE(error) << error->key << " " << error->message;
  }
}

TEST(SceneGenerators, GasHasTheDensityAndSpeedAskedFor) {
  const Scene gas = GasInABox({.discs = 1000, .radius = 0.02, .fraction = 0.3, .speed = 2}, 1);
  const double side = gas.planes[1].point[0];
  EXPECT_NEAR(1000 * std::numbers::pi * 0.02 * 0.02 / (side * side), 0.3, 1e-12);
  double squares = 0;
  for (const Body& body : gas.bodies) squares += body.velocity.squaredNorm();
  EXPECT_NEAR(std::sqrt(squares / 1000), 2, 0.1);
}

TEST(SceneGenerators, SeedDecides) {
  EXPECT_EQ(GasInABox({}, 4), GasInABox({}, 4));
  EXPECT_NE(GasInABox({}, 4), GasInABox({}, 5));
  EXPECT_EQ(BilliardBreak({}, 4), BilliardBreak({}, 4));
  EXPECT_NE(BilliardBreak({}, 4), BilliardBreak({}, 5));
}

// The first number of the 64-bit Mersenne twister of seed 5489 is 14514284786278117030 (Nishimura and Matsumoto).
TEST(SceneGenerators, NumbersAreTheSameEverywhere) {
  const Scene gas = GasInABox({.discs = 1, .radius = 0.1, .fraction = 0.1}, 5489);
  const double side = gas.planes[1].point[0];
  const double uniform = 2 * static_cast<double>(14514284786278117030u >> 11) * 0x1p-53 - 1;
  EXPECT_DOUBLE_EQ(gas.bodies[0].position[0], 0.5 * side + 0.9 * (0.5 * side - 0.1) * uniform);
}

TEST(SceneGenerators, TheCueBallHitsTheRack) {
  const Scene rack = BilliardBreak({.discs = 16}, 1);
  EXPECT_LT(rack.bodies[0].position[0] + 2 * rack.bodies[0].radius, rack.bodies[1].position[0]);
  EXPECT_GT(rack.bodies[0].velocity[0], 0);
}

}  // namespace
}  // namespace saltus
