// Materials in scene files: what is read and written, the rules, and parameters by the names of pairs.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <string>
#include <variant>

#include "saltus/scene/materials.h"
#include "saltus/scene/scene_file.h"
#include "saltus/scene/scene_parameter.h"
#include "saltus/scene/walls.h"

namespace saltus {
namespace {

using testing::ElementsAre;
using testing::HasSubstr;
using Kind = SceneParameter::Kind;

constexpr char kBalls[] = R"(name: balls
duration: 1
steps: 100
bodies:
  - {name: ball, radius: 0.1, mass: 1, position: [0, 1], material: rubber}
  - {name: plain, radius: 0.1, mass: 1, position: [1, 1]}
planes: [{name: ground, point: [0, 0], normal: [0, 1], material: steel}]
segments: [{name: bar, from: [3, 1], to: [4, 1], material: rubber}]
polygons: [{name: box, points: [[6, 1], [7, 1], [7, 2]], solid: inside, material: wood}]
arcs: [{name: arch, center: [10, 5], radius: 1, from: 0, to: 1, material: steel}]
contact: {restitution: 0.8, friction: 0.1}
materials:
  rubber: {restitution: 0.9, friction: 0.4}
  steel: {restitution: 0.6}
  wood: {friction: 0.3}
pairs:
  - {between: [steel, rubber], restitution: 0.7}
  - {between: [default, steel], restitution: 0.5, friction: 0.2}
combine: min
objective: {terminal: [{body: ball, quantity: position, target: [0, 0]}]}
optimize: [velocity, {parameter: restitution.rubber-steel, min: 0.2}]
)";

Scene Read(const std::string& text) {
  const auto result = ParseScene(text, "balls.yaml");
  const auto* error = std::get_if<SceneFileError>(&result);
  EXPECT_EQ(error, nullptr) << (error == nullptr ? "" : error->ToString());
  return error == nullptr ? std::get<Scene>(result) : Scene();
}

std::string ErrorOf(std::string text, const std::string& before, const std::string& after) {
  const std::size_t at = text.find(before);
  EXPECT_NE(at, std::string::npos) << before;
  text.replace(at, before.size(), after);
  const auto result = ParseScene(text, "balls.yaml");
  const auto* error = std::get_if<SceneFileError>(&result);
  return error == nullptr ? "" : error->ToString();
}

TEST(MaterialsInSceneFiles, AreRead) {
  const Scene scene = Read(kBalls);
  EXPECT_THAT(scene.materials,
              ElementsAre(Material{"rubber", {0.9, 0.4}}, Material{"steel", {0.6, 0.1}}, Material{"wood", {0.8, 0.3}}));
  EXPECT_THAT(scene.pairs, ElementsAre(MaterialPair{1, 0, 0.7, std::nullopt}, MaterialPair{-1, 1, 0.5, 0.2}));
  EXPECT_EQ(scene.combine, Combine::kMin);
  EXPECT_EQ(scene.bodies[0].material, 0);
  EXPECT_EQ(scene.bodies[1].material, -1);
  EXPECT_EQ(ContactBetween(scene, 0, 1), (PairContact{0.7, 0.1}));
  EXPECT_EQ(ContactBetween(scene, 2, 0), (PairContact{0.8, 0.3}));
  for (const WallPart& part : WallPartsOf(scene)) {
    const int expected = part.name == "ground" || part.name.starts_with("arch") ? 1
                         : part.name.starts_with("bar")                         ? 0
                                                                                : 2;
    EXPECT_EQ(part.wall.material, expected + 1) << part.name;
  }
}

TEST(MaterialsInSceneFiles, AreWritten) {
  const Scene scene = Read(kBalls);
  EXPECT_EQ(Read(WriteScene(scene)), scene);
  Scene without = scene;  // the file of a scene without materials has no such keys
  without.materials.clear();
  without.pairs.clear();
  without.design.clear();
  for (Body& body : without.bodies) body.material = -1;
  without.planes[0].material = without.segments[0].material = without.polygons[0].material = -1;
  without.arcs[0].material = -1;
  for (const char* word : {"material", "pairs", "combine"}) {
    EXPECT_EQ(WriteScene(without).find(word), std::string::npos) << word;
  }
}

TEST(MaterialsInSceneFiles, SayWhatIsWrong) {
  const auto error = [](const std::string& before, const std::string& after) { return ErrorOf(kBalls, before, after); };
  EXPECT_THAT(error("material: rubber}", "material: ruber}"),
              HasSubstr("balls.yaml:5: bodies[0].material: found ruber, expected one of the scene's materials, "
                        "rubber, steel, wood; did you mean rubber?"));
  EXPECT_THAT(error("friction: 0.4", "friction: -0.4"),
              HasSubstr("balls.yaml:13: materials.rubber.friction: found -0.4, expected a number >= 0"));
  EXPECT_THAT(error("{restitution: 0.6}", "{restitution: 1.6}"), HasSubstr("materials.steel.restitution: found 1.6"));
  EXPECT_THAT(error("{restitution: 0.6}", "{restitutoin: 0.6}"), HasSubstr("materials.steel.restitutoin: found an"));
  EXPECT_THAT(error("wood: {", "steel: {"), HasSubstr("balls.yaml:15: materials.steel: found the key again"));
  EXPECT_THAT(
      error("  wood: {", "  hard-wood: {}\n  wood: {"),
      HasSubstr("materials: found \"hard-wood\", expected a name of 1 to 100 characters out of a-z, A-Z, 0-9 and _."));
  EXPECT_THAT(error("  wood: {", "  default: {}\n  wood: {"), HasSubstr("materials: found the name default"));
  EXPECT_THAT(error("[default, steel]", "[rubber, steel]"),
              HasSubstr("balls.yaml:18: pairs[1].between: found the pair of pairs[0] again, expected each pair once"));
  EXPECT_THAT(error("[default, steel]", "[steel]"), HasSubstr("pairs[1].between: found a list"));
  EXPECT_THAT(error("restitution: 0.5, friction: 0.2}", "restitution: 0.5, friction: -1}"),
              HasSubstr("balls.yaml:18: pairs[1].friction: found -1"));
  EXPECT_THAT(error(", restitution: 0.7}", "}"), HasSubstr("pairs[0]: expected restitution, friction or both"));
  EXPECT_THAT(error("combine: min", "combine: least"),
              HasSubstr("combine: found least, expected one of mean, product, min, max"));
  EXPECT_THAT(error("restitution.rubber-steel, min", "restitution, min"),
              HasSubstr("found restitution, expected control, velocity, position, or a parameter: "
                        "restitution.default-rubber, restitution.rubber-rubber, restitution.default-steel"));
  EXPECT_THAT(error("material: wood", "material: default"), "");
}

TEST(MaterialsInSceneFiles, ParametersAreOfPairs) {
  Scene scene = Read(kBalls);
  EXPECT_TRUE(ParametersNamed("restitution", scene).empty());
  EXPECT_TRUE(ParametersNamed("restitution.rubber", scene).empty());
  EXPECT_TRUE(ParametersNamed("restitution.rubber-stone", scene).empty());
  for (const char* name : {"restitution.steel-rubber", "restitution.rubber-steel"}) {
    const std::vector<SceneParameter> found = ParametersNamed(name, scene);
    ASSERT_EQ(found.size(), 1u);
    EXPECT_EQ(NameOf(found[0], scene), "restitution.rubber-steel");
    EXPECT_EQ(found[0], scene.design[0].parameter);
  }
  const SceneParameter wood = ParametersNamed("friction.wood-rubber", scene)[0];
  EXPECT_EQ(ValueOf(wood, scene), 0.3);
  SetValue(wood, 0.25, &scene);
  EXPECT_EQ(ContactBetween(scene, 0, 2), (PairContact{0.8, 0.25}));  // its restitution is still combined
  EXPECT_EQ(ContactBetween(scene, 2, 2), (PairContact{0.8, 0.3}));
  SetValue(ParametersNamed("restitution.default-default", scene)[0], 0.1, &scene);
  EXPECT_EQ(ContactBetween(scene, -1, -1), (PairContact{0.1, 0.1}));
  EXPECT_EQ(Read(WriteScene(scene)), scene);
}

}  // namespace
}  // namespace saltus
