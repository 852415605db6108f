// Scene files whose `optimize` is a list, and what a design does to a scene.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <string>
#include <variant>
#include <vector>

#include "saltus/scene/scene_file.h"
#include "saltus/scene/scene_parameter.h"
#include "scene/units.h"

namespace saltus {
namespace {

using testing::HasSubstr;
using Kind = SceneParameter::Kind;

// Its line 14 is `optimize`.
std::string TextWith(const std::string& optimize) {
  return R"(name: designed
duration: 1
steps: 10
bodies:
  - {name: ball, radius: 0.1, mass: 2, position: [0, 1]}
  - {name: post.a, radius: 0.2, fixed: true, position: [3, 1]}
planes: [{name: ground, point: [1, 0], normal: [0, 2]}]
segments: [{name: gate, from: [5, 0], to: [5, 2]}]
contact: {restitution: 0.5, friction: 0.25}
control: {bodies: [ball], initial: [[1, 0]]}
objective:
  terminal: [{body: ball, quantity: position, target: [0, 0]}]
  effort: 0.1
optimize: )" +
         optimize + "\n";
}

Scene SceneWith(const std::string& optimize) {
  const auto parsed = ParseScene(TextWith(optimize), "test.yaml");
  if (const auto* error = std::get_if<SceneFileError>(&parsed)) {
    ADD_FAILURE() << error->ToString();
    return {};
  }
  return std::get<Scene>(parsed);
}

constexpr char kAll[] =
    "[control, restitution, gravity, {parameter: mass.ball, min: 1, max: 3}, radius.post.a, position.post.a, "
    "{parameter: position.post.a.y, max: 2}, offset.ground, angle.ground, {parameter: offset.gate, min: -0.5}]";

TEST(DesignScene, ReadsNamesAndBounds) {
  std::string text = kAll;
  text.erase(text.find("position.post.a, "), 17);
  const Scene scene = SceneWith(text);
  EXPECT_EQ(scene.optimize, Optimize::kControl);
  const std::vector<DesignParameter> expected = {{{Kind::kRestitution}},
                                                 {{Kind::kGravity, -1, 0}},
                                                 {{Kind::kGravity, -1, 1}},
                                                 {{Kind::kMass, 0}, 1, 3},
                                                 {{Kind::kRadius, 1}},
                                                 {{Kind::kPosition, 1, 1}, std::nullopt, 2},
                                                 {{Kind::kPlaneOffset, 0}},
                                                 {{Kind::kPlaneAngle, 0}},
                                                 {{Kind::kSegmentOffset, 0}, -0.5, std::nullopt}};
  EXPECT_EQ(scene.design, expected);
  EXPECT_EQ(DesignOf(scene), (std::vector<double>{0.5, 0, 0, 2, 0.2, 1, 0, 0, 0}));
  EXPECT_EQ(SceneWith("[mass.ball]").optimize, Optimize::kNone);
  EXPECT_TRUE(SceneWith("control").design.empty());
}

TEST(DesignScene, IsWrittenAsItIsRead) {
  std::string text = kAll;
  text.erase(text.find("position.post.a, "), 17);
  for (const std::string& optimize : {text, std::string("[friction]"), std::string("[velocity, mass.ball]")}) {
    const Scene scene = SceneWith(optimize);
    const auto again = ParseScene(WriteScene(scene), "again.yaml");
    ASSERT_TRUE(std::holds_alternative<Scene>(again)) << std::get<SceneFileError>(again).ToString();
    EXPECT_EQ(std::get<Scene>(again), scene);
  }
}

TEST(DesignScene, WhatIsWrongNamesLineKeyAndWhatWasExpected) {
  const struct {
    const char *optimize, *key, *found, *expected;
  } cases[] = {
      {"[]", "optimize", "a list of 0", "at least one of control, velocity, position and parameters"},
      {"[control, mas.ball]", "optimize[1]", "found mas.ball", "mass.BODY of a body that moves"},
      {"[mass.post.a]", "optimize[0]", "found mass.post.a", "mass.BODY of a body that moves"},
      {"[position.ball]", "optimize[0]", "found position.ball", "position.BODY of a fixed body"},
      {"[offset.ball]", "optimize[0]", "found offset.ball", "of a plane or a segment"},
      {"[force.ball]", "optimize[0]", "found force.ball", "a parameter"},
      {"[none]", "optimize[0]", "found none", "control, velocity, position"},
      {"[control, velocity]", "optimize[1]", "found velocity beside control", "one of"},
      {"[{parameter: mass.ball, low: 1}]", "optimize[0].low", "unknown key", "parameter"},
      {"[{min: 1}]", "optimize[0].parameter", "found no such key", "the name of a parameter"},
      {"[{parameter: mass.ball, min: 3}]", "optimize", "found mass.ball, which is 2", "from 3 to"},
      {"[{parameter: mass.ball, min: 2, max: 2}]", "optimize", "found mass.ball between 2 and 2", "min < max"},
      {"[{parameter: restitution, min: 2}]", "optimize", "found restitution with the bound 2", "from 0 to 1"},
      {"[{parameter: restitution, max: 1.4}]", "optimize", "found restitution with the bound 1.4", "from 0 to 1"},
      {"[{parameter: friction, min: -0.1}]", "optimize", "found friction with the bound -0.1", "from 0 to"},
      {"[mass.ball, mass.ball]", "optimize", "found mass.ball again", "once"},
      {"[position.post.a, position.post.a.y]", "optimize", "found position.post.a.y again", "once"},
      {"[offset.gate, angle.gate]", "optimize", "found angle.gate beside offset.gate", "one of them"},
      {"[{parameter: mass.ball, min: x}]", "optimize[0].min", "found x", "a finite number"},
  };
  for (const auto& c : cases) {
    SCOPED_TRACE(c.optimize);
    const auto parsed = ParseScene(TextWith(c.optimize), "test.yaml");
    ASSERT_TRUE(std::holds_alternative<SceneFileError>(parsed));
    const auto& error = std::get<SceneFileError>(parsed);
    EXPECT_EQ(error.line, 14);
    EXPECT_EQ(error.key, c.key);
    EXPECT_THAT(error.message, HasSubstr(c.found));
    EXPECT_THAT(error.message, HasSubstr(c.expected));
  }
}

TEST(DesignScene, SomethingToOptimizeNeedsATerm) {
  Scene scene = SceneWith("[mass.ball]");
  scene.objective.terminal.clear();
  ASSERT_TRUE(Validate(scene));
  EXPECT_EQ(Validate(scene)->key, "objective.terminal");
}

TEST(DesignScene, WallsAreTurnedAndMoved) {
  const Scene scene = SceneWith("[offset.ground, angle.ground, angle.gate]");
  const Scene moved = WithDesign(scene, std::vector<double>{0.5, std::acos(-1) / 2, std::acos(-1) / 2});
  const Vec2d normal = moved.planes[0].normal.normalized();
  EXPECT_NEAR(normal[0], -1, 1e-15);
  EXPECT_NEAR(normal[1], 0, 1e-15);
  EXPECT_NEAR(moved.planes[0].point[0], 0.5, 1e-15);  // about [1, 0], then along [-1, 0]
  EXPECT_NEAR(moved.planes[0].point[1], 0, 1e-15);
  EXPECT_NEAR(moved.segments[0].from[0], 6, 1e-15);  // about [5, 1]
  EXPECT_NEAR(moved.segments[0].from[1], 1, 1e-15);
  const Scene gate = SceneWith("[offset.gate]");
  EXPECT_NEAR(WithDesign(gate, std::vector<double>{0.5}).segments[0].to[0], 4.5, 1e-15);  // to the left of upwards
  EXPECT_EQ(WithDesign(scene, {}), scene);
}

// A wall that has been moved is moved again from its first place, and its value counts from there.
TEST(DesignScene, ValuesOfWallsCountFromTheirFirstPlace) {
  const Scene scene = SceneWith("[{parameter: offset.ground, min: -1, max: 2}, angle.ground, angle.gate]");
  const std::vector<double> first = {0.5, 0.75, -0.25}, second = {-0.25, 0.5, 1};
  const Scene once = WithDesign(scene, second), twice = WithDesign(WithDesign(scene, first), second);
  EXPECT_EQ(DesignOf(twice), second);
  EXPECT_FALSE(Validate(twice));
  EXPECT_NEAR((twice.planes[0].point - once.planes[0].point).norm(), 0, 1e-15);
  EXPECT_NEAR((twice.planes[0].normal - once.planes[0].normal).norm(), 0, 1e-15);
  EXPECT_NEAR((twice.segments[0].to - once.segments[0].to).norm(), 0, 1e-15);
  EXPECT_EQ(RangeOf(twice.design[0]).max, 2);
  // A file has the wall where it is.
  const auto read = ParseScene(WriteScene(once), "test.yaml");
  EXPECT_EQ(DesignOf(std::get<Scene>(read)), std::vector<double>(3));
  EXPECT_EQ(RangeOf(std::get<Scene>(read).design[0]).min, -0.75);
}

TEST(DesignScene, UnitsConvertValuesAndBounds) {
  std::string text = kAll;
  text.erase(text.find("position.post.a, "), 17);
  const Scene scene = SceneWith(text);
  Units units;
  units.length = 4;
  units.time = 2;
  units.mass = 8;
  units.origin = {64, -64};
  const Scene other = ToUnits(scene, units);
  EXPECT_EQ(other.design[3].min, 0.125);
  EXPECT_EQ(other.design[5].max, (2 + 64.0) / 4);
  EXPECT_EQ(other.design[8].min, -0.125);
  const std::vector<double> values = DesignOf(scene), converted = DesignOf(other);
  for (std::size_t i = 0; i < values.size(); ++i) {
    EXPECT_EQ(ConvertParameter(scene.design[i].parameter, values[i], {}, units), converted[i]) << i;
    EXPECT_EQ(ConvertParameter(scene.design[i].parameter, converted[i], units, {}), values[i]) << i;
  }
}

}  // namespace
}  // namespace saltus
