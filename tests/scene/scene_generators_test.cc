#include "scene/scene_generators.h"

#include <gtest/gtest.h>

#include <cmath>
#include <numbers>
#include <set>

#include "saltus/scene/scene_file.h"
#include "scene/control_problems.h"

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
    const Scene pile = FallingPile({.discs = discs}, 7);
    EXPECT_EQ(pile.num_bodies(), discs);
    EXPECT_FALSE(Validate(pile)) << Validate(pile)->message;
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
  EXPECT_EQ(FallingPile({}, 4), FallingPile({}, 4));
  EXPECT_NE(FallingPile({}, 4), FallingPile({}, 5));
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

TEST(SceneGenerators, DiscsOfAPileHaveOneDensityAndFallBetweenWalls) {
  const Scene pile = FallingPile({.discs = 90, .radius = 0.2}, 1);
  for (const Body& body : pile.bodies) {
    EXPECT_NEAR(body.radius, 0.2, 0.02);
    EXPECT_NEAR(body.mass, body.radius * body.radius / 0.04, 1e-12);
    for (const Plane& plane : pile.planes) {
      EXPECT_GT(plane.normal.dot(body.position - plane.point), body.radius) << body.name << " " << plane.name;
    }
  }
  EXPECT_LT(pile.gravity[1], 0);
}

TEST(ControlProblems, AreValidAndOfTenKinds) {
  std::set<std::string> kinds, texts;
  for (int seed = 0; seed < 200; ++seed) {
    const Scene scene = ControlProblem(seed);
    const std::optional<SceneError> error = Validate(scene);
    EXPECT_FALSE(error) << seed << ": " << error->ToString();
    EXPECT_EQ(scene.steps, 120);
    EXPECT_EQ(scene.optimize, Optimize::kControl);
    EXPECT_GT(scene.objective.effort, 0);
    EXPECT_EQ(scene.name, std::string(kControlKinds[seed % 10]) + "_" + std::to_string(seed));
    kinds.insert(scene.name.substr(0, scene.name.rfind('_')));
    texts.insert(WriteScene(scene));
    EXPECT_EQ(ControlProblem(seed), scene);
  }
  EXPECT_EQ(kinds.size(), 10u);
  EXPECT_EQ(texts.size(), 200u);
}

TEST(ControlProblems, HaveWhatTheirKindSays) {
  for (int seed = 0; seed < 50; seed += 10) {
    EXPECT_EQ(ControlProblem(seed).num_bodies(), 2);
    EXPECT_GT(ControlProblem(seed + 1).gravity.norm(), 0);
    EXPECT_EQ(ControlProblem(seed + 2).planes.size(), 1u);
    EXPECT_EQ(ControlProblem(seed + 3).planes.size(), 4u);
    EXPECT_GE(ControlProblem(seed + 4).num_bodies(), 3);
    EXPECT_EQ(ControlProblem(seed + 5).objective.terminal.back().body, 2);
    EXPECT_EQ(ControlProblem(seed + 6).num_controlled(), 2);
    EXPECT_EQ(ControlProblem(seed + 7).objective.terminal.back().quantity, TerminalTerm::Quantity::kVelocity);
    EXPECT_GT(ControlProblem(seed + 8).contact.friction, 0);
    EXPECT_TRUE(ControlProblem(seed + 9).bodies.back().fixed);
  }
}

// Every number has at most four digits after the point, whatever a machine makes of sums and products.
TEST(ControlProblems, NumbersAreRounded) {
  for (int seed = 0; seed < 100; ++seed) {
    const Scene scene = ControlProblem(seed);
    for (const Body& body : scene.bodies) {
      for (const double x : {body.position[0], body.position[1], body.velocity[0], body.velocity[1], body.radius}) {
        EXPECT_EQ(std::round(x * 1e4) / 1e4, x) << scene.name;
      }
    }
  }
}

// Compares the first number drawn: the duration, 0.8 + 0.8 of a number in [0, 1).
TEST(ControlProblems, AreTheSameEverywhere) {
  const double unit = static_cast<double>(14514284786278117030u >> 11) * 0x1p-53;
  EXPECT_EQ(ControlProblem(5489).duration, std::round((0.8 + 0.8 * unit) * 1e4) / 1e4);
}

}  // namespace
}  // namespace saltus
