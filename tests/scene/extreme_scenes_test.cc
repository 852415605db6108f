// Scenes with extreme numbers in any key: what is accepted can be converted to its natural units, in which solvers and
// simulators work; what is not is refused with its key.
#include <gmock/gmock.h>

#include <algorithm>
#include <limits>
#include <random>
#include <string>
#include <string_view>
#include <vector>

#include "saltus/scene/scene_file.h"
#include "saltus/simulate/registry.h"
#include "scene/units.h"

namespace saltus {
namespace {

using testing::HasSubstr;

// Every key that has a number.
constexpr char kScene[] = R"(name: full
duration: <1>
steps: 4
gravity: [<0.5>, <-9.8>]
bodies:
  - {name: a, radius: <0.1>, mass: <1.5>, inertia: solid, position: [<-0.5>, <1>], velocity: [<5>, <-5>], angle: <0.5>, angular_velocity: <20>}
  - {name: b, radius: <0.2>, mass: <2.5>, inertia: <0.01>, position: [<0.5>, <1>], velocity: [<0.1>, <0.2>]}
  - {name: post, radius: <0.1>, fixed: true, position: [<0.5>, <2>]}
planes:
  - {name: ground, point: [<0>, <0>], normal: [<0>, <1>]}
segments:
  - {name: s, from: [<3>, <1>], to: [<3>, <2>]}
polygons:
  - {name: p, points: [[<5>, <1>], [<6>, <1>], [<5.5>, <2>]], solid: inside}
arcs:
  - {name: r, center: [<-4>, <2>], radius: <0.5>, from: <0>, to: <1>}
pockets:
  - {name: h, position: [<-2>, <3>], radius: <0.25>}
table: {friction: <0.1>, gravity: <9.81>}
contact: {restitution: <0.9>, friction: <0.1>, stiffness: <1.0e4>, damping: <10.0>}
control:
  bodies: [a, b]
  torque: [a]
  initial: [[<1>, <2>, <0.5>], [<1>, <1>]]
  max: [<30>, <40>]
  max_norm: <50>
  max_torque: <2>
objective:
  terminal:
    - {body: a, quantity: position, target: [<-2>, <1.5>], weight: <1.0>}
    - {body: a, quantity: velocity, component: x, weight: <-1>}
    - {body: a, quantity: angular_velocity, target: <0.1>, weight: <1.0e-3>}
    - {body: a, quantity: angle, target: <0.1>, weight: <1.0e-3>}
  running:
    - {body: a, quantity: position, target: [[<0>, <1>, <2>], [<0.5>, <2>, <3>]], weight: <2>}
  via:
    - {body: b, quantity: velocity, time: <0.5>, target: [<1>, <2>], weight: <3>}
  effort: <0.01>
  duration: {free: true, min: <0.75>, max: <2>, weight: <0.5>}
optimize: control
)";

// The text without marks, its numbers in the order of the marks replaced by those that are not empty.
std::string With(const std::vector<std::string>& numbers) {
  std::string text;
  std::size_t next = 0;
  for (const char* at = kScene; *at != '\0'; ++at) {
    if (*at != '<') {
      text += *at;
      continue;
    }
    const std::string number(at + 1, std::string_view(at).find('>') - 1);
    at += number.size() + 1;
    text += numbers[next].empty() ? number : numbers[next];
    ++next;
  }
  return text;
}

std::size_t NumNumbers() {
  const std::string_view scene = kScene;
  return static_cast<std::size_t>(std::count(scene.begin(), scene.end(), '<'));
}

// True if the scene is accepted; then nothing is wrong with it in the units in which it is simulated and solved.
bool IsAcceptedAndConverts(const std::string& text) {
  const std::variant<Scene, SceneFileError> read = ParseScene(text, "extreme");
  if (const auto* error = std::get_if<SceneFileError>(&read)) {
    EXPECT_NE(error->key, "") << error->ToString();
    EXPECT_THAT(error->message, HasSubstr("expected"));
    return false;
  }
  const Scene& scene = std::get<Scene>(read);
  for (const Scene& converted : {ToNaturalUnits(scene), NearOrigin(scene)}) {
    const std::optional<SceneError> error = ValidateStructure(converted);
    EXPECT_FALSE(error) << error->ToString() << "\n" << text;
  }
  return true;
}

const std::vector<std::string>& Extremes() {
  static const std::vector<std::string> extremes = [] {
    std::vector<std::string> numbers = {"0", "-0.0", "1e308", "-1e308", "5e-324", "1e-300"};
    for (int exponent = -24; exponent <= 24; ++exponent) {
      for (const char* sign : {"", "-"}) numbers.push_back(sign + ("1e" + std::to_string(exponent)));
    }
    return numbers;
  }();
  return extremes;
}

TEST(ExtremeScenes, EachNumberOfEachSize) {
  std::vector<std::string> numbers(NumNumbers());
  ASSERT_TRUE(IsAcceptedAndConverts(With(numbers)));
  int accepted = 0;
  for (std::string& number : numbers) {
    for (const std::string& extreme : Extremes()) {
      number = extreme;
      accepted += IsAcceptedAndConverts(With(numbers));
    }
    number.clear();
  }
  EXPECT_GT(accepted, 1000);  // it is not all refused
}

TEST(ExtremeScenes, SeveralNumbersAtOnce) {
  std::mt19937 random(29);
  const auto choose = [&](std::size_t count) {
    return std::uniform_int_distribution<std::size_t>(0, count - 1)(random);
  };
  int accepted = 0;
  for (int i = 0; i < 5000; ++i) {
    std::vector<std::string> numbers(NumNumbers());
    const std::size_t changes = 2 + choose(4);
    for (std::size_t k = 0; k < changes; ++k) numbers[choose(numbers.size())] = Extremes()[choose(Extremes().size())];
    accepted += IsAcceptedAndConverts(With(numbers));
  }
  EXPECT_GT(accepted, 100);
}

// From the origin near the discs the wall and the target are farther than any number that may be given.
TEST(ExtremeScenes, WhatIsFarOnTheOtherSideStaysValidNearTheOrigin) {
  Scene scene;
  scene.name = "apart";
  scene.bodies = {{.name = "a", .radius = 1e17, .position = {-1e24, 0}}};
  scene.planes = {{"wall", {1e24, 0}, {-1, 0}}};
  scene.objective.terminal = {{.body = 0, .target = {-1e24, 1}}};
  scene.objective.via = {{.body = 0, .time = 0.5, .target = {1e24, 0}}};
  ASSERT_FALSE(Validate(scene)) << Validate(scene)->ToString();
  EXPECT_EQ(ReasonNotApplicable("direct", scene), "");
  for (const Scene& converted : {ToNaturalUnits(scene), NearOrigin(scene)}) {
    EXPECT_FALSE(ValidateStructure(converted)) << ValidateStructure(converted)->ToString();
    EXPECT_EQ(ReasonNotApplicable("direct", converted), "");
  }
}

// A scene made without the reader is refused by everything that takes it, not by a failed check.
TEST(ExtremeScenes, ModelsSayWhatIsWrongInNaturalUnits) {
  Scene scene;
  scene.name = "far";
  scene.bodies = {{.name = "a", .radius = 0.1, .mass = 1e24, .inertia = {Inertia::Kind::kGiven, 1e-24}}};
  scene.planes = {{"ground", {0, -1e24}, {0, 1}}};
  EXPECT_EQ(ReasonNotApplicable("event", scene).find("the scene is wrong: bodies[0].inertia: found"), 0u)
      << ReasonNotApplicable("event", scene);
  EXPECT_THAT(ReasonNotApplicable("direct", scene), HasSubstr("expected a positive number, 1e-72 to 1e72"));
}

TEST(ExtremeScenes, DiscsThatThresholdsAndRoundingWouldLoseAreRefused) {
  const auto error_of = [](double radius, double height, double shift) {
    Scene scene;
    scene.name = "small";
    scene.bodies = {{.name = "a", .radius = radius, .position = {shift, height}}};
    scene.planes = {{"ground", {0, 0}, {0, 1}}};
    const std::optional<SceneError> error = Validate(scene);
    return error ? error->ToString() : "";
  };
  EXPECT_EQ(error_of(1e-8, 1, 0), "");
  EXPECT_THAT(error_of(1e-10, 1, 0),
              HasSubstr("bodies[0].radius: found 1e-10 m, expected at least 1e-09 of the extent"));
  const double far = 0.1 * 1e-8 / std::numeric_limits<double>::epsilon();
  EXPECT_EQ(error_of(1e-8, 1, 0.9 * far), "");
  EXPECT_THAT(error_of(1e-8, 1, 1.1 * far), HasSubstr("bodies[0].position: found a point"));
}

}  // namespace
}  // namespace saltus
