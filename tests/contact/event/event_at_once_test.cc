// Events at the same time under the event-driven model: its gradient against closed forms and against differences from
// both sides, for pairs of kinds of events and at many step counts.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <memory>
#include <numbers>
#include <string>
#include <vector>

#include "contact/random_scene.h"
#include "saltus/simulate/registry.h"

namespace saltus {
namespace {

using ::testing::ElementsAreArray;

constexpr double kTogether = 0.5;  // s, when the events of a scene happen

// A rollout as every program runs it.
struct EventRun {
  explicit EventRun(const Scene& scene)
      : simulator(MakeSimulator("event", scene, Precision::kDouble)), start(InitialState(scene)) {
    EXPECT_FALSE(Validate(scene).has_value());
    Rollout(start);
  }
  std::vector<double> Rollout(const std::vector<double>& from) {
    EXPECT_TRUE(simulator->Rollout(from, {})) << simulator->FailureReason();
    std::vector<double> end(simulator->state_size());
    simulator->GetState(simulator->num_steps(), end);
    return end;
  }
  std::vector<double> GradientOf(int row) {
    std::vector<double> cotangent(simulator->state_size());
    cotangent[row] = 1;
    Sensitivity gradient;
    simulator->Adjoint(cotangent, false, &gradient);
    return gradient.initial;
  }

  std::unique_ptr<Simulator> simulator;
  std::vector<double> start;
};

Vec2d Turned(const Vec2d& v, double angle) {
  return {std::cos(angle) * v[0] - std::sin(angle) * v[1], std::sin(angle) * v[0] + std::cos(angle) * v[1]};
}

Scene Empty(double restitution) {
  Scene scene;
  scene.name = "at_once";
  scene.duration = 1;
  scene.steps = 41;
  scene.contact = {.restitution = restitution};
  return scene;
}

// A disc that strikes both walls of a right-angled corner at `time`.
struct Corner {
  Vec2d point = Vec2d(0, 0);
  double angle = 0, radius = 0.25, time = 0.5, restitution = 0.7;
  Vec2d velocity = Vec2d(-2, -2);  // in the frame of the corner

  Scene At(int steps) const {
    Scene scene = Empty(restitution);
    scene.steps = steps;
    const Vec2d start = Vec2d(radius, radius) - time * velocity;
    scene.bodies = {{.name = "a", .radius = radius, .position = point + Turned(start, angle)}};
    scene.bodies[0].velocity = Turned(velocity, angle);
    scene.planes = {{"ground", point, Turned({0, 1}, angle)}, {"wall", point, Turned({1, 0}, angle)}};
    return scene;
  }
  // Along either axis of the corner the disc ends at r - e (p - r) - e v T, with the velocity -e v: these multiples of
  // the unit matrix, whatever the angle.
  void ExpectExact(int steps) const {
    EventRun run(At(steps));
    const double e = restitution;
    for (int row = 0; row < 4; ++row) {
      const std::vector<double> found = run.GradientOf(row);
      std::array<double, 4> expected{};
      if (row < 2) {
        expected[row] = -e;
        expected[row + 2] = -e;
      } else {
        expected[row] = -e;
      }
      for (int column = 0; column < 4; ++column) {
        ASSERT_NEAR(found[column], expected[column], 1e-9) << steps << " steps, row " << row << ", column " << column;
      }
    }
  }
};

TEST(EventAtOnce, ACornerAtEveryStepCount) {
  for (int steps = 1; steps <= 3000; ++steps) Corner().ExpectExact(steps);
}

TEST(EventAtOnce, CornersOfAllOrientations) {
  testing::RandomScenes random(1);
  for (int trial = 0; trial < 3000; ++trial) {
    Corner corner;
    corner.point = random.InSquare(10);
    corner.angle = random.Uniform(0, 2 * std::numbers::pi);
    corner.radius = random.Uniform(0.05, 1);
    corner.restitution = random.Uniform(0, 1);
    corner.velocity = -Vec2d(random.Uniform(0.1, 5), random.Uniform(0.1, 5));
    const int steps = random.Integer(1, 400);
    // On a node as often as not.
    corner.time = random.Chance(0.5) ? random.Uniform(0.05, 0.95) : random.Integer(1, steps) / (steps + 1.0);
    corner.ExpectExact(corner.time * (steps + 1) == std::round(corner.time * (steps + 1)) ? steps + 1 : steps);
    if (HasFatalFailure()) FAIL() << "trial " << trial;
  }
}

// ---------------------------------------------------------------------------------------------------------------------
// Pairs of events

struct AtOnce {
  std::string name;
  Scene scene;
  std::vector<std::string> kinks = {};  // entries by which derivatives from both sides differ
  double tolerance = 1e-6;
  // The kinks at which the gradient is the slope to neither side. It is that of one order of the events, and two discs
  // that are moved across their line of centres meet later whichever the direction.
  std::vector<std::string> neither = {};
};

// In a wedge of pi / n, what bounces without loss moves on as if it had gone straight through n images of the wedge:
// the order of the impacts does not matter, nor for derivatives.
AtOnce Wedge(int n) {
  const double angle = std::numbers::pi / n, radius = 0.2;
  AtOnce row{"two walls at pi / " + std::to_string(n), Empty(1)};
  const Vec2d center(radius / std::tan(angle / 2), radius), velocity(-1.1, -0.4);
  row.scene.bodies = {{.name = "a", .radius = radius, .position = center - kTogether * velocity}};
  row.scene.bodies[0].velocity = velocity;
  row.scene.planes = {{"ground", {0, 0}, {0, 1}}, {"wall", {0, 0}, {std::sin(angle), -std::cos(angle)}}};
  return row;
}

AtOnce TwoDiscsOnTheirOwn() {
  AtOnce row{"impacts of discs that never meet", Empty(0.6)};
  row.scene.bodies = {{.name = "a", .radius = 0.1, .position = {-1, 0.6}, .velocity = {0.2, -1}},
                      {.name = "b", .radius = 0.2, .mass = 2, .position = {1, 1.2}, .velocity = {-0.3, -2}}};
  row.scene.planes = {{"ground", {0, 0}, {0, 1}}};
  return row;
}

AtOnce GroundAndDisc() {
  AtOnce row{"ground and disc", Empty(1), {"py a", "vy a", "py b", "vy b"}};
  row.scene.bodies = {{.name = "a", .radius = 0.25, .position = {0, 1.25}, .velocity = {1, -2}},
                      {.name = "b", .radius = 0.25, .position = {1.5, 1.25}, .velocity = {-1, -2}}};
  row.scene.planes = {{"ground", {0, 0}, {0, 1}}};
  return row;
}

AtOnce StruckFromBothSides() {
  AtOnce row{"a disc between two", Empty(1)};
  row.scene.bodies = {{.name = "a", .radius = 0.1, .position = {-0.7, 0}, .velocity = {1, 0}},
                      {.name = "b", .radius = 0.1},
                      {.name = "c", .radius = 0.1, .position = {0.7, 0}, .velocity = {-1, 0}}};
  return row;
}

AtOnce OnANode() {
  AtOnce row{"an impact and a node", Empty(0.8)};
  row.scene.gravity = {0.3, -2};
  row.scene.bodies = {{.name = "a", .radius = 0.25, .position = {0, 1}, .velocity = {0.3, -1}}};
  row.scene.planes = {{"ground", {0, 0}, {0, 1}}};
  return row;
}

AtOnce CornerAndDisc() {
  AtOnce row{"a corner, and a disc in it", Empty(0.7)};
  row.scene.bodies = {{.name = "a", .radius = 0.25, .position = {1.25, 1.25}, .velocity = {-2, -2}},
                      {.name = "b", .radius = 0.1, .position = {2, 0.6}, .velocity = {0, -1}}};
  row.scene.planes = {{"ground", {0, 0}, {0, 1}}, {"wall", {0, 0}, {1, 0}}};
  return row;
}

AtOnce PocketBesideAnImpact() {
  AtOnce row{"a pocket and an impact, of two discs", Empty(0.7)};
  row.scene.bodies = {{.name = "a", .radius = 0.1, .position = {-1.2, 0.65}, .velocity = {2, 0.3}},
                      {.name = "b", .radius = 0.1, .position = {1, 1.1}, .velocity = {0.1, -2}}};
  row.scene.planes = {{"ground", {0, 0}, {0, 1}}};
  row.scene.pockets = {{"hole", {0, 0.8}, 0.2}};
  return row;
}

// It strikes the ground where it comes to the rim: whichever comes first, it lies there; what moves it along the rim
// does so by its velocity before or after the impact.
AtOnce PocketAndImpact() {
  AtOnce row{"a pocket and an impact, of one disc", Empty(0.7), {"py a", "vy a", "px a", "vx a"}};
  row.scene.bodies = {{.name = "a", .radius = 0.1, .position = {-1, 0.6}, .velocity = {2, -1}}};
  row.scene.planes = {{"ground", {0, 0}, {0, 1}}};
  row.scene.pockets = {{"hole", {0.16, 0.22}, 0.2}};
  return row;
}

// A disc slides to a stop as another that slides beside it does, and as a third strikes the ground.
AtOnce TwoStops() {
  AtOnce row{"two stops and an impact", Empty(0), {"py a", "py b"}};  // they cannot begin below the ground
  const double mu = 0.2, g = 10;
  row.scene.gravity = {0, -g};
  row.scene.contact = {.restitution = 0, .friction = mu};
  row.scene.bodies = {{.name = "a", .radius = 0.1, .position = {-1, 0.1}, .velocity = {kTogether * mu * g, 0}},
                      {.name = "b", .radius = 0.1, .position = {1, 0.1}, .velocity = {kTogether * mu * g, 0}},
                      {.name = "c", .radius = 0.1, .position = {3, 0.1 + 1.25}}};
  row.scene.planes = {{"ground", {0, 0}, {0, 1}}};
  return row;
}

// The second strikes the first along the ground where that comes to lie: earlier, from obliquely below.
AtOnce LandingAndHit() {
  AtOnce row{"a landing and a hit", Empty(0), {"px a", "vx a", "px b", "vx b", "py a", "vy a", "py b", "vy b"}};
  row.neither = {"py b", "vy b"};
  row.scene.bodies = {{.name = "a", .radius = 0.1, .position = {0, 0.6}, .velocity = {0.2, -1}},
                      {.name = "b", .radius = 0.05, .position = {0.75, 0.1}, .velocity = {-1, 0}}};
  row.scene.planes = {{"ground", {0, 0}, {0, 1}}};
  return row;
}

// Where it is struck before it stops, it still moves.
AtOnce StopAndHit() {
  AtOnce row{"a stop and a hit", Empty(0.5), {"px a", "vx a", "px b", "vx b"}};
  const double slowing = 0.4;
  row.scene.table = TableFriction{.friction = slowing / 10, .gravity = 10};
  row.scene.bodies = {{.name = "a", .radius = 0.1, .velocity = {slowing * kTogether, 0}}, {.name = "b", .radius = 0.1}};
  const double from = 0.5 * slowing * kTogether * kTogether + 0.2, speed = 1.5;
  row.scene.bodies[1].position = {from + speed * kTogether - 0.5 * slowing * kTogether * kTogether, 0};
  row.scene.bodies[1].velocity = {-speed, 0};
  return row;
}

AtOnce StopBesideImpact() {
  AtOnce row{"a stop and an impact, of two discs", Empty(0.5)};
  row.scene.table = TableFriction{.friction = 0.04, .gravity = 10};
  row.scene.bodies = {{.name = "a", .radius = 0.1, .position = {-1, 1}, .velocity = {0.4 * kTogether, 0}},
                      {.name = "b", .radius = 0.1, .position = {1, 0.1 + 0.5 - 0.05}, .velocity = {0, -1}}};
  row.scene.planes = {{"ground", {0, 0}, {0, 1}}};
  return row;
}

// A disc slides over the end of a segment as another strikes it from ahead.
AtOnce EndOfEdgeAndHit() {
  AtOnce row{"the end of an edge and a hit", Empty(0), {"py a", "px a", "vx a", "px b", "vx b", "py b", "vy b"}};
  const double g = 2, speed = 1;
  row.scene.gravity = {0, -g};
  row.scene.segments = {{"edge", {-3, 0}, {0, 0}}};
  row.scene.bodies = {
      {.name = "a", .radius = 0.1, .position = {-kTogether * speed, 0.1}, .velocity = {speed, 0}},
      {.name = "b", .radius = 0.1, .position = {0.2 + kTogether, 0.1}, .velocity = {-1, 0.5 * g * kTogether}}};
  return row;
}

// Discs of one mass along a line pass their velocities on, in whatever order.
AtOnce Chain() {
  AtOnce row{"a chain to a wall", Empty(1)};
  row.scene.bodies = {{.name = "a", .radius = 0.1, .position = {-0.3 - 1.5, 0}, .velocity = {3, 0}},
                      {.name = "b", .radius = 0.1, .position = {-0.1 - 0.5, 0}, .velocity = {1, 0}}};
  row.scene.planes = {{"wall", {0, 0}, {-1, 0}}};
  return row;
}

std::vector<AtOnce> Pairs() {
  return {Wedge(2),
          Wedge(3),
          Wedge(4),
          TwoDiscsOnTheirOwn(),
          GroundAndDisc(),
          StruckFromBothSides(),
          OnANode(),
          CornerAndDisc(),
          PocketBesideAnImpact(),
          PocketAndImpact(),
          TwoStops(),
          LandingAndHit(),
          StopAndHit(),
          StopBesideImpact(),
          EndOfEdgeAndHit(),
          Chain()};
}

using Ends = std::vector<double>;

// The derivatives of the final state by entry `column` of the initial one, from the side of `sign`: of the parabola
// through differences of three widths.
Ends SlopesFrom(const Scene& scene, int column, double sign) {
  EventRun run(scene);
  const Ends at = run.Rollout(run.start);
  Ends slopes(at.size(), 0.0);
  constexpr double kWidth = 1e-4;
  for (const auto& [part, weight] : {std::pair{1.0, 1 / 3.0}, {0.5, -2.0}, {0.25, 8 / 3.0}}) {
    std::vector<double> start = run.start;
    start[column] += sign * part * kWidth;
    const Ends end = run.Rollout(start);
    for (std::size_t i = 0; i < at.size(); ++i) slopes[i] += weight * sign * (end[i] - at[i]) / (part * kWidth);
  }
  return slopes;
}

double Distance(const Ends& a, const Ends& b) {
  double largest = 0;
  for (std::size_t i = 0; i < a.size(); ++i) largest = std::max(largest, std::abs(a[i] - b[i]) / (1 + std::abs(a[i])));
  return largest;
}

// At each number of steps the gradient is that of differences from both sides or, at kinks, from one. With `any_order`,
// rounding may decide the order of the events: at fewer entries than listed the gradient is then the slope to neither.
void ExpectDifferences(const AtOnce& row, const std::vector<int>& all_steps, bool any_order = false) {
  SCOPED_TRACE(row.name);
  const int size = 4 * row.scene.num_bodies();
  std::vector<std::array<Ends, 2>> slopes;
  for (int column = 0; column < size; ++column) {
    slopes.push_back({SlopesFrom(row.scene, column, -1), SlopesFrom(row.scene, column, 1)});
  }
  for (const int steps : all_steps) {
    Scene scene = row.scene;
    scene.steps = steps;
    EventRun run(scene);
    std::vector<Ends> by_column(size, Ends(size));
    for (int i = 0; i < size; ++i) {
      const std::vector<double> gradient = run.GradientOf(i);
      for (int column = 0; column < size; ++column) by_column[column][i] = gradient[column];
    }
    std::vector<std::string> kinks, neither;
    for (int column = 0; column < size; ++column) {
      const std::string name =
          std::string(column % 4 < 2 ? "p" : "v") + (column % 2 == 0 ? "x " : "y ") + scene.bodies[column / 4].name;
      const auto& [below, above] = slopes[column];
      const double from_below = Distance(below, by_column[column]), from_above = Distance(above, by_column[column]);
      if (Distance(below, above) <= row.tolerance) {
        EXPECT_LE(from_above, row.tolerance) << name << ", " << steps << " steps";
      } else {
        kinks.push_back(name);
        if (std::min(from_below, from_above) > row.tolerance) neither.push_back(name);
      }
    }
    EXPECT_THAT(kinks, ::testing::UnorderedElementsAreArray(row.kinks)) << steps << " steps";
    if (any_order) {
      EXPECT_THAT(neither, ::testing::IsSubsetOf(row.neither)) << steps << " steps";
    } else {
      EXPECT_THAT(neither, ::testing::UnorderedElementsAreArray(row.neither)) << steps << " steps";
    }
  }
}

TEST(EventAtOnce, GradientsAreDifferencesFromBothSidesOrOne) {
  for (const AtOnce& row : Pairs()) ExpectDifferences(row, {1, 2, 3, 4, 5, 7, 10, 40, 41, 100, 554});
}

// Events that share a disc, on a node: rounding finds each of them in the step before the node or in that after it.
TEST(EventAtOnce, OnNodesOfManyGrids) {
  std::vector<int> steps;
  for (int even = 2; even <= 600; even += 2) steps.push_back(even);
  for (int even = 700; even <= 3000; even += 100) steps.push_back(even);
  for (const AtOnce& row : {StopAndHit(), LandingAndHit(), GroundAndDisc()})
    ExpectDifferences(row, steps, /*any_order=*/true);
}

}  // namespace
}  // namespace saltus
