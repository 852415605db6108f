// Derivatives of motion in lasting contact, against differences of the loss itself from each side, and which of them
// exist from one side only.
#include "saltus/simulate/one_sided_derivatives.h"

#include <gtest/gtest.h>

#include <Eigen/LU>
#include <cmath>
#include <functional>
#include <limits>

#include "contact/event/event_run.h"
#include "parameter_name.h"

namespace saltus {
namespace {

using testing::EventRun;
using testing::HeldControl;
using testing::StartOf;
using Quantity = OneSided::Quantity;
using Side = OneSided::Side;

// A loss in which every entry of the final state takes part.
double Weight(std::size_t i) { return 0.3 + 0.17 * std::cos(3.0 * static_cast<double>(i)); }
double Bend(std::size_t i) { return 0.4 * std::sin(1.0 + static_cast<double>(i)); }

struct Start {
  Scene scene;
  std::vector<double> initial, control;

  explicit Start(const Scene& of) : scene(of), initial(StartOf(of)), control(HeldControl(of)) {}

  double Loss() const {
    const std::unique_ptr<Simulator> made_simulator = testing::MakeEventSimulator(scene);
    Simulator& simulator = *made_simulator;
    EXPECT_TRUE(simulator.Rollout(initial, control));
    std::vector<double> end(simulator.state_size());
    simulator.GetState(scene.steps, end);
    double loss = 0;
    for (std::size_t i = 0; i < end.size(); ++i) loss += end[i] * (Weight(i) + 0.5 * Bend(i) * end[i]);
    return loss;
  }
  Sensitivity Gradient() const {
    const std::unique_ptr<Simulator> made_simulator = testing::MakeEventSimulator(scene);
    Simulator& simulator = *made_simulator;
    EXPECT_TRUE(simulator.Rollout(initial, control));
    std::vector<double> end(simulator.state_size()), cotangent(end.size());
    simulator.GetState(scene.steps, end);
    for (std::size_t i = 0; i < end.size(); ++i) cotangent[i] = Weight(i) + Bend(i) * end[i];
    Sensitivity gradient;
    simulator.Adjoint(cotangent, true, &gradient);
    return gradient;
  }
};

// The derivative of loss(s) at s = 0 from the side of `sign`, extrapolated over widths that fall by four. A disc that
// is lifted by s falls for a time that goes as its root, so the error is a series in the root of the width.
double Slope(const std::function<double(double)>& loss, double sign, double width, int widths = 6) {
  const double here = loss(0);
  double best = 0, smallest = std::numeric_limits<double>::infinity();
  std::vector<double> before, row;
  for (int i = 0; i < widths; ++i, width /= 4) {
    row = {(loss(sign * width) - here) / (sign * width)};
    for (int j = 1; j <= i; ++j) {
      const double ratio = std::ldexp(1.0, j);
      row.push_back((ratio * row[j - 1] - before[j - 1]) / (ratio - 1));
      const double change = std::abs(row[j] - row[j - 1]) + std::abs(row[j] - before[j - 1]);
      if (change < smallest) {
        smallest = change;
        best = row[j];
      }
    }
    before = row;
  }
  return best;
}

struct Widths {
  double position = 4e-3, velocity = 4e-2, parameter = 1e-2;
  int count = 6;
};

// Every derivative against differences from each side on which OneSidedDerivatives() says that it exists.
void ExpectSlopes(const std::string& name, Scene scene, double tolerance, const Widths& widths = {}) {
  SCOPED_TRACE(name);
  // That loss has velocities in it.
  scene.objective.terminal = {{.body = 0, .quantity = TerminalTerm::Quantity::kVelocity}};
  const Start here(scene);
  const Sensitivity gradient = here.Gradient();
  const std::vector<OneSided> one_sided = OneSidedDerivatives(scene);
  const auto expect = [&](const std::string& entry, double derivative, Side side, double width, const auto& move) {
    const auto loss = [&](double s) {
      Start moved = here;
      move(&moved, s);
      return moved.Loss();
    };
    for (const auto& [sign, with] : {std::pair{1.0, Side::kAbove}, {-1.0, Side::kBelow}}) {
      // kNone here stands for both sides.
      if (side != Side::kNone && side != with) continue;
      EXPECT_NEAR(derivative, Slope(loss, sign, width, widths.count), tolerance * (1 + std::abs(derivative)))
          << entry << " from " << SideToString(with);
    }
  };
  for (std::size_t i = 0; i < here.initial.size(); ++i) {
    const int body = static_cast<int>(i / 4), k = static_cast<int>(i % 2);
    const Quantity quantity = i % 4 < 2 ? Quantity::kPosition : Quantity::kVelocity;
    if (scene.bodies[body].fixed) continue;
    Side side = Side::kNone;
    bool exists = true;
    for (const OneSided& entry : one_sided) {
      if (entry.body != body || entry.quantity != quantity || entry.component != k) continue;
      side = entry.side;
      exists = side != Side::kNone;
    }
    if (!exists) continue;
    expect(std::string(QuantityToString(quantity)) + (k == 0 ? " x " : " y ") + scene.bodies[body].name,
           gradient.initial[i],
           side,
           quantity == Quantity::kPosition ? widths.position : widths.velocity,
           [&](Start* at, double s) { at->initial[i] += s; });
  }
  const std::size_t width = 2 * scene.num_controlled();
  for (std::size_t j = 0; j < width; ++j) {
    double derivative = 0;
    for (std::size_t k = j; k < here.control.size(); k += width) derivative += gradient.control[k];
    expect("force " + std::to_string(j), derivative, Side::kNone, widths.velocity, [&](Start* at, double s) {
      for (std::size_t k = j; k < at->control.size(); k += width) at->control[k] += s;
    });
  }
  const ParameterGradient& p = gradient.parameters;
  for (int j : {0, 1}) {
    expect(
        "gravity", p.gravity[j], Side::kNone, widths.velocity, [&](Start* at, double s) { at->scene.gravity[j] += s; });
  }
  const Side of_friction = scene.contact.friction > 0 ? Side::kNone : Side::kAbove;
  expect("friction", p.friction, of_friction, widths.parameter, [](Start* at, double s) {
    at->scene.contact.friction += s;
  });
  const double e = scene.contact.restitution;
  const Side of_restitution = e == 0 ? Side::kAbove : e == 1 ? Side::kBelow : Side::kNone;
  expect("restitution", p.restitution, of_restitution, widths.parameter, [](Start* at, double s) {
    at->scene.contact.restitution += s;
  });
  for (int i = 0; i < scene.num_bodies(); ++i) {
    if (scene.bodies[i].fixed) continue;
    expect(
        "mass", p.mass[i], Side::kNone, widths.parameter, [&](Start* at, double s) { at->scene.bodies[i].mass += s; });
  }
}

const Plane kGround{"ground", {0, 0}, {0, 1}};

Scene Empty(double restitution, double friction, double duration) {
  Scene scene;
  scene.duration = duration;
  scene.steps = 20;
  scene.gravity = {0, -9.8};
  scene.contact.restitution = restitution;
  scene.contact.friction = friction;
  return scene;
}

// One disc on a plane that is inclined by `angle`, at a speed uphill, under a force.
Scene OnPlane(double restitution, double friction, double angle, double speed, const Vec2d& force) {
  Scene scene = Empty(restitution, friction, 1);
  const Vec2d normal(std::sin(angle), std::cos(angle));
  scene.planes = {{"slope", {0, 0}, normal}};
  scene.bodies = {{.name = "puck",
                   .radius = 0.1,
                   .mass = 1.5,
                   .position = 0.1 * normal,
                   .velocity = speed * Perpendicular(normal)}};
  scene.control = {{0}, {force}};
  return scene;
}

class EventSides : public ::testing::TestWithParam<double> {};
INSTANTIATE_TEST_SUITE_P(Restitution, EventSides, ::testing::Values(0.0, 0.3, 0.7), ParameterName());

TEST_P(EventSides, OnOnePlane) {
  const double e = GetParam();
  for (double mu : {0.0, 0.3}) {
    ExpectSlopes("sliding", OnPlane(e, mu, 0, -4, {0.1, -0.2}), 1e-5);
    ExpectSlopes("sliding uphill", OnPlane(e, mu, 0.25, 3, {0, 0}), 1e-5);
    ExpectSlopes("beginning to slide", OnPlane(e, mu, 0.7, 0, {0, 0}), 1e-5);
  }
  ExpectSlopes("resting", OnPlane(e, 0.3, 0, 0, {0, 0}), 1e-5);
  ExpectSlopes("resting on a slope", OnPlane(e, 0.3, 0.25, 0, {0, 0}), 1e-4);
  ExpectSlopes("held against a push", OnPlane(e, 0.3, 0, 0, {4, 0.1}), 1e-4);
}

TEST_P(EventSides, OnTwoPlanes) {
  for (double mu : {0.0, 0.3}) {
    Scene scene = Empty(GetParam(), mu, 1);
    scene.planes = {kGround, {"wall", {0.1, 0}, {-1, 0}}};
    scene.bodies = {{.name = "puck", .radius = 0.1, .mass = 1.5, .position = {0, 0.1}}};
    scene.control = {{0}, {Vec2d(4.6, 0)}};
    ExpectSlopes("corner", scene, 1e-6);
    scene.planes = {{"left", {0, 0}, {1, 1}}, {"right", {0, 0}, {-1, 2}}};
    Eigen::Matrix2d normals;
    normals << scene.planes[0].normal.normalized().transpose(), scene.planes[1].normal.normalized().transpose();
    scene.bodies[0].position = normals.inverse() * Eigen::Vector2d(0.1, 0.1);
    ExpectSlopes("wedge", scene, 1e-6);
  }
}

// Where discs slide along each other they move in arcs; short steps hold one each, so the loss is smooth.
TEST_P(EventSides, OnDiscs) {
  const double e = GetParam();
  for (double mu : {0.0, 0.3}) {
    Scene hill = Empty(e, mu, 0.25);
    hill.steps = 1000;
    const Vec2d normal(std::sin(0.3), std::cos(0.3));
    hill.bodies = {{.name = "ball",
                    .radius = 0.1,
                    .mass = 1.5,
                    .position = 0.5 * normal,
                    .velocity = -1.2 * Perpendicular(normal)},
                   {.name = "hill", .radius = 0.4, .fixed = true}};
    hill.control = {{0}, {Vec2d(0, 0)}};
    ExpectSlopes("hill", hill, 2e-3, {.position = 4e-4, .velocity = 4e-3, .parameter = 4e-3});
  }
  // With friction only the lowest disc of a stack slides. One that is shifted off it opens its contact to second order
  // and falls, at speeds as small as those below which event_disc.h neglects them; so are the differences.
  for (int discs : {2, 3}) {
    Scene stack = Empty(e, 0.3, 0.3);
    stack.planes = {kGround};
    for (int i = 0; i < discs; ++i) {
      stack.bodies.push_back({.name = "disc" + std::to_string(i),
                              .radius = 0.1,
                              .mass = 1.5 - 0.3 * i,
                              .position = {0, 0.1 + 0.2 * i},
                              .velocity = {2.5, 0}});
      stack.control.bodies.push_back(i);
      stack.control.initial.push_back({i == 0 ? 0 : -1.5 * stack.bodies[i].mass, 0});
    }
    ExpectSlopes("stack", stack, 1e-2, {.position = 1.6e-2, .count = 4});
  }
}

// The published derivation: m dv_n less of impulse, of which friction takes mu.
TEST(EventSidesPuck, FrictionTakesItsShareOfTheBounces) {
  for (double e : {0.0, 0.5, 0.9}) {
    Scene scene;
    scene.duration = 2;
    scene.steps = 400;
    scene.gravity = {0, -9.81};
    scene.bodies = {{.name = "puck", .radius = 0.1, .position = {0, 0.1}, .velocity = {3, 0}}};
    scene.planes = {kGround};
    scene.contact.restitution = e;
    scene.contact.friction = 0.3;
    scene.objective.terminal = {{.body = 0, .target = {2, 0.1}}};
    const double t = 3 / (0.3 * 9.81), stop = 3 * t / 2, slope = 2 * (stop - 2);
    EventRun run(scene);
    const Sensitivity gradient = run.Gradient();
    EXPECT_NEAR(run.Loss(), std::pow(stop - 2, 2), 1e-12);
    EXPECT_NEAR(gradient.initial[2], slope * t, 1e-11);
    EXPECT_NEAR(gradient.initial[3], slope * 0.3 * t, 1e-11);
    EXPECT_NEAR(gradient.initial[3], -0.288, 1e-3);
    EXPECT_NEAR(gradient.initial[1], slope * 0.3, 1e-11);
    EXPECT_NEAR(gradient.initial[1], -0.2826, 1e-3);
    EXPECT_EQ(OneSidedDerivatives(scene), (std::vector<OneSided>{{0, Quantity::kPosition, 1, Side::kAbove}}));
  }
}

// A contact with a force that bounces strikes the discs that touch one of its discs.
TEST_P(EventSides, BesideOneThatTouchesOnly) {
  Scene row = Empty(GetParam(), 0, 0.3);
  row.gravity = {0, 0};
  for (int i = 0; i < 3; ++i) {
    row.bodies.push_back({.name = "disc" + std::to_string(i), .radius = 0.1, .mass = 1, .position = {0.2 * i, 0}});
  }
  row.control = {{1, 2}, {Vec2d(3.6, 0), Vec2d(-1.1, 0)}};
  ExpectSlopes("row", row, 1e-5);
  std::vector<OneSided> along;
  for (int i = 0; i < 3; ++i) {
    const Side side = i == 0 ? Side::kBelow : Side::kNone;
    for (const auto quantity : {Quantity::kPosition, Quantity::kVelocity}) along.push_back({i, quantity, 0, side});
  }
  std::vector<OneSided> found = OneSidedDerivatives(row);
  std::erase_if(found, [](const OneSided& entry) { return entry.component != 0; });
  EXPECT_EQ(found, along);
}

TEST(EventSidesOfScenes, WhichExist) {
  // Bounces that never end: positions have a derivative by velocity, velocities have none.
  Scene scene = OnPlane(1, 0, 0, 2, {0, 0});
  const OneSided height{0, Quantity::kPosition, 1, Side::kNone}, speed{0, Quantity::kVelocity, 1, Side::kNone};
  EXPECT_EQ(OneSidedDerivatives(scene), std::vector<OneSided>{height});
  scene.objective.terminal = {{.body = 0, .quantity = TerminalTerm::Quantity::kVelocity}};
  EXPECT_EQ(OneSidedDerivatives(scene), (std::vector<OneSided>{height, speed}));

  // Two that touch and are not pressed together: each may move away.
  scene = Empty(0.5, 0, 1);
  scene.gravity = {0, 0};
  scene.bodies = {{.name = "a", .radius = 0.1, .position = {0, 0}}, {.name = "b", .radius = 0.1, .position = {0.2, 0}}};
  std::vector<OneSided> apart;
  for (int i : {0, 1}) {
    const Side side = i == 0 ? Side::kBelow : Side::kAbove;
    apart.push_back({i, Quantity::kPosition, 0, side});
    apart.push_back({i, Quantity::kVelocity, 0, side});
  }
  EXPECT_EQ(OneSidedDerivatives(scene), apart);
  // One that leaves: nothing but overlap is missing.
  scene.bodies[0].velocity = {-1, 0};
  apart = {{0, Quantity::kPosition, 0, Side::kBelow}, {1, Quantity::kPosition, 0, Side::kAbove}};
  EXPECT_EQ(OneSidedDerivatives(scene), apart);
  scene.bodies[0].position[0] = -0.01;
  EXPECT_TRUE(OneSidedDerivatives(scene).empty());

  // One that slides past another: a little behind, it would still meet it.
  scene.bodies[0].position = {0.2, -0.2};
  scene.bodies[0].velocity = {1, 0};
  std::vector<OneSided> ahead;
  for (int i : {0, 1}) {
    const Side forth = i == 0 ? Side::kAbove : Side::kBelow, apart_y = i == 0 ? Side::kBelow : Side::kAbove;
    ahead.push_back({i, Quantity::kPosition, 0, forth});
    ahead.push_back({i, Quantity::kPosition, 1, apart_y});
    ahead.push_back({i, Quantity::kVelocity, 1, apart_y});
  }
  EXPECT_EQ(OneSidedDerivatives(scene), ahead);
}

// Two discs meet without friction, on a line that is theirs but for rounding: any friction makes them stick.
TEST(EventFriction, DerivativeAtZeroHeadOn) {
  for (double angle : {0.0, 0.3, 1.1, 2.0}) {
    Scene scene;
    scene.steps = 30;
    const Vec2d along(std::cos(angle), std::sin(angle));
    scene.bodies = {{.name = "a", .radius = 0.1, .position = -0.4 * along, .velocity = 1.3 * along},
                    {.name = "b", .radius = 0.1, .mass = 2, .position = 0.3 * along, .velocity = -0.7 * along}};
    scene.contact.restitution = 0.9;
    EventRun run(scene);
    for (int entry = 0; entry < 8; ++entry) EXPECT_EQ(run.GradientOf(entry).parameters.friction, 0) << angle;
    // Off that line it slips.
    scene.bodies[0].position += 0.05 * Perpendicular(along);
    const double derivative = EventRun(scene).GradientOf(1).parameters.friction;
    const auto height = [&](double mu) {
      scene.contact.friction = mu;
      return EventRun(scene).End()[1];
    };
    EXPECT_NE(derivative, 0);
    EXPECT_NEAR(derivative, Slope(height, 1, 1e-2), 1e-8);
  }
}

}  // namespace
}  // namespace saltus
