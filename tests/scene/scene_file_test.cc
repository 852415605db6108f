#include "saltus/scene/scene_file.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <filesystem>
#include <fstream>
#include <limits>
#include <random>
#include <string>
#include <variant>

#include "folders.h"

namespace saltus {
namespace {

using testing::HasSubstr;

std::string ProblemPath(const std::string& name) { return SourceFolder() + "/problems/" + name + ".yaml"; }

Scene SceneOf(const std::variant<Scene, SceneFileError>& result) {
  if (const auto* error = std::get_if<SceneFileError>(&result)) {
    ADD_FAILURE() << error->ToString();
    return {};
  }
  return std::get<Scene>(result);
}

// The error of parsing `text`, or an error with the message "accepted".
SceneFileError ErrorOf(const std::string& text) {
  const auto result = ParseScene(text, "test.yaml");
  if (const auto* error = std::get_if<SceneFileError>(&result)) return *error;
  return {"", 0, "", "accepted"};
}

// Every key that a scene file may have, each default overridden.
constexpr char kEverything[] = R"(name: everything
duration: 2.5
steps: 250
gravity: [0.5, -9.8]
bodies:
  - name: striker
    radius: 0.2
    mass: 1.5
    fixed: false
    position: [-2, 2]
    velocity: [1, +2e0]
  - {name: target, radius: 0.1, mass: 1.0, position: [-1, 1]}
  - {name: post, radius: 0.25, fixed: true, position: [3, 0]}
planes:
  - {name: ground, point: [0, -1], normal: [0, 2]}
contact:
  restitution: 0.5
  friction: 0.25
  stiffness: 1.0e5
  damping: 3
control:
  bodies: [target, striker]
  initial: [[3, 4], [5, 6]]
objective:
  terminal:
    - {body: target, quantity: position, target: [0, 1], weight: 2.0}
    - {body: striker, quantity: velocity, component: y, weight: -3.0}
    - {body: target, quantity: position, component: x}
  effort: 0.1
optimize: position
free: [target]
)";

TEST(ParseScene, ReadsEveryKey) {
  Scene expected;
  expected.name = "everything";
  expected.duration = 2.5;
  expected.steps = 250;
  expected.gravity = {0.5, -9.8};
  expected.bodies = {{.name = "striker", .radius = 0.2, .mass = 1.5, .position = {-2, 2}, .velocity = {1, 2}},
                     {.name = "target", .radius = 0.1, .mass = 1, .position = {-1, 1}},
                     {.name = "post", .radius = 0.25, .mass = 1, .fixed = true, .position = {3, 0}}};
  expected.planes = {{"ground", {0, -1}, {0, 2}}};
  expected.contact = {.restitution = 0.5, .friction = 0.25, .stiffness = 1e5, .damping = 3};
  expected.control = {{1, 0}, {{3, 4}, {5, 6}}};
  expected.objective.terminal = {
      {.body = 1, .target = {0, 1}, .weight = 2},
      {.body = 0, .quantity = TerminalTerm::Quantity::kVelocity, .component = 1, .weight = -3},
      {.body = 1, .component = 0, .weight = 1}};
  expected.objective.effort = 0.1;
  expected.optimize = Optimize::kPosition;
  expected.free = {1};
  EXPECT_EQ(SceneOf(ParseScene(kEverything, "test.yaml")), expected);
}

// Every key of bounds, constraints and costs on the way.
constexpr char kConstrained[] = R"(name: constrained
duration: 1
steps: 100
bodies:
  - {name: a, radius: 0.2, mass: 1, position: [-2, 2]}
  - {name: b, radius: 0.1, mass: 1, position: [-1, 1]}
  - {name: c, radius: 0.1, mass: 1, position: [1, 1]}
planes: [{name: ground, point: [0, -1], normal: [0, 1]}]
control: {bodies: [a, b], initial: [[3, 4], [5, 6]], max: 3.5, max_norm: [4, 5]}
objective:
  terminal: [{body: b, quantity: position, target: [0, 0], hard: true}]
  running: [{body: a, quantity: velocity, target: [[0, 1, 2], [0.5, 3, 4]], weight: 2}]
  via:
    - {body: a, time: 0.5, quantity: position, target: [-1, 1], weight: 10}
    - {body: b, time: 0.25, quantity: velocity, target: [1, 0], hard: true}
  effort: 0.1
  duration: {free: true, min: 0.5, max: 2, weight: 0.25}
no_contact: [[c, a], [b, ground]]
optimize: control
)";

TEST(ParseScene, ReadsBoundsConstraintsAndCostsOnTheWay) {
  const Scene scene = SceneOf(ParseScene(kConstrained, "test.yaml"));
  EXPECT_EQ(scene.control.max, std::vector<double>({3.5, 3.5}));
  EXPECT_EQ(scene.control.max_norm, std::vector<double>({4, 5}));
  EXPECT_TRUE(scene.objective.terminal.at(0).hard);
  ASSERT_EQ(scene.objective.running.size(), 1u);
  const RunningTerm running{0, TerminalTerm::Quantity::kVelocity, {0, 0.5}, {{1, 2}, {3, 4}}, 2};
  EXPECT_EQ(scene.objective.running[0], running);
  const std::vector<ViaTerm> via = {
      {.body = 0, .time = 0.5, .target = {-1, 1}, .weight = 10},
      {.body = 1, .time = 0.25, .quantity = TerminalTerm::Quantity::kVelocity, .target = {1, 0}, .hard = true}};
  EXPECT_EQ(scene.objective.via, via);
  EXPECT_EQ(scene.objective.duration, (FreeDuration{0.5, 2, 0.25}));
  EXPECT_EQ(scene.no_contact, (std::vector<NoContact>{{0, 2, false}, {1, 0, true}}));
  EXPECT_EQ(SceneOf(ParseScene(WriteScene(scene), "written")), scene);
}

constexpr char kRegions[] = R"(name: regions
duration: 1
steps: 100
bodies:
  - {name: a, radius: 0.2, mass: 1, inertia: solid, position: [-2, 2]}
  - {name: b, radius: 0.1, mass: 1, position: [-1, 1]}
  - {name: post, radius: 0.1, fixed: true, position: [1, 1]}
control: {bodies: [a], initial: [[3, 4]]}
objective:
  terminal:
    - {body: b, quantity: position, min: [2, -0.5], max: [null, 0.5]}
    - {body: a, quantity: velocity, component: y, target: -1, hard: true}
    - {body: a, quantity: position, component: x, max: 3}
    - {body: a, quantity: angle, min: 0.25, max: 0.5}
  limits:
    - {body: a, speed: {max: 0.5}, at: end}
    - {body: b, speed: {max: 2}}
optimize: control
)";

TEST(ParseScene, ReadsGoalRegionsAndLimits) {
  const Scene scene = SceneOf(ParseScene(kRegions, "test.yaml"));
  const double none = std::numeric_limits<double>::infinity();
  using Region = TerminalTerm::Region;
  const std::vector<Region> regions = {{Vec2d(2, -0.5), Vec2d(none, 0.5)},
                                       {Vec2d(-none, -1), Vec2d(none, -1)},
                                       {Vec2d(-none, -none), Vec2d(3, none)},
                                       {Vec2d(0.25, -none), Vec2d(0.5, none)}};
  ASSERT_EQ(scene.objective.terminal.size(), regions.size());
  for (size_t i = 0; i < regions.size(); ++i) {
    EXPECT_TRUE(scene.objective.terminal[i].hard) << i;
    EXPECT_EQ(scene.objective.terminal[i].region, regions[i]) << i;
  }
  const std::vector<SpeedLimit> limits = {{0, 0.5, SpeedLimit::Timing::kEnd}, {1, 2, SpeedLimit::Timing::kAlways}};
  EXPECT_EQ(scene.objective.limits, limits);
  EXPECT_TRUE(scene.objective.HasConstraints());
  EXPECT_EQ(SceneOf(ParseScene(WriteScene(scene), "written")), scene);
}

TEST(ParseScene, FillsInDefaults) {
  const Scene scene = SceneOf(ParseScene(R"(name: a
duration: 1
steps: 1
bodies: [{name: a, radius: 1, fixed: true, position: [0, 0]}, {name: b, radius: 1, mass: 2, position: [2, 0]}]
objective: {terminal: [{body: b, quantity: velocity, target: [0, 0]}]}
optimize: velocity
)",
                                         "test.yaml"));
  EXPECT_EQ(scene.gravity, Vec2d(0, 0));
  EXPECT_EQ(scene.bodies[1].velocity, Vec2d(0, 0));
  EXPECT_FALSE(scene.bodies[1].fixed);
  EXPECT_TRUE(scene.planes.empty());
  EXPECT_EQ(scene.contact, ContactParameters());
  EXPECT_EQ(scene.control, Control());
  EXPECT_EQ(scene.objective.effort, 0);
  EXPECT_EQ(scene.objective.terminal[0].weight, 1);
  EXPECT_EQ(scene.free, std::vector<int>{1});
}

// Scenes as stated in the papers: task 3, and the second problem of the follow-up.
TEST(ParseScene, ReadsEdgesAndATable) {
  const std::string head =
      "name: edges\nduration: 1\nsteps: 10\nobjective: {terminal: []}\noptimize: none\n"
      "bodies: [{name: ball, radius: 0.1, mass: 1, position: [0, 5]}]\n";
  const std::string edges = R"(segments:
  - {name: gate, from: [0, 0], to: [1, 0.5]}
polygons:
  - {name: box, points: [[-3, 0], [-2, 0], [-2, 1]], solid: inside}
  - {name: room, points: [[-9, -9], [9, -9], [9, 9], [-9, 9]], solid: outside}
arcs:
  - {name: corner, center: [3, 0], radius: 1, from: 0, to: 1.5}
pockets:
  - {name: hole, position: [8, 8], radius: 0.2}
table: {friction: 0.1}
)";
  const Scene scene = SceneOf(ParseScene(head + edges, "edges.yaml"));
  ASSERT_EQ(scene.segments.size(), 1u);
  EXPECT_EQ(scene.segments[0], (EdgeSegment{"gate", {0, 0}, {1, 0.5}}));
  ASSERT_EQ(scene.polygons.size(), 2u);
  EXPECT_EQ(scene.polygons[0], (EdgePolygon{"box", {{-3, 0}, {-2, 0}, {-2, 1}}, EdgePolygon::Solid::kInside}));
  EXPECT_EQ(scene.polygons[1].solid, EdgePolygon::Solid::kOutside);
  ASSERT_EQ(scene.arcs.size(), 1u);
  EXPECT_EQ(scene.arcs[0], (EdgeArc{"corner", {3, 0}, 1, 0, 1.5}));
  ASSERT_EQ(scene.pockets.size(), 1u);
  EXPECT_EQ(scene.pockets[0], (Pocket{"hole", {8, 8}, 0.2}));
  ASSERT_TRUE(scene.table);
  EXPECT_EQ(*scene.table, (TableFriction{0.1, 9.81}));
  EXPECT_EQ(SceneOf(ParseScene(WriteScene(scene), "written.yaml")), scene);

  const auto key_of = [&](const std::string& text) { return ErrorOf(head + text).key; };
  EXPECT_EQ(key_of("segments: [{name: s, from: [0, 0]}]"), "segments[0].to");
  EXPECT_EQ(key_of("segments: [{name: s, from: [0, 0], to: [1, 0], side: both}]"), "segments[0].side");
  EXPECT_EQ(key_of("polygons: [{name: p, points: [[0, 0], [1, 0], [0, 1]], solid: both}]"), "polygons[0].solid");
  EXPECT_EQ(key_of("polygons: [{name: p, points: [[0, 0], [1, 0]], solid: inside}]"), "polygons[0].points");
  EXPECT_EQ(key_of("polygons: [{name: p, points: 5, solid: inside}]"), "polygons[0].points");
  EXPECT_EQ(key_of("arcs: [{name: a, center: [0, 0], radius: 1, from: 1, to: 0}]"), "arcs[0].to");
  EXPECT_EQ(key_of("pockets: [{name: hole, position: [8, 8]}]"), "pockets[0].radius");
  EXPECT_EQ(key_of("pockets: [{name: hole, position: [8, 8], radius: 0}]"), "pockets[0].radius");
  EXPECT_EQ(key_of("pockets: [{name: hole, position: [0, 5], radius: 1}]"), "bodies[0].position");
  EXPECT_EQ(key_of("table: 0.1"), "table");
  EXPECT_EQ(key_of("table: {gravity: 9.81}"), "table.friction");
}

TEST(ParseScene, ReadsDiscsThatSpin) {
  const auto scene_of = [](const std::string& bodies, const std::string& term, const std::string& more = "") {
    return "name: spin\nduration: 1\nsteps: 10\nbodies:\n  - {name: ball, radius: 0.1, mass: 3, position: [0, 5]" +
           bodies +
           "}\n  - {name: other, radius: 0.1, mass: 1, position: [1, 5]}\nobjective: {terminal: [{body: ball, " + term +
           "}]}\noptimize: velocity\n" + more;
  };
  const std::string solid = ", inertia: solid, angle: 0.5, angular_velocity: -30";
  const std::string spin = "quantity: angular_velocity, target: -12, weight: 2";
  const Scene scene = SceneOf(ParseScene(scene_of(solid, spin, "free_spin: [ball]\n"), "spin.yaml"));
  EXPECT_EQ(scene.bodies[0].inertia.kind, Inertia::Kind::kSolid);
  EXPECT_DOUBLE_EQ(scene.bodies[0].MomentOfInertia(), 0.015);
  EXPECT_EQ(scene.bodies[0].angle, 0.5);
  EXPECT_EQ(scene.bodies[0].angular_velocity, -30);
  EXPECT_FALSE(scene.bodies[1].Spins());
  EXPECT_TRUE(scene.Spins());
  ASSERT_EQ(scene.objective.terminal.size(), 1u);
  EXPECT_EQ(scene.objective.terminal[0].quantity, TerminalTerm::Quantity::kAngularVelocity);
  EXPECT_EQ(scene.objective.terminal[0].target, Vec2d(-12, 0));
  EXPECT_EQ(scene.free_spin, std::vector<int>{0});
  EXPECT_EQ(SceneOf(ParseScene(WriteScene(scene), "written.yaml")), scene);

  const std::string angle = "quantity: angle, target: 3";
  const Scene given = SceneOf(ParseScene(scene_of(", inertia: 0.02", angle), "spin.yaml"));
  EXPECT_EQ(given.bodies[0].MomentOfInertia(), 0.02);
  EXPECT_EQ(SceneOf(ParseScene(WriteScene(given), "written.yaml")), given);
  const std::string place = "quantity: position, target: [0, 0]";
  EXPECT_FALSE(SceneOf(ParseScene(scene_of(", inertia: none", place), "spin.yaml")).Spins());

  const auto key_of = [&](const std::string& text) { return ErrorOf(text).key; };
  EXPECT_EQ(key_of(scene_of(", inertia: round", place)), "bodies[0].inertia");
  EXPECT_EQ(key_of(scene_of(", inertia: -1", place)), "bodies[0].inertia");
  EXPECT_EQ(key_of(scene_of(", inertia: 0", place)), "bodies[0].inertia");
  EXPECT_EQ(key_of(scene_of(", inertia: [1]", place)), "bodies[0].inertia");
  EXPECT_EQ(key_of(scene_of(", angular_velocity: 3", place)), "bodies[0].angular_velocity");
  EXPECT_EQ(key_of(scene_of(", angle: 3", place)), "bodies[0].angle");
  EXPECT_EQ(key_of(scene_of(solid, "quantity: angle, target: [1, 2]")), "objective.terminal[0].target");
  EXPECT_EQ(key_of(scene_of(solid, "quantity: angle, component: x")), "objective.terminal[0].target");
  EXPECT_EQ(key_of(scene_of("", spin)), "objective.terminal[0].quantity");
  EXPECT_EQ(key_of(scene_of(solid, place, "free_spin: [other]\n")), "free_spin[0]");
  EXPECT_EQ(key_of(scene_of(solid, place, "free_spin: [nobody]\n")), "free_spin[0]");
}

TEST(LoadSceneFile, ReadsTheProblems) {
  Scene expected;
  expected.name = "two_balls";
  expected.steps = 480;
  expected.bodies = {{.name = "striker", .radius = 0.2, .mass = 1, .position = {-2, -2}},
                     {.name = "target", .radius = 0.2, .mass = 1, .position = {-1, -1}}};
  expected.contact = {.restitution = 1, .friction = 0, .stiffness = 1e4, .damping = 0};
  expected.control = {{0}, {{3, 3}}};
  expected.objective = {{{.body = 1}}, 0.1};
  expected.optimize = Optimize::kControl;
  EXPECT_EQ(SceneOf(LoadSceneFile(ProblemPath("two_balls"))), expected);

  expected.name = "single_collision";
  expected.bodies[0].position = {-1, -2};
  expected.control.initial[0] = {0, 3};
  expected.objective.effort = 0.01;
  EXPECT_EQ(SceneOf(LoadSceneFile(ProblemPath("single_collision"))), expected);

  expected.name = "multiple_collisions";
  expected.bodies[0].position = {0.25, -0.3};
  expected.bodies[1].position = {-0.5, 0.6};
  expected.planes = {{"ceiling", {0, 1}, {0, -1}}};
  expected.control.initial[0] = {-3.5, 3};
  EXPECT_EQ(SceneOf(LoadSceneFile(ProblemPath("multiple_collisions"))), expected);
}

TEST(LoadSceneFile, ReadsTheOneBallProblems) {
  const Scene wall = SceneOf(LoadSceneFile(ProblemPath("ground_wall")));
  EXPECT_EQ(wall.optimize, Optimize::kVelocity);
  EXPECT_EQ(wall.free, std::vector<int>{0});
  EXPECT_EQ(wall.dt(), 0.6 / 288);
  EXPECT_EQ(wall.planes.at(1), (Plane{"wall", {1.75, 0}, {-1, 0}}));
  EXPECT_TRUE(wall.objective.IsSumOfSquares());

  const Scene bounce = SceneOf(LoadSceneFile(ProblemPath("bounce_once")));
  EXPECT_EQ(bounce.optimize, Optimize::kNone);
  EXPECT_TRUE(bounce.free.empty());
  EXPECT_EQ(bounce.objective.terminal.at(0).component, 1);
  EXPECT_FALSE(bounce.objective.IsSumOfSquares());
}

TEST(WriteScene, RoundTripsEveryKeyAndEveryProblem) {
  const Scene everything = SceneOf(ParseScene(kEverything, "test.yaml"));
  EXPECT_EQ(SceneOf(ParseScene(WriteScene(everything), "written")), everything);
  for (const char* name : {"bounce_once",
                           "ground_wall",
                           "two_balls",
                           "single_collision",
                           "multiple_collisions",
                           "back_spin",
                           "bank_shot",
                           "carrom_gate",
                           "carrom_pot",
                           "ground_wall_spin"}) {
    SCOPED_TRACE(name);
    const Scene scene = SceneOf(LoadSceneFile(ProblemPath(name)));
    EXPECT_EQ(SceneOf(ParseScene(WriteScene(scene), "written")), scene);
  }
}

TEST(WriteScene, KeepsEveryBitOfItsNumbers) {
  std::mt19937 random(7);
  std::uniform_real_distribution<double> fraction(-1, 1);
  std::uniform_int_distribution<int> exponent(-300, 11);
  const auto number = [&] { return fraction(random) * std::pow(10, exponent(random)); };
  for (int i = 0; i < 200; ++i) {
    Scene scene;
    scene.name = "numbers";
    scene.duration = std::abs(fraction(random));
    scene.steps = 1 + i;
    scene.gravity = {number(), number()};
    scene.bodies = {{.name = "null", .radius = 1e-3, .position = {number(), number()}, .velocity = {number(), -0.0}}};
    scene.control = {{0}, {{number(), number()}}};
    EXPECT_EQ(SceneOf(ParseScene(WriteScene(scene), "written")), scene);
  }
}

TEST(WriteSceneDeathTest, TakesValidScenesOnly) { EXPECT_DEATH(WriteScene(Scene()), "name"); }

// `text` with the first `from` replaced.
std::string Replaced(std::string text, const std::string& from, const std::string& to) {
  const std::size_t at = text.find(from);
  if (at == std::string::npos) {
    ADD_FAILURE() << "no " << from;
    return text;
  }
  return text.replace(at, from.size(), to);
}

struct Case {
  const char* from;
  const char* to;
  int line;
  const char* key;
  const char* message;  // part of it
};

TEST(ParseScene, SaysWhatIsWrongWithBoundsAndConstraints) {
  const Case cases[] = {
      {"max: 3.5", "max: 0", 9, "control.max[0]", "found 0, expected a positive number"},
      {"[4, 5]}", "[4]}", 9, "control.max_norm", "found 1 bounds, expected one number, or one for each of the 2"},
      {"hard: true}]", "hard: true, weight: 2}]", 11, "objective.terminal[0].weight", "the term is hard"},
      {"target: [0, 0], hard",
       "component: x, hard",
       11,
       "objective.terminal[0].target",
       "expected the target of the component, or min or max"},
      {"[0.5, 3, 4]", "[0, 3, 4]", 12, "objective.running[0].target[1]", "rise"},
      {"[0.5, 3, 4]", "[3, 4]", 12, "objective.running[0].target[1]", "a row [time, x, y]"},
      {"time: 0.5", "time: 1", 14, "objective.via[0].time", "expected a time strictly between 0 and the duration, 1"},
      {"time: 0.5", "time: 0", 14, "objective.via[0].time", "expected a time strictly between 0 and the duration, 1"},
      {"time: 0.5, quantity: position",
       "time: 0.5, quantity: angle",
       14,
       "objective.via[0].quantity",
       "found angle, expected position or velocity"},
      {"min: 0.5, max: 2", "min: 0.25, max: 0.5", 14, "objective.via[0].time", "before objective.duration.max, 0.5"},
      {"max_norm: [4, 5]", "max_torque: 2", 9, "control.max_torque", "expected none: there is no key control.torque"},
      {"optimize: control", "optimize: control\nfree: [a]", 20, "free", "for optimize: velocity or position"},
      {"time: 0.5, ", "", 14, "objective.via[0].time", "expected the time in s"},
      {"free: true", "free: false", 17, "objective.duration.free", "expected true"},
      {"max: 2", "max: 0.1", 17, "objective.duration.max", "expected min or more"},
      {"[c, a]", "[c, c]", 18, "no_contact[0]", "two different bodies"},
      {"[c, a]", "[c]", 18, "no_contact[0]", "a pair [body, body or plane]"},
      {"[c, a]", "[c, grund]", 18, "no_contact[0][1]", "the name of a body"},
  };
  for (const Case& c : cases) {
    SCOPED_TRACE(c.to);
    const SceneFileError error = ErrorOf(Replaced(kConstrained, c.from, c.to));
    EXPECT_EQ(error.line, c.line);
    EXPECT_EQ(error.key, c.key);
    EXPECT_THAT(error.message, HasSubstr(c.message));
  }
}

TEST(ParseScene, SaysWhatIsWrongWithGoalRegionsAndLimits) {
  const Case cases[] = {
      {"min: [2, -0.5]", "min: [2, 0.75]", 11, "objective.terminal[0].min", "found 0.75 above max, 0.5"},
      {"min: [2, -0.5]",
       "min: [two, 0]",
       11,
       "objective.terminal[0].min[0]",
       "a number, or null where there is no bound"},
      {"min: [2, -0.5]", "min: [2]", 11, "objective.terminal[0].min", "[x, y], with null where there is no bound"},
      {"min: [2, -0.5], max: [null, 0.5]", "min: [null, null]", 11, "objective.terminal[0].min", "found no bound"},
      {"min: [2, -0.5]", "min: [2, 0], target: [0, 0]", 11, "objective.terminal[0].target", "beside min or max"},
      {"min: [2, -0.5]", "min: [2, 0], weight: 1", 11, "objective.terminal[0].weight", "min and max are constraints"},
      {"min: [2, -0.5]", "min: [2, 0], hard: false", 11, "objective.terminal[0].hard", "min and max are constraints"},
      {"{body: b, quantity: position", "{body: post, quantity: position", 11, "objective.terminal[0].body", "is fixed"},
      {"target: -1, hard: true", "target: -1", 12, "objective.terminal[1].target", "with hard: true a constraint"},
      {"min: 0.25", "component: x, min: 0.25", 14, "objective.terminal[3].component", "the quantity is one number"},
      {"{max: 0.5}", "{max: 0}", 16, "objective.limits[0].speed", "found 0, expected a positive number"},
      {"{max: 0.5}", "{least: 0.5}", 16, "objective.limits[0].speed.least", "expected one of max"},
      {"{max: 0.5}", "0.5", 16, "objective.limits[0].speed", "a map"},
      {"at: end", "at: start", 16, "objective.limits[0].at", "one of end, always"},
      {"{body: b, speed", "{body: post, speed", 17, "objective.limits[1].body", "is fixed"},
  };
  for (const Case& c : cases) {
    SCOPED_TRACE(c.to);
    const SceneFileError error = ErrorOf(Replaced(kRegions, c.from, c.to));
    EXPECT_EQ(error.line, c.line);
    EXPECT_EQ(error.key, c.key);
    EXPECT_THAT(error.message, HasSubstr(c.message));
  }
}

TEST(ParseScene, RefusesACostOfEffortOfNoControl) {
  const std::string scene =
      "name: a\nduration: 1\nsteps: 1\nbodies: [{name: b, radius: 1, mass: 1, position: [0, 0]}]\n"
      "objective:\n  terminal: []\n  effort: 0.1\noptimize: none\n";
  const SceneFileError error = ErrorOf(scene);
  EXPECT_EQ(error.line, 7);
  EXPECT_EQ(error.key, "objective.effort");
  EXPECT_THAT(error.message, HasSubstr("no body is controlled"));
  EXPECT_EQ(SceneOf(ParseScene(Replaced(scene, "0.1", "0"), "test")).objective.effort, 0);
}

TEST(ParseScene, AFreeDurationBetweenEqualBoundsIsTheScenes) {
  const std::string equal = Replaced(kConstrained, "min: 0.5, max: 2, weight: 0.25", "min: 0.75, max: 0.75");
  Scene expected = SceneOf(ParseScene(kConstrained, "test"));
  expected.duration = 0.75;
  expected.objective.duration.reset();
  EXPECT_EQ(SceneOf(ParseScene(equal, "test")), expected);
  // With a price it is kept, for that is a part of the loss.
  const Scene priced = SceneOf(ParseScene(Replaced(equal, "max: 0.75", "max: 0.75, weight: 2"), "test"));
  expected.objective.duration = FreeDuration{0.75, 0.75, 2};
  EXPECT_EQ(priced, expected);
  EXPECT_EQ(SceneOf(ParseScene(WriteScene(priced), "written")), priced);
}

TEST(ParseScene, SaysWhereAndWhy) {
  const Case cases[] = {
      {"radius: 0.2", "raduis: 0.2", 7, "bodies[0].raduis", "did you mean radius?"},
      {"duration:", "durration:", 2, "durration", "did you mean duration?"},
      {"duration: 2.5\n", "", 1, "duration", "found no such key, expected the duration in s"},
      {"gravity:", "steps: 3\ngravity:", 4, "steps", "again"},
      {"radius: 0.2", "radius: -0.2", 7, "bodies[0].radius", "found -0.2, expected a positive number"},
      {"radius: 0.2", "radius: .nan", 7, "bodies[0].radius", "found .nan, expected a finite number"},
      {"radius: 0.2", "radius: inf", 7, "bodies[0].radius", "found inf, expected"},
      {"radius: 0.2", "radius: 1e999", 7, "bodies[0].radius", "found 1e999, expected a finite number"},
      {"radius: 0.2", "radius: 1e300", 7, "bodies[0].radius", "found 1e+300, expected"},
      {"radius: 0.2", "radius: \"0.2\"", 7, "bodies[0].radius", "found the text \"0.2\", expected a finite number"},
      {"radius: 0.2", "radius:", 7, "bodies[0].radius", "found nothing, expected a finite number"},
      {"radius: 0.2", "radius: 0.2 m", 7, "bodies[0].radius", "found 0.2 m"},
      {"mass: 1.0, ", "", 12, "bodies[1].mass", "expected the mass in kg"},
      {"radius: 0.25", "radius: 0.25, mass: 1", 13, "bodies[2].mass", "the body is fixed"},
      {"[3, 0]", "[3, 0], velocity: [1, 0]", 13, "bodies[2].velocity", "expected [0, 0]"},
      {"fixed: false", "fixed: no", 9, "bodies[0].fixed", "expected true or false"},
      {"[-2, 2]", "[-2]", 10, "bodies[0].position", "found a list of 1, expected a vector [x, y]"},
      {"[-2, 2]", "[-2, y]", 10, "bodies[0].position[1]", "found y, expected a finite number"},
      {"[-2, 2]", "[-1.1, 1]", 12, "bodies[1].position", "with bodies[0] (striker)"},
      {"[-2, 2]", "[-2, -0.9]", 10, "bodies[0].position", "with planes[0] (ground)"},
      {"name: post", "name: striker", 13, "bodies[2].name", "unique"},
      {"normal: [0, 2]", "normal: [0, 0]", 15, "planes[0].normal", "found a vector of length 0"},
      {"restitution: 0.5", "restitution: 2", 17, "contact.restitution", "from 0 to 1"},
      {"friction: 0.25", "friction: {static: 1}", 18, "contact.friction", "found a map"},
      {"[target, striker]", "[target, strikr]", 22, "control.bodies[1]", "did you mean striker?"},
      {"[target, striker]", "[target, post]", 22, "control.bodies[1]", "which is fixed"},
      {"[target, striker]", "[]", 22, "control.bodies", "at least one"},
      {"[[3, 4], [5, 6]]", "[[3, 4]]", 23, "control.initial", "found 1 forces"},
      {"[[3, 4], [5, 6]]", "[[3, 4], 5]", 23, "control.initial[1]", "found 5, expected a vector [x, y]"},
      {"component: y", "component: z", 27, "objective.terminal[1].component", "expected one of x, y"},
      {"component: y", "component: y, target: [0, 0]", 27, "objective.terminal[1].target", "expected none"},
      {"target: [0, 1], ", "", 26, "objective.terminal[0].target", "component"},
      {"weight: 2.0", "weight: -2.0", 26, "objective.terminal[0].weight", "found -2"},
      {"quantity: velocity", "quantity: speed", 27, "objective.terminal[1].quantity", "position, velocity"},
      {"optimize: position", "optimize: velocty", 30, "optimize", "did you mean velocity?"},
      {"free: [target]", "free: [post]", 31, "free[0]", "which is fixed"},
      {"free: [target]", "free: target", 31, "free", "expected a list of names"},
      {"steps: 250", "steps: 0", 3, "steps", "found 0, expected"},
      {"steps: 250", "steps: 250.5", 3, "steps", "found 250.5, expected"},
      {"steps: 250", "steps: 1000000000", 3, "steps", "expected a whole number from 1 to"},
      {"steps: 250", "steps: 99999999999999", 3, "steps", "expected"},
      {"name: everything", "name: [a]", 1, "name", "found a list of 1, expected a name"},
      {"name: everything", "name: \"a\\x1b[31m\"", 1, "name", "found the text \"a\\x1b[31m\", expected"},
      {"gravity:", "[a, b]: 1\ngravity:", 4, "", "found a list of 2 as a key"},
      {"gravity:", "<<: {steps: 1}\ngravity:", 4, "<<", "unknown key"},
      {"gravity: [0.5", "gravity: &g [0.5", 4, "", "anchor"},
      {"free: [target]", "free: *g", 31, "", "anchor"},
      {"duration: 2.5", "duration: !!float 2.5", 2, "", "tag"},
      {"free: [target]", "---\nfree: [target]", 31, "", "second document"},
      {"gravity:", "\tgravity:", 4, "", "not YAML"},
      {"gravity: [0.5, ", "gravity: [0.5 ", 4, "gravity", "found a list of 1"},
      {"gravity:", "# \xff\xfe\ngravity:", 4, "", "UTF-8"},
  };
  for (const Case& c : cases) {
    SCOPED_TRACE(c.to);
    const SceneFileError error = ErrorOf(Replaced(kEverything, c.from, c.to));
    EXPECT_EQ(error.file, "test.yaml");
    EXPECT_EQ(error.line, c.line) << error.ToString();
    EXPECT_EQ(error.key, c.key) << error.ToString();
    EXPECT_THAT(error.message, HasSubstr(c.message));
    EXPECT_THAT(error.message, HasSubstr("expected"));
  }
}

TEST(ParseScene, RefusesTextsWithoutAScene) {
  for (const std::string text :
       {"", "\n", "# only a comment\n", "---\n", "~", "[]", "hello", "]", "\"", "{", "\xef\xbb\xbf"}) {
    SCOPED_TRACE(text);
    EXPECT_GE(ErrorOf(text).line, 1);
    EXPECT_THAT(ErrorOf(text).message, HasSubstr("expected"));
  }
}

TEST(ParseScene, RefusesDeepAndLongTexts) {
  for (const std::string part : {"[", "{a: ", "- ", "? "}) {
    std::string text;
    while (text.size() < 100'000) text += part;
    SCOPED_TRACE(part);
    EXPECT_THAT(ErrorOf(text).message, HasSubstr("nested deeper"));
  }
  EXPECT_THAT(ErrorOf(std::string(kMaxSceneBytes + 1, '#')).message, HasSubstr("bytes"));
}

TEST(ParseScene, RefusesAnAliasBomb) {
  std::string text = "a: &a [x, x]\n";
  for (char c = 'b'; c <= 'z'; ++c) {
    text += {c, ':', ' ', '&', c, ' ', '['};
    for (int i = 0; i < 9; ++i) text += {'*', static_cast<char>(c - 1), ','};
    text += "]\n";
  }
  EXPECT_EQ(ErrorOf(text).line, 1);
  EXPECT_THAT(ErrorOf(text).message, HasSubstr("anchor"));
}

TEST(ParseScene, KeepsMessagesShortAndValidText) {
  std::string name;
  while (name.size() < 600) name += "\xc3\xa9";
  const SceneFileError error = ErrorOf(name + ": 1\n");
  EXPECT_LT(error.ToString().size(), 400u);
  EXPECT_EQ(error.key.size(), 63u);  // 30 characters of two bytes, and three dots
}

TEST(ParseScene, ReadsWindowsLineEndsAndAByteOrderMark) {
  std::string text = "\xef\xbb\xbf";
  for (const char c : std::string(kEverything)) text += c == '\n' ? std::string("\r\n") : std::string(1, c);
  EXPECT_EQ(SceneOf(ParseScene(text, "test.yaml")), SceneOf(ParseScene(kEverything, "test.yaml")));
}

TEST(LoadSceneFile, SaysThatItCannotRead) {
  const auto missing = LoadSceneFile(BuildFolder() + "/no_such_scene.yaml");
  ASSERT_TRUE(std::holds_alternative<SceneFileError>(missing));
  EXPECT_THAT(std::get<SceneFileError>(missing).ToString(), HasSubstr("no_such_scene.yaml: cannot read: No such file"));
  const auto directory = LoadSceneFile(SourceFolder());
  ASSERT_TRUE(std::holds_alternative<SceneFileError>(directory));
  EXPECT_THAT(std::get<SceneFileError>(directory).message, HasSubstr("it is a directory"));
  EXPECT_TRUE(std::holds_alternative<SceneFileError>(LoadSceneFile("")));
}

TEST(LoadSceneFile, NamesTheFileInErrors) {
  const std::string path = TempFile("saltus_bad_scene.yaml");
  std::ofstream(path) << Replaced(kEverything, "mass: 1.5", "mass: 0");
  const auto result = LoadSceneFile(path);
  std::filesystem::remove(path);
  ASSERT_TRUE(std::holds_alternative<SceneFileError>(result));
  EXPECT_EQ(std::get<SceneFileError>(result).ToString(),
            path + ":8: bodies[0].mass: found 0, expected a positive number, 1e-24 to 1e24");
}

}  // namespace
}  // namespace saltus
