#include "saltus/scene/scene.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <functional>
#include <limits>
#include <string>
#include <vector>

#include "rescaled_scene.h"

namespace saltus {
namespace {

constexpr double kInfinity = std::numeric_limits<double>::infinity();
constexpr double kNan = std::numeric_limits<double>::quiet_NaN();

// A pushed disc, a disc, and a fixed one that reaches into the plane below them.
Scene GoodScene() {
  Scene scene;
  scene.name = "good_scene_1";
  scene.duration = 1;
  scene.steps = 100;
  scene.gravity = {0, -9.8};
  scene.bodies = {{.name = "striker", .radius = 0.2, .mass = 1, .position = {-2, 1}, .velocity = {1, 0}},
                  {.name = "Target-2.b", .radius = 0.2, .mass = 2, .position = {0, 1}},
                  {.name = "post", .radius = 0.5, .fixed = true, .position = {5, 0}}};
  scene.planes = {{"ground", {0, 0}, {0, 3}}};
  scene.control = {{0}, {{3, 3}}};
  scene.objective.terminal = {{.body = 1, .target = {1, 1}}};
  scene.objective.effort = 0.1;
  scene.optimize = Optimize::kControl;
  return scene;
}

TEST(Validate, AcceptsAGoodScene) {
  const auto error = Validate(GoodScene());
  EXPECT_FALSE(error) << error->key << ": " << error->message;
}

struct Breach {
  std::string key;
  std::function<void(Scene*)> apply;
};

const std::vector<Breach>& Breaches() {
  static const std::vector<Breach> breaches = {
      {"name", [](Scene* s) { s->name = ""; }},
      {"name", [](Scene* s) { s->name = "Upper"; }},
      {"name", [](Scene* s) { s->name = "../escape"; }},
      {"name", [](Scene* s) { s->name = std::string(101, 'a'); }},
      {"duration", [](Scene* s) { s->duration = 0; }},
      {"duration", [](Scene* s) { s->duration = -1; }},
      {"duration", [](Scene* s) { s->duration = kNan; }},
      {"duration", [](Scene* s) { s->duration = kInfinity; }},
      {"duration", [](Scene* s) { s->duration = 1e-25; }},
      {"duration", [](Scene* s) { s->duration = 1.1e24; }},
      {"steps", [](Scene* s) { s->steps = 0; }},
      {"steps", [](Scene* s) { s->steps = -5; }},
      {"steps", [](Scene* s) { s->steps = kMaxSteps + 1; }},
      {"gravity[0]", [](Scene* s) { s->gravity[0] = kNan; }},
      {"gravity[1]", [](Scene* s) { s->gravity[1] = -1.1e24; }},
      {"bodies", [](Scene* s) { s->bodies.clear(); }},
      {"bodies[1].name", [](Scene* s) { s->bodies[1].name = ""; }},
      {"bodies[1].name", [](Scene* s) { s->bodies[1].name = "two words"; }},
      {"bodies[1].name", [](Scene* s) { s->bodies[1].name = "striker"; }},
      {"bodies[0].radius", [](Scene* s) { s->bodies[0].radius = 0; }},
      {"bodies[2].radius", [](Scene* s) { s->bodies[2].radius = -0.5; }},
      {"bodies[1].mass", [](Scene* s) { s->bodies[1].mass = 0; }},
      {"bodies[1].mass", [](Scene* s) { s->bodies[1].mass = kNan; }},
      {"bodies[1].position[1]", [](Scene* s) { s->bodies[1].position[1] = kInfinity; }},
      {"bodies[0].velocity[0]", [](Scene* s) { s->bodies[0].velocity[0] = 1e200; }},
      {"bodies[2].velocity",
       [](Scene* s) {
         s->bodies[2].velocity = {0, 1e-300};
       }},
      {"planes[0].name", [](Scene* s) { s->planes[0].name = "post"; }},
      {"planes[0].point[0]", [](Scene* s) { s->planes[0].point[0] = kNan; }},
      {"planes[0].normal",
       [](Scene* s) {
         s->planes[0].normal = {0, 0};
       }},
      {"planes[0].normal",
       [](Scene* s) {
         s->planes[0].normal = {1e-200, 1e-25};
       }},
      {"planes[0].normal[1]", [](Scene* s) { s->planes[0].normal[1] = kInfinity; }},
      {"contact.restitution", [](Scene* s) { s->contact.restitution = 1.0001; }},
      {"contact.restitution", [](Scene* s) { s->contact.restitution = -0.0001; }},
      {"contact.friction", [](Scene* s) { s->contact.friction = -0.1; }},
      {"contact.stiffness", [](Scene* s) { s->contact.stiffness = -1; }},
      {"contact.damping", [](Scene* s) { s->contact.damping = kNan; }},
      {"control.bodies[0]", [](Scene* s) { s->control.bodies[0] = 3; }},
      {"control.bodies[0]", [](Scene* s) { s->control.bodies[0] = -1; }},
      {"control.bodies[0]", [](Scene* s) { s->control.bodies[0] = 2; }},
      {"control.bodies[1]",
       [](Scene* s) {
         s->control = {{0, 0}, {{1, 1}, {1, 1}}};
       }},
      {"control.initial",
       [](Scene* s) {
         s->control.initial.push_back({1, 1});
       }},
      {"control.initial", [](Scene* s) { s->control.initial.clear(); }},
      {"control.initial[0][1]", [](Scene* s) { s->control.initial[0][1] = kNan; }},
      {"optimize", [](Scene* s) { s->control = {}; }},
      {"objective.terminal[0].body", [](Scene* s) { s->objective.terminal[0].body = 3; }},
      {"objective.terminal[0].component", [](Scene* s) { s->objective.terminal[0].component = 2; }},
      {"objective.terminal[0].target[0]", [](Scene* s) { s->objective.terminal[0].target[0] = kNan; }},
      {"objective.terminal[0].weight", [](Scene* s) { s->objective.terminal[0].weight = -1; }},
      {"objective.terminal[0].weight", [](Scene* s) { s->objective.terminal[0].weight = kNan; }},
      {"objective.effort", [](Scene* s) { s->objective.effort = -0.1; }},
      {"objective.terminal", [](Scene* s) { s->objective.terminal.clear(); }},
      {"free", [](Scene* s) { s->optimize = Optimize::kVelocity; }},
      {"free", [](Scene* s) { s->optimize = Optimize::kPosition; }},
      {"free[1]",
       [](Scene* s) {
         s->free = {0, 2};
       }},
      {"free[1]",
       [](Scene* s) {
         s->free = {1, 1};
       }},
      {"free[0]", [](Scene* s) { s->free = {7}; }},
      {"bodies[1].position",
       [](Scene* s) {
         s->bodies[1].position = {-1.7, 1.2};
       }},
      {"bodies[1].position", [](Scene* s) { s->bodies[1].position = s->bodies[0].position; }},
      {"bodies[2].position",
       [](Scene* s) {
         s->bodies[2].position = {0, 0.4};
       }},
      {"bodies[0].position",
       [](Scene* s) {
         s->bodies[0].position = {-2, 0.19};
       }},
      {"bodies[0].position",
       [](Scene* s) {
         s->bodies[0].position = {-2, -7};
       }},
  };
  return breaches;
}

TEST(Validate, NamesTheKeyOfEveryBreach) {
  for (std::size_t i = 0; i < Breaches().size(); ++i) {
    SCOPED_TRACE("breach " + std::to_string(i) + " of " + Breaches()[i].key);
    Scene scene = GoodScene();
    Breaches()[i].apply(&scene);
    const auto error = Validate(scene);
    ASSERT_TRUE(error);
    EXPECT_EQ(error->key, Breaches()[i].key);
    EXPECT_THAT(error->message, testing::HasSubstr("expected"));
  }
}

TEST(Validate, AcceptsTheEdgesOfTheRanges) {
  Scene scene = GoodScene();
  scene.duration = kSmallestPositive;
  scene.steps = kMaxSteps;
  scene.contact = {.restitution = 0, .friction = 0, .stiffness = kLargestMagnitude, .damping = 0};
  scene.bodies[0].velocity = {-kLargestMagnitude, kLargestMagnitude};
  scene.bodies[0].mass = kSmallestPositive;
  scene.planes[0].normal = {0, kSmallestPositive};
  EXPECT_FALSE(Validate(scene));
}

// Discs of radius 0.2 in the direction (3, 4)/5, and one on the plane, moved into each other by `depth`.
Scene Touching(double depth) {
  Scene scene = GoodScene();
  const double apart = 0.4 - depth;
  scene.bodies[1].position = scene.bodies[0].position + apart * Vec2d(0.6, 0.8);
  return scene;
}

Scene OnTheGround(double depth) {
  Scene scene = GoodScene();
  scene.bodies[0].position[1] = 0.2 - depth;
  return scene;
}

TEST(Validate, AllowsOverlapUpToTheTolerance) {
  constexpr double kTolerance = 8e-12;  // m; the scene's length is 8 m
  EXPECT_FALSE(Validate(Touching(0)));
  EXPECT_FALSE(Validate(Touching(0.9 * kTolerance)));
  EXPECT_TRUE(Validate(Touching(1.1 * kTolerance)));
  EXPECT_FALSE(Validate(OnTheGround(0)));
  EXPECT_FALSE(Validate(OnTheGround(0.9 * kTolerance)));
  EXPECT_TRUE(Validate(OnTheGround(1.1 * kTolerance)));
}

TEST(Validate, AllowsWhatRoundingMakesOfTouchingDiscsFarFromTheOrigin) {
  Scene scene = Rescaled(Touching(0), {.name = "", .shift = {2e7, -3e7}});
  EXPECT_FALSE(Validate(scene));
  scene.bodies[1].position -= 1e-6 * Vec2d(0.6, 0.8);
  EXPECT_TRUE(Validate(scene));
}

TEST(Validate, MeasuresHeightAlongTheNormalisedNormal) {
  Scene scene = GoodScene();
  scene.planes = {{"slope", {-2, 0}, {-30, 40}}};  // the first body is 0.8 m above it, the second 0.4 m below
  scene.bodies.erase(scene.bodies.begin() + 1, scene.bodies.end());
  scene.objective.terminal[0].body = 0;
  scene.bodies[0].radius = 0.8;
  EXPECT_FALSE(Validate(scene));
  scene.bodies[0].radius = 0.8 + 1e-9;
  EXPECT_TRUE(Validate(scene));
}

TEST(Validate, LetsFixedBodiesOverlap) {
  Scene scene = GoodScene();
  scene.bodies.push_back({.name = "post2", .radius = 0.5, .fixed = true, .position = {5.1, -3}});
  scene.bodies.push_back({.name = "post3", .radius = 0.5, .fixed = true, .position = {5.1, -3}});
  EXPECT_FALSE(Validate(scene));
}

TEST(Validate, DoesNotReadTheMassOfAFixedBody) {
  Scene scene = GoodScene();
  scene.bodies[2].mass = 0;
  EXPECT_FALSE(Validate(scene));
}

TEST(Validate, LetsALinearTermBeMaximised) {
  Scene scene = GoodScene();
  scene.objective.terminal[0].component = 1;
  scene.objective.terminal[0].weight = -1;
  EXPECT_FALSE(Validate(scene));
}

TEST(Validate, NeedsNoObjectiveToOptimizeNothing) {
  Scene scene = GoodScene();
  scene.optimize = Optimize::kNone;
  scene.objective = {};
  scene.control = {};
  EXPECT_FALSE(Validate(scene));
}

TEST(Validate, SaysThatCornersLieOnOneLine) {
  const auto error_of = [](const std::vector<Vec2d>& points) {
    Scene scene = GoodScene();
    scene.polygons = {{"polygon", points, EdgePolygon::Solid::kInside}};
    const std::optional<SceneError> error = Validate(scene);
    return error ? error->ToString() : "";
  };
  const std::string on_a_line = "polygons[0].points: found corners that lie on one line";
  EXPECT_THAT(error_of({{30, 30}, {31, 31}, {32, 32}}), testing::HasSubstr(on_a_line));
  // Rounding makes a small area of these, of either sign.
  EXPECT_THAT(error_of({{30.1, 30.1}, {30.3, 30.3}, {30.7, 30.7}}), testing::HasSubstr(on_a_line));
  EXPECT_THAT(error_of({{30, 30.3}, {30.1, 30.6}, {30.7, 32.4}, {30.2, 30.9}}), testing::HasSubstr(on_a_line));
  EXPECT_THAT(error_of({{30, 30}, {30, 31}, {31, 30}}), testing::HasSubstr("clockwise"));
  EXPECT_EQ(error_of({{30, 30}, {31, 30}, {30.5, 30 + 1e-6}}), "");
}

TEST(Validate, RefusesADiscAlongAnArcOfItsRadius) {
  const auto error_of = [](double radius, double shift) {
    Scene scene = GoodScene();
    scene.arcs = {{"arc", {20, 20}, radius, 0, 3}};
    scene.bodies[1].position = {20, 20 + shift};
    const std::optional<SceneError> error = Validate(scene);
    return error ? error->ToString() : "";
  };
  EXPECT_THAT(error_of(0.2, 0), testing::HasSubstr("bodies[1].position: found the centre of the arc arc"));
  EXPECT_EQ(error_of(0.25, 0), "");    // in the middle of a larger one
  EXPECT_EQ(error_of(0.2, -0.1), "");  // below the half circle, away from it
}

TEST(Validate, RefusesPairsThatCannotTouchAnyway) {
  Scene scene = GoodScene();
  scene.bodies.push_back({.name = "post2", .radius = 0.5, .fixed = true, .position = {9, 9}});
  scene.no_contact = {{0, 2, false}};
  EXPECT_FALSE(Validate(scene));
  scene.no_contact = {{2, 3, false}};
  ASSERT_TRUE(Validate(scene));
  EXPECT_EQ(Validate(scene)->key, "no_contact[0]");
  scene.no_contact = {{2, 0, true}};
  ASSERT_TRUE(Validate(scene));
  EXPECT_EQ(Validate(scene)->key, "no_contact[0]");
}

TEST(Validate, SaysWhatIsWrongWithEdges) {
  using Solid = EdgePolygon::Solid;
  const auto key_of = [](const auto& change) {
    Scene scene = GoodScene();
    scene.segments = {{"segment", {20, 20}, {21, 20}}};
    scene.polygons = {{"polygon", {{30, 30}, {31, 30}, {30, 31}}, Solid::kInside}};
    scene.arcs = {{"arc", {40, 40}, 1, 0, 1}};
    EXPECT_FALSE(Validate(scene));
    change(&scene);
    const std::optional<SceneError> error = Validate(scene);
    return error ? error->key : "none";
  };
  EXPECT_EQ(key_of([](Scene* s) { s->segments[0].name = s->bodies[0].name; }), "segments[0].name");
  EXPECT_EQ(key_of([](Scene* s) { s->segments[0].to = s->segments[0].from; }), "segments[0].to");
  EXPECT_EQ(key_of([](Scene* s) { s->segments[0].from[0] = kNan; }), "segments[0].from[0]");
  EXPECT_EQ(key_of([](Scene* s) { s->polygons[0].points.pop_back(); }), "polygons[0].points");
  EXPECT_EQ(key_of([](Scene* s) { std::swap(s->polygons[0].points[0], s->polygons[0].points[1]); }),
            "polygons[0].points");
  EXPECT_EQ(key_of([](Scene* s) { s->polygons[0].points = {{0, 0}, {9, 0}, {9, 9}, {5, -1}}; }), "polygons[0].points");
  EXPECT_EQ(key_of([](Scene* s) { s->polygons[0].points[1] = s->polygons[0].points[0]; }), "polygons[0].points");
  EXPECT_EQ(key_of([](Scene* s) { s->arcs[0].radius = 0; }), "arcs[0].radius");
  EXPECT_EQ(key_of([](Scene* s) { s->arcs[0].to = 0; }), "arcs[0].to");
  EXPECT_EQ(key_of([](Scene* s) { s->arcs[0].to = 7; }), "arcs[0].to");
  EXPECT_EQ(key_of([](Scene* s) { s->table = TableFriction{.friction = -1}; }), "table.friction");
  const auto place = [](Scene* s) { return s->bodies[0].position; };
  EXPECT_EQ(key_of([&](Scene* s) {
              s->segments[0] = {"segment", place(s), place(s) + Vec2d(1, 0)};
            }),
            "bodies[0].position");
  EXPECT_EQ(key_of([&](Scene* s) { s->arcs[0].center = place(s) - Vec2d(1, 0) * 1.01; }), "bodies[0].position");
  const auto around = [&](Scene* s) {
    const Vec2d p = place(s);
    return std::vector<Vec2d>{p + Vec2d(-8, -8), p + Vec2d(8, -8), p + Vec2d(0, 9)};
  };
  EXPECT_EQ(key_of([&](Scene* s) { s->polygons[0].points = around(s); }), "bodies[0].position");
}

TEST(Objective, IsASumOfSquaresUnlessATermIsLinear) {
  Objective objective;
  EXPECT_TRUE(objective.IsSumOfSquares());
  objective.terminal = {{.body = 0}, {.body = 1, .quantity = TerminalTerm::Quantity::kVelocity}};
  EXPECT_TRUE(objective.IsSumOfSquares());
  objective.terminal[1].component = 0;
  EXPECT_FALSE(objective.IsSumOfSquares());
}

TEST(Optimize, HasTheNamesOfSceneFiles) {
  EXPECT_STREQ(OptimizeToString(Optimize::kControl), "control");
  EXPECT_STREQ(OptimizeToString(Optimize::kVelocity), "velocity");
  EXPECT_STREQ(OptimizeToString(Optimize::kPosition), "position");
  EXPECT_STREQ(OptimizeToString(Optimize::kNone), "none");
}

}  // namespace
}  // namespace saltus
