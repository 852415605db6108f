#include "scene/units.h"

#include <gtest/gtest.h>

#include "rescaled_scene.h"
#include "test_scenes.h"

namespace saltus {
namespace {

// The four discs among edges, on a table.
Scene FourDiscsAmongEdges() {
  Scene scene = FourDiscs(0.2);
  scene.segments = {{"segment", {-2, -1.5}, {2, -1.25}}};
  scene.polygons = {{"polygon", {{-3, -3}, {3, -3}, {0, -2}}, EdgePolygon::Solid::kInside}};
  scene.arcs = {{"arc", {0, 0}, 4, 0.5, 2.5}};
  scene.pockets = {{"pocket", {3, 3}, 0.25}};
  scene.table = TableFriction{.friction = 0.1};
  return scene;
}

std::vector<Scene> Scenes() {
  return {ProblemScene("two_balls"), ProblemScene("bounce_once"), FourDiscs(0.2), FourDiscsAmongEdges()};
}

TEST(Units, LengthsTimesMassesAndLossesAreAboutOne) {
  const Scene scene = ToNaturalUnits(
      Rescaled(ProblemScene("two_balls"), {.name = "", .length = 1e-6, .time = 1e5, .mass = 1e3, .loss = 1e-9}));
  EXPECT_GT(scene.bodies[0].radius, 0.05);
  EXPECT_LT(scene.bodies[0].radius, 0.2);
  EXPECT_GE(scene.duration, 0.7);
  EXPECT_LE(scene.duration, 4);
  EXPECT_NEAR(scene.bodies[0].mass, 1, 0.5);
  EXPECT_GT(scene.objective.terminal[0].weight, 0.1);
  EXPECT_LT(scene.objective.terminal[0].weight, 10);
}

TEST(Units, ThePriceOfTheDurationIsAboutOneWhereNoOtherTermIsLarger) {
  Scene scene = ProblemScene("two_balls");
  for (TerminalTerm& term : scene.objective.terminal) term.weight *= 1e-9;
  scene.objective.effort = 1e-9;
  scene.objective.duration = FreeDuration{0.5, 2, 1e3};
  const Scene natural = ToNaturalUnits(scene);
  EXPECT_NEAR(natural.objective.duration->weight * natural.duration, 1, 0.5);
}

TEST(Units, PowersOfTwoGiveTheSameNaturalScene) {
  for (const Scene& scene : Scenes()) {
    const Scene natural = ToNaturalUnits(scene);
    std::vector<Rescaling> all = UnitRescalings();
    for (const Rescaling& by : LossRescalings()) all.push_back(by);
    for (const Rescaling& by : all) {
      Scene rescaled = ToNaturalUnits(Rescaled(scene, by));
      EXPECT_EQ(rescaled.units.length, natural.units.length * by.length) << by.name;
      EXPECT_EQ(rescaled.units.time, natural.units.time * by.time) << by.name;
      EXPECT_EQ(rescaled.units.mass, natural.units.mass * by.mass) << by.name;
      EXPECT_EQ(rescaled.units.loss, natural.units.loss * by.loss) << by.name;
      rescaled.units = natural.units;
      EXPECT_EQ(rescaled, natural) << scene.name << " " << by.name;
    }
  }
}

TEST(Units, ThereAndBackChangesNothing) {
  for (const Scene& scene : Scenes()) {
    for (const Vec2d& shift : {Vec2d(0, 0), Vec2d(2e5, -3e5), Vec2d(1e9, 0)}) {
      const Scene given = Rescaled(scene, {.name = "", .length = 0x1p-7, .shift = shift});
      EXPECT_EQ(ToUnits(ToNaturalUnits(given), {}), given) << scene.name;
    }
  }
}

TEST(Units, TheOriginIsNear) {
  const Scene scene = ToNaturalUnits(Rescaled(FourDiscs(0), {.name = "", .shift = {2e5, -3e5}}));
  for (const Body& body : scene.bodies) EXPECT_LT(body.position.norm(), 64);
  for (const Plane& plane : scene.planes) EXPECT_LT(plane.point.norm(), 64);
  EXPECT_LT(scene.objective.terminal[0].target.norm(), 64);
  EXPECT_EQ(ToNaturalUnits(FourDiscs(0)).units.origin, Vec2d(0, 0));
}

// A linear term measures positions from the origin, wherever that is.
TEST(Units, LossesOfLinearTermsMoveWithTheOrigin) {
  const Scene scene = Rescaled(ProblemScene("bounce_once"), {.name = "", .shift = {0, 4096}});
  ASSERT_TRUE(scene.objective.terminal[0].component);
  const Scene natural = ToNaturalUnits(scene);
  ASSERT_NE(natural.units.origin[1], 0);
  const double height = 0.25;  // above the ground
  const double in_natural =
      natural.objective.terminal[0].weight * ConvertPosition({0, 4096 + height}, {}, natural.units)[1];
  EXPECT_EQ(ConvertLoss(in_natural, natural.units, {}), scene.objective.terminal[0].weight * (4096 + height));
}

}  // namespace
}  // namespace saltus
