// Discs that spin under the event-driven model: against values computed elsewhere (data/spin_references.json, 50
// digits), closed forms, differences, and what no motion of discs may break.
#include <gtest/gtest.h>

#include <cmath>
#include <map>
#include <nlohmann/json.hpp>
#include <random>

#include "contact/event/event_run.h"
#include "exact/exact_scenes.h"
#include "parameter_name.h"
#include "reference_values.h"
#include "saltus/simulate/one_sided_derivatives.h"

namespace saltus {
namespace {

using nlohmann::json;
using testing::EventRun;

constexpr double kTolerance = 1e-10;

const json& References() { return ReferenceFile("spin_references.json"); }

void ExpectNear(double found, double expected, double tolerance, const std::string& what) {
  EXPECT_NEAR(found, expected, tolerance * std::max(1.0, std::abs(expected))) << what;
}

Body Spinning(const char* name, double radius, double mass, const Vec2d& position, const Vec2d& velocity, double spin) {
  Body body = exact_test::Disc(name, radius, position, velocity);
  body.mass = mass;
  body.inertia.kind = Inertia::Kind::kSolid;
  body.angular_velocity = spin;
  return body;
}

Scene SpinBall() {
  Scene scene;
  scene.duration = 1.4;
  scene.gravity = {0, -9.81};
  scene.bodies = {Spinning("ball", 0.1, 1, {0, 1}, {2, -1}, -60)};
  scene.planes = {{"ground", {0, 0}, {0, 1}}};
  scene.contact = {.restitution = 0.8, .friction = 0.15};
  return scene;
}

Scene SpinPair() {
  Scene scene;
  scene.duration = 1.2;
  scene.bodies = {Spinning("a", 0.1, 1, {0, 0}, {3, 0.5}, 20), Spinning("b", 0.15, 2, {1, 0.25}, {-0.5, 0}, -10)};
  scene.planes = {{"wall", {0, 1}, {0, -1}}};
  scene.contact = {.restitution = 0.9, .friction = 0.2};
  return scene;
}

// A solid disc on the ground.
Scene OnGround(const Vec2d& velocity, double spin, double friction) {
  Scene scene;
  scene.duration = 2;
  scene.gravity = {0, -9.81};
  scene.bodies = {Spinning("disc", 0.1, 1, {0, 0.1}, velocity, spin)};
  scene.planes = {{"ground", {0, 0}, {0, 1}}};
  scene.contact = {.restitution = 0.5, .friction = friction};
  return scene;
}

constexpr const char* kEntries[] = {"px", "py", "vx", "vy", "theta", "w"};

// Where a quantity is in the initial state.
std::size_t PlaceOf(int body, int entry, int num_bodies) {
  return entry < 4 ? 4 * body + entry : 4 * num_bodies + kSpin * body + entry - 4;
}

// The derivatives of entry `row` of the final state, by the names that the references have.
std::map<std::string, double> DerivativesOf(EventRun* run, int row) {
  const Scene& scene = run->simulator.scene();
  const Sensitivity gradient = run->GradientOf(row);
  std::map<std::string, double> by{{"e", gradient.parameters.restitution}, {"mu", gradient.parameters.friction}};
  for (int i = 0; i < scene.num_bodies(); ++i) {
    for (int j = 0; j < 6; ++j) {
      by[scene.bodies[i].name + "." + kEntries[j]] = gradient.initial[PlaceOf(i, j, scene.num_bodies())];
    }
    by["k2." + scene.bodies[i].name] = gradient.parameters.inertia[i] * scene.bodies[i].mass;
  }
  return by;
}

void ExpectImpacts(const std::vector<std::pair<double, Touch>>& found, const json& expected) {
  ASSERT_EQ(found.size(), expected.size());
  for (std::size_t i = 0; i < found.size(); ++i) {
    EXPECT_NEAR(found[i].first, Number(expected[i]["time"]), 1e-13);
    EXPECT_EQ(ContactModeToString(found[i].second.mode), expected[i]["mode"]);
    EXPECT_EQ(found[i].second.kind, ContactKind::kImpact);
  }
}

class EventSpin : public ::testing::TestWithParam<int> {
 protected:
  // Impacts, final state and flow Jacobian of a scene.
  static void ExpectReference(Scene scene, const json& expected) {
    scene.steps = GetParam();
    EventRun run(scene);
    std::vector<std::pair<double, Touch>> impacts;
    for (const StepTouch& at : run.simulator.touches()) impacts.emplace_back(run.TimeOf(at), at.touch);
    ExpectImpacts(impacts, expected["impacts"]);
    const std::vector<double> end = run.End();
    for (int i = 0; i < scene.num_bodies(); ++i) {
      for (int j = 0; j < 6; ++j) {
        const std::string name = scene.bodies[i].name + "." + kEntries[j];
        ExpectNear(end[6 * i + j], Number(expected["final"][scene.bodies[i].name][j]), kTolerance, name);
        const std::map<std::string, double> by = DerivativesOf(&run, 6 * i + j);
        for (const auto& [what, value] : expected["jacobian"][name].items()) {
          ExpectNear(by.at(what), Number(value), kTolerance, "d " + name + " / d " + what);
        }
      }
    }
  }
};
INSTANTIATE_TEST_SUITE_P(Steps, EventSpin, ::testing::Values(1, 7, 240), ParameterName());

TEST_P(EventSpin, BallThatSlipsThenSticks) { ExpectReference(SpinBall(), References()["s1"]); }

TEST_P(EventSpin, TwoDiscsThenAWall) { ExpectReference(SpinPair(), References()["s2"]); }

TEST_P(EventSpin, SlidesThenRolls) {
  const json& expected = References()["s3"];
  Scene scene = OnGround({3, 0}, 0, 0.2);
  scene.steps = GetParam();
  EventRun run(scene);
  const std::vector<double> end = run.End();
  ExpectNear(end[0], Number(expected["x"]), kTolerance, "x");
  ExpectNear(end[2], Number(expected["speed"]), kTolerance, "v");
  ExpectNear(end[4], Number(expected["theta"]), kTolerance, "theta");
  ExpectNear(end[5], Number(expected["w"]), kTolerance, "w");
  std::map<std::string, double> by = DerivativesOf(&run, 0);
  ExpectNear(by["disc.vx"], Number(expected["by"]["v"]), kTolerance, "by v");
  ExpectNear(by["disc.w"], Number(expected["by"]["w"]), kTolerance, "by w");
  ExpectNear(by["mu"], Number(expected["by"]["mu"]), kTolerance, "by mu");
  ExpectNear(by["k2.disc"], Number(expected["by"]["k2"]), kTolerance, "by k2");
  // It ceases to slide within a step, which then has both.
  const double rolls_from = Number(expected["rolls_from"]);
  bool found = false;
  for (const StepTouch& at : run.simulator.touches()) {
    found = found || (at.touch.mode == ContactMode::kStick && std::abs(run.TimeOf(at) - rolls_from) < 1e-12);
  }
  EXPECT_TRUE(found);
}

TEST(EventSpinOnGround, CeasesToRollAndRollsAgain) {
  const json& expected = References()["s3b"];
  for (const int parts : {1, 4}) {
    Scene scene = OnGround({0, 0}, 0, 0.2);
    scene.duration = 3;
    scene.steps = 3 * parts;
    scene.control = {{0}, {{0, 0}}};
    EventRun run(scene);
    for (int k = 0; k < 2 * parts; ++k) run.control[2 * k] = k < parts ? 3 : 9;
    ASSERT_TRUE(run.simulator.Rollout(InitialState(scene), run.control)) << run.simulator.FailureReason();
    const std::vector<double> end = run.End();
    ExpectNear(end[0], Number(expected["x"]), kTolerance, "x");
    ExpectNear(end[2], Number(expected["v"]), kTolerance, "v");
    ExpectNear(end[4], Number(expected["theta"]), kTolerance, "theta");
    ExpectNear(end[5], Number(expected["w"]), kTolerance, "w");
    const Sensitivity gradient = run.GradientOf(0);
    double by_force[2] = {};
    for (int k = 0; k < 2 * parts; ++k) by_force[k / parts] += gradient.control[2 * k];
    ExpectNear(by_force[0], Number(expected["by"]["force1"]), kTolerance, "by the first force");
    ExpectNear(by_force[1], Number(expected["by"]["force2"]), kTolerance, "by the second force");
    ExpectNear(gradient.parameters.friction, Number(expected["by"]["mu"]), kTolerance, "by mu");
  }
}

// With accelerations, torques among them, at the impacts: one step.
TEST(EventSpinStep, ForcesAndTorquesAtImpacts) {
  const json& expected = References()["s2f"];
  Scene scene = SpinPair();
  scene.contact.friction = 0.05;
  scene.gravity = {0.3, -0.4};
  scene.bodies[1].inertia = {Inertia::Kind::kGiven, 2 * 0.009};
  scene.steps = 1;
  scene.control = {.bodies = {0, 1}, .initial = {{0, 0}, {0, 0}}, .torque_bodies = {0, 1}};
  const std::vector<double> torque{0.02, -0.03};
  const std::vector<double> force{
      1.5, -0.7, -0.6, 0.9, torque[0] / scene.bodies[0].radius, torque[1] / scene.bodies[1].radius};
  std::vector<double> x, next(12);
  for (const Body& body : scene.bodies) {
    x.insert(x.end(), {body.position[0], body.position[1], body.velocity[0], body.velocity[1]});
    x.insert(x.end(), {body.angle, body.angular_velocity});
  }
  const std::unique_ptr<Simulator> simulator = testing::MakeEventSimulator(scene);
  std::vector<Touch> touches;
  simulator->Step(x, force, next, &touches);
  std::vector<std::pair<double, Touch>> impacts;
  for (const Touch& touch : touches) impacts.emplace_back(touch.time, touch);
  ExpectImpacts(impacts, expected["impacts"]);
  StepLinearization linearization;
  simulator->Linearize(x, force, /*with_parameters=*/true, &linearization);
  ASSERT_EQ(linearization.islands.size(), 1u);
  const StepLinearization::Island& island = linearization.islands[0];
  for (int i = 0; i < 2; ++i) {
    const double* end = &next[6 * i];
    for (int j = 0; j < 6; ++j) {
      const std::string name = scene.bodies[i].name + "." + kEntries[j];
      ExpectNear(end[j], Number(expected["final"][scene.bodies[i].name][j]), kTolerance, name);
      if (!expected["jacobian"].contains(name)) continue;
      const json& by = expected["jacobian"][name];
      const auto row = island.A.row(6 * i + j), parameters = island.P.row(6 * i + j);
      for (int k = 0; k < 12; ++k) {
        const std::string what = scene.bodies[k / 6].name + "." + kEntries[k % 6];
        ExpectNear(row[k], Number(by[what]), kTolerance, "d " + name + " / d " + what);
      }
      ExpectNear(parameters[0], Number(by["e"]), kTolerance, "d " + name + " / d e");
      ExpectNear(parameters[1], Number(by["mu"]), kTolerance, "d " + name + " / d mu");
      for (int k = 0; k < 2; ++k) {
        const double inverse = 1 / scene.bodies[k].MomentOfInertia(), gyration2 = 1 / (inverse * scene.bodies[k].mass);
        const double by_gyration2 = -parameters[6 + k] * inverse / gyration2;
        ExpectNear(by_gyration2, Number(by["k2." + scene.bodies[k].name]), kTolerance, "d " + name + " / d k2");
      }
    }
  }
}

// The whole flow by central differences of the initial state, of entries for which `smooth` holds.
template <typename Smooth>
void ExpectDifferences(const Scene& scene, double width, double tolerance, const Smooth& smooth) {
  EventRun run(scene);
  const std::vector<double> start = InitialState(scene);
  for (std::size_t c = 0; c < start.size(); ++c) {
    if (!smooth(c)) continue;
    std::vector<double> end[2];
    for (int side : {0, 1}) {
      std::vector<double> moved = start;
      moved[c] += side == 0 ? -width : width;
      ASSERT_TRUE(run.simulator.Rollout(moved, run.control));
      end[side] = run.End();
    }
    ASSERT_TRUE(run.simulator.Rollout(start, run.control));
    for (int row = 0; row < static_cast<int>(end[0].size()); ++row) {
      const double difference = (end[1][row] - end[0][row]) / (2 * width);
      ExpectNear(
          run.GradientOf(row).initial[c], difference, tolerance, std::to_string(row) + " by " + std::to_string(c));
    }
  }
}

TEST(EventSpinDifferences, Impacts) {
  for (Scene scene : {SpinBall(), SpinPair()}) {
    scene.steps = 11;
    ExpectDifferences(scene, 1e-6, 1e-8, [](std::size_t) { return true; });
  }
}

TEST(EventSpinDifferences, SlidingAndRollingDownASlope) {
  for (const double friction : {0.05, 0.6}) {  // slides, rolls
    Scene scene = OnGround({1, -0.5}, 3, friction);
    scene.gravity = {3, -9};
    scene.steps = 13;
    scene.bodies[0].velocity = {1, 0};
    // Along the slope: changes across it make it bounce.
    ExpectDifferences(scene, 1e-6, 1e-8, [](std::size_t c) { return c != 1 && c != 3; });
  }
}

// It bounces until it rolls.
TEST(EventSpinDifferences, ComesToRollAfterBounces) {
  Scene scene = OnGround({2, -1}, 40, 0.3);
  scene.bodies[0].position[1] = 0.4;
  scene.contact.restitution = 0.3;
  scene.duration = 3;
  scene.steps = 30;
  EventRun run(scene);
  const std::vector<double> end = run.End();
  EXPECT_NEAR(end[2] + 0.1 * end[5], 0, 1e-12);
  ExpectDifferences(scene, 1e-6, 1e-6, [](std::size_t) { return true; });
}

// Height and velocity across the contact: what a small drop leads to, however often it bounces.
TEST(EventSpinDifferences, DropsOntoTheContactOnWhichItRolls) {
  for (const double friction : {0.05, 0.6}) {
    Scene scene = OnGround({1, 0}, friction < 0.1 ? 3 : -10, friction);
    scene.gravity = {3, -9};
    scene.duration = 1;
    EventRun run(scene);
    const std::vector<double> start = InitialState(scene);
    const std::vector<double> end = run.End();
    for (const int c : {1, 3}) {
      const double width = c == 1 ? 1e-6 : 1e-3;  // enough to bounce
      std::vector<double> moved = start;
      moved[c] += width;
      ASSERT_TRUE(run.simulator.Rollout(moved, run.control));
      const std::vector<double> there = run.End();
      ASSERT_TRUE(run.simulator.Rollout(start, run.control));
      for (const int row : {0, 2, 4, 5}) {
        ExpectNear(run.GradientOf(row).initial[c], (there[row] - end[row]) / width, 2e-3, std::to_string(row));
      }
    }
  }
}

// On a slope, about to slip: an impact stops the sliding of its rim unless that is fast enough, of which only a third
// of the disc's mass is a part. Velocities down the slope alone have the derivative of slipping.
TEST(EventSpinDifferences, AboutToSlip) {
  Scene scene = OnGround({0, 0}, 0, 0.1);
  const double angle = std::atan(0.32);
  const Vec2d normal(std::sin(angle), std::cos(angle));
  scene.planes[0].normal = normal;
  scene.bodies[0].position = 0.1 * normal;
  scene.contact.restitution = 0.8;
  scene.duration = 1;
  using Quantity = OneSided::Quantity;
  using Side = OneSided::Side;
  EXPECT_EQ(OneSidedDerivatives(scene),
            (std::vector<OneSided>{{0, Quantity::kPosition, 0, Side::kNone},
                                   {0, Quantity::kPosition, 1, Side::kNone},
                                   {0, Quantity::kVelocity, 0, Side::kAbove},
                                   {0, Quantity::kVelocity, 1, Side::kNone}}));
  EventRun run(scene);
  const std::vector<double> start = InitialState(scene), end = run.End();
  const auto slope = [&](int c, double by) {
    std::vector<double> moved = start;
    moved[c] += by;
    EXPECT_TRUE(run.simulator.Rollout(moved, run.control));
    const double there = run.End()[0];
    EXPECT_TRUE(run.simulator.Rollout(start, run.control));
    return (there - end[0]) / by;
  };
  const double by_x = run.GradientOf(0).initial[2], by_y = run.GradientOf(0).initial[3];
  EXPECT_NEAR(slope(2, 1e-3), by_x, 1e-3);
  EXPECT_GT(std::abs(slope(2, -1e-3) - by_x), 1e-2);
  for (const double by : {1e-3, -1e-3}) EXPECT_GT(std::abs(slope(3, by) - by_y), 1e-2) << by;
}

TEST(EventSpinConformance, SpinsOnNothing) {
  Scene scene = SpinPair();
  scene.planes.clear();
  scene.bodies[1].position = {1, 5};
  scene.bodies[0].angle = 0.25;
  scene.steps = 10;
  EventRun run(scene);
  const std::vector<double> end = run.End();
  EXPECT_EQ(end[5], 20);
  EXPECT_NEAR(end[4], 0.25 + 1.2 * 20, 1e-13);
  EXPECT_EQ(end[11], -10);
  EXPECT_TRUE(run.simulator.touches().empty());
}

TEST(EventSpinConformance, RollingWithoutSlipStays) {
  Scene scene = OnGround({1, 0}, -10, 0.6);
  scene.gravity = {3, -9};
  scene.steps = 50;
  EventRun run(scene);
  for (int k = 0; k <= scene.steps; ++k) {
    const std::vector<double> x = run.State(k);
    EXPECT_NEAR(x[2] + 0.1 * x[5], 0, 1e-12);
    EXPECT_NEAR(x[2], 1 + 2 * scene.dt() * k, 1e-12);  // two thirds of the acceleration
    EXPECT_NEAR(x[1], 0.1, 1e-13);
  }
}

TEST(EventSpinConformance, MirroredSceneMirrored) {
  Scene scene = SpinPair();
  Scene mirrored = scene;
  for (Body& body : mirrored.bodies) {
    body.position[0] *= -1;
    body.velocity[0] *= -1;
    body.angular_velocity *= -1;
  }
  const std::vector<double> end = EventRun(scene).End(), other = EventRun(mirrored).End();
  for (int i = 0; i < 12; ++i) {
    const int j = i % 6;
    const bool turns = j == 0 || j == 2 || j > 3;
    EXPECT_EQ(other[i], turns ? -end[i] : end[i]) << i;
  }
}

// Without friction nothing touches the spin, and the spin nothing else: to the last bit.
TEST(EventSpinConformance, WithoutFrictionSpinIsByItself) {
  Scene scene = SpinPair();
  scene.contact.friction = 0;
  scene.steps = 20;
  Scene plain = scene;
  for (Body& body : plain.bodies) {
    body.inertia = {};
    body.angular_velocity = 0;
  }
  const std::vector<double> end = EventRun(scene).End(), expected = EventRun(plain).End();
  for (int i = 0; i < 2; ++i) {
    for (int j = 0; j < 4; ++j) EXPECT_EQ(end[6 * i + j], expected[4 * i + j]);
    EXPECT_EQ(end[6 * i + 5], scene.bodies[i].angular_velocity);
  }
}

// A disc that cannot spin among those that do is as in a scene of its own kind.
TEST(EventSpinConformance, DiscsThatCannotSpinStayAsTheyWere) {
  Scene scene = OnGround({3, 0}, 0, 0.2);
  scene.bodies[0].inertia = {};
  const Scene plain = scene;
  scene.bodies.push_back(Spinning("far", 0.1, 1, {50, 7}, {0, 0}, 5));
  const std::vector<double> end = EventRun(scene).End(), expected = EventRun(plain).End();
  for (int j = 0; j < 4; ++j) EXPECT_EQ(end[j], expected[j]);
  EXPECT_EQ(end[4], 0);
  EXPECT_EQ(end[5], 0);
}

TEST(EventSpinConformance, AGivenInertiaOfASolidDiscIsASolidDisc) {
  Scene scene = SpinPair(), given = scene;
  for (Body& body : given.bodies) body.inertia = {Inertia::Kind::kGiven, body.MomentOfInertia()};
  EXPECT_EQ(EventRun(scene).End(), EventRun(given).End());
}

TEST(EventSpinConformance, MemoryDoesNotChangeABit) {
  Scene scene = SpinPair();
  scene.steps = 400;
  scene.control = {{0}, {{0.3, -0.2}}};
  EventRun run(scene), tight(scene);
  tight.simulator.set_memory_limit(tight.simulator.LeastMemory());
  ASSERT_TRUE(tight.simulator.Rollout(InitialState(scene), tight.control));
  for (int row = 0; row < 12; ++row) {
    const Sensitivity expected = run.GradientOf(row), found = tight.GradientOf(row);
    EXPECT_EQ(found.initial, expected.initial);
    EXPECT_EQ(found.control, expected.control);
    EXPECT_EQ(found.parameters.inertia, expected.parameters.inertia);
  }
}

struct Totals {
  double energy = 0, angular = 0;
  Vec2d momentum{0, 0};
};
Totals TotalsOf(const Scene& scene, const std::vector<double>& x) {
  Totals totals;
  for (int i = 0; i < scene.num_bodies(); ++i) {
    const double m = scene.bodies[i].mass, inertia = scene.bodies[i].MomentOfInertia(), w = x[6 * i + 5];
    const Vec2d p(x[6 * i], x[6 * i + 1]), v(x[6 * i + 2], x[6 * i + 3]);
    totals.energy += 0.5 * (m * v.squaredNorm() + inertia * w * w);
    totals.angular += m * (p[0] * v[1] - p[1] * v[0]) + inertia * w;
    totals.momentum += m * v;
  }
  return totals;
}

// A row of rollers that touch: more conditions than kMostDenseRows, across which torques act too.
TEST(EventSpinDifferences, ALongRowOfRollersIsPushed) {
  for (const int rollers : {3, 6, 9}) {
    Scene scene;
    scene.duration = 0.1;
    scene.steps = 10;
    scene.gravity = {0, -9.8};
    scene.contact = {.restitution = 0.5, .friction = 0.5};
    scene.planes = {{"ground", {0, 0}, {0, 1}}};
    for (int i = 0; i < rollers; ++i) {
      scene.bodies.push_back(
          Spinning(("d" + std::to_string(i)).c_str(), 0.1, 1 + 0.1 * (i % 3), {0.2 * i, 0.1}, {0, 0}, 0));
    }
    const auto end = [&](double push) {
      scene.control = {{0}, {Vec2d(push, 0)}};
      return EventRun(scene).End();
    };
    const double push = 4, by = 1e-4;
    const std::vector<double> above = end(push + by), below = end(push - by), at = end(push);
    EventRun pushed(scene);
    for (int entry = 0; entry < static_cast<int>(at.size()); ++entry) {
      const Sensitivity gradient = pushed.GradientOf(entry);
      double derivative = 0;
      for (std::size_t k = 0; k < gradient.control.size(); k += 2) derivative += gradient.control[k];
      EXPECT_NEAR(derivative, (above[entry] - below[entry]) / (2 * by), 1e-6) << rollers << " " << entry;
    }
  }
}

// Impacts of many discs with each other keep momentum and angular momentum, and energy does not grow.
TEST(EventSpinConformance, CrowdKeepsMomentumAndAngularMomentum) {
  std::mt19937 random(7);
  std::uniform_real_distribution<double> uniform(-1, 1);
  for (const double restitution : {1.0, 0.6}) {
    Scene scene;
    scene.duration = 2;
    scene.steps = 40;
    scene.contact = {.restitution = restitution, .friction = 0.4};
    for (int i = 0; i < 9; ++i) {
      const Vec2d place(i % 3 - 1, i / 3 - 1), velocity(uniform(random), uniform(random));
      scene.bodies.push_back(Spinning(("d" + std::to_string(i)).c_str(),
                                      0.2,
                                      1 + 0.5 * uniform(random),
                                      place,
                                      velocity - 1.5 * place,
                                      20 * uniform(random)));
    }
    EventRun run(scene);
    EXPECT_GT(run.simulator.touches().size(), 5u);
    const Totals first = TotalsOf(scene, run.State(0));
    double energy = first.energy;
    for (int k = 1; k <= scene.steps; ++k) {
      const Totals now = TotalsOf(scene, run.State(k));
      EXPECT_NEAR((now.momentum - first.momentum).norm(), 0, 1e-12);
      EXPECT_NEAR(now.angular, first.angular, 1e-11);
      EXPECT_LE(now.energy, energy + 1e-12);
      energy = now.energy;
    }
    EXPECT_LT(energy, first.energy);  // friction
  }
}

// A disc in a corner that only spins rubs against both walls until it does no more.
TEST(EventSpinCorner, RubsAgainstBothWalls) {
  Scene scene = OnGround({0, 0}, 30, 0.1);
  scene.gravity = {-4, -9};
  scene.planes.push_back({"wall", {-0.1, 0}, {1, 0}});
  scene.duration = 0.5;
  scene.steps = 5;
  EventRun run(scene);
  const std::vector<double> end = run.End();
  EXPECT_NEAR(end[0], 0, 1e-12);
  EXPECT_NEAR(end[1], 0.1, 1e-12);
  // Counter-clockwise the ground pushes it by mu N onto the wall, and the wall by mu M off the ground:
  // N = 9 - mu M, M = 4 + mu N.
  const double mu = 0.1, ground = (9 - mu * 4) / (1 + mu * mu), wall = 4 + mu * ground;
  EXPECT_NEAR(end[5], 30 - 0.5 * mu * (ground + wall) * 0.1 / (0.5 * 0.01), 1e-10);
}

// The end of a segment is met as a fixed point: the contact's velocity after a stick is zero.
TEST(EventSpinEdges, EndOfASegment) {
  Scene scene;
  scene.duration = 0.5;
  scene.bodies = {Spinning("ball", 0.1, 1, {0, 0.03}, {2, 0}, -4)};
  scene.segments = {{"post", {0.5, 0}, {0.5, -1}}};
  scene.contact = {.restitution = 0.7, .friction = 5};
  EventRun run(scene);
  ASSERT_EQ(run.simulator.touches().size(), 1u);
  EXPECT_EQ(run.simulator.touches()[0].touch.mode, ContactMode::kStick);
  const double hit = run.TimeOf(run.simulator.touches()[0]);
  const Vec2d normal = (Vec2d(2 * hit, 0.03) - Vec2d(0.5, 0)) / 0.1;
  const std::vector<double> end = run.End();
  const Vec2d v(end[2], end[3]);
  EXPECT_NEAR(Dot(normal, v), -0.7 * 2 * normal[0], 1e-12);
  EXPECT_NEAR(Dot(Perpendicular(normal), v) - 0.1 * end[5], 0, 1e-12);
  // Nothing turns it about the point.
  const Vec2d arm = 0.1 * normal;
  const double before = arm[0] * 0 - arm[1] * 2 + 0.005 * -4, after = arm[0] * v[1] - arm[1] * v[0] + 0.005 * end[5];
  EXPECT_NEAR(after, before, 1e-12);
  ExpectDifferences(scene, 1e-6, 1e-8, [](std::size_t) { return true; });
}

TEST(EventSpinRefused, Tables) {
  Scene scene = SpinPair();
  scene.table = TableFriction{0.1, 9.81};
  EXPECT_NE(Contact("event").entry()->reason_not_applicable(scene).find("spin"), std::string::npos);
}

}  // namespace
}  // namespace saltus
