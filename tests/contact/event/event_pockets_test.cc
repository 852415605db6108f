// Pockets under the event-driven model: when and where discs fall in, against closed forms and bisection, and its
// derivatives against (1 - v n^T / (n.v)) and differences.
#include <gtest/gtest.h>

#include <cmath>

#include "contact/event/event_run.h"
#include "saltus/control/contact_sequence.h"
#include "saltus/simulate/events.h"
#include "saltus/simulate/registry.h"

namespace saltus {
namespace {

using testing::EventRun;
using testing::StartOf;

const Pocket kPocket{"corner", {1, 0.5}, 0.2};

Scene WithPocket(int steps) {
  Scene scene;
  scene.name = "pockets";
  scene.duration = 1;
  scene.steps = steps;
  scene.bodies = {{.name = "ball", .radius = 0.1, .position = {-0.5, 0.1}, .velocity = {2.5, 0.9}}};
  scene.pockets = {kPocket};
  scene.contact = {.restitution = 0.9, .friction = 0};
  return scene;
}

// The first time at which a disc under a constant acceleration is in the pocket, by small steps and bisection.
double EntryByBisection(const Vec2d& p, const Vec2d& v, const Vec2d& a, double duration) {
  const auto outside = [&](double t) {
    const Vec2d at = p + t * v + (0.5 * t * t) * a;
    return std::hypot(at[0] - kPocket.position[0], at[1] - kPocket.position[1]) - kPocket.radius;
  };
  double low = 0, step = duration / 10000;
  while (outside(low + step) > 0 && low < duration) low += step;
  EXPECT_LT(low, duration) << "it misses the pocket";
  double high = low + step;
  for (int k = 0; k < 100; ++k) (outside(0.5 * (low + high)) > 0 ? low : high) = 0.5 * (low + high);
  return high;
}

Vec2d PositionOf(const std::vector<double>& x, int body, int size = 4) { return {x[body * size], x[body * size + 1]}; }

// Entry `row` of the final state by entry `column` of the initial one.
template <typename Run>
double Difference(const Scene& scene, int row, int column, double width = 1e-6) {
  double ends[2];
  for (const int side : {0, 1}) {
    Run run(scene);
    std::vector<double> start = StartOf(scene);
    start[column] += side == 0 ? -width : width;
    EXPECT_TRUE(run.simulator.Rollout(start, run.control));
    ends[side] = run.End()[row];
  }
  return (ends[1] - ends[0]) / (2 * width);
}

TEST(EventPockets, ADiscFallsInAtTheRootAndRestsThere) {
  for (const double gravity : {0.0, -1.5}) {
    for (const int steps : {1, 7, 480}) {
      Scene scene = WithPocket(steps);
      scene.gravity = {0.2 * gravity, gravity};
      const Vec2d p = scene.bodies[0].position, v = scene.bodies[0].velocity;
      const double time = EntryByBisection(p, v, scene.gravity, 1);
      const Vec2d at = p + time * v + (0.5 * time * time) * scene.gravity;
      EventRun run(scene);
      const std::vector<double> end = run.End();
      EXPECT_NEAR(end[0], at[0], 1e-13);
      EXPECT_NEAR(end[1], at[1], 1e-13);
      EXPECT_EQ(end[2], 0);
      EXPECT_EQ(end[3], 0);
      const std::vector<Event> events = EventsOf(run.simulator);
      ASSERT_EQ(events.size(), 1u);
      EXPECT_NEAR(events[0].time, time, 1e-13);
      EXPECT_EQ(events[0].a, "ball");
      EXPECT_EQ(events[0].b, "corner");
      EXPECT_STREQ(ContactModeToString(events[0].mode), "pocketed");
      for (int k = static_cast<int>(time * steps) + 1; k <= steps; ++k) EXPECT_EQ(run.State(k), end) << "state " << k;
    }
  }
}

TEST(EventPockets, ThePlaceOfEntryVariesAlongTheRim) {
  for (const int steps : {1, 30}) {
    Scene scene = WithPocket(steps);
    scene.gravity = {-0.3, -1.5};
    const Vec2d p = scene.bodies[0].position;
    const double time = EntryByBisection(p, scene.bodies[0].velocity, scene.gravity, 1);
    const Vec2d v = scene.bodies[0].velocity + time * scene.gravity;
    EventRun run(scene);
    const Vec2d n = (PositionOf(run.End(), 0) - kPocket.position) / kPocket.radius;
    for (int row = 0; row < 4; ++row) {
      const Sensitivity found = run.GradientOf(row);
      for (int column = 0; column < 4; ++column) {
        const int i = row % 2, j = column % 2;
        const double by_position = (i == j) - v[i] * n[j] / Dot(n, v);
        const double expected = row >= 2 ? 0 : column < 2 ? by_position : time * by_position;
        EXPECT_NEAR(found.initial[column], expected, 1e-12 * (1 + std::abs(expected))) << row << " by " << column;
      }
      const double by_gravity = row >= 2 ? 0 : 0.5 * time * time * ((row == 0) - v[row] * n[0] / Dot(n, v));
      EXPECT_NEAR(found.parameters.gravity[0], by_gravity, 1e-12);
    }
  }
}

// A striker sends a ball into the pocket, off a wall.
Scene Pot(int steps) {
  Scene scene = WithPocket(steps);
  scene.bodies = {{.name = "striker", .radius = 0.1, .position = {-0.6, -0.02}, .velocity = {2.5, 0.1}},
                  {.name = "ball", .radius = 0.12, .mass = 0.7, .position = {0, 0}}};
  scene.planes = {{"wall", {0, -0.2}, {0.1, 1}}};
  scene.contact.friction = 0.1;
  scene.control = {{0}, {{1.0, 0.3}}};
  scene.objective = {{{.body = 1, .target = {1, 0.5}, .weight = 2}, {.body = 0, .target = {0.4, 0}}}, 0.01};
  scene.pockets[0] = {"corner", {1.2, 0.2}, 0.2};
  scene.duration = 1.1;
  return scene;
}

TEST(EventPockets, APotByAnImpactHasTheGradientOfDifferences) {
  for (const int steps : {1, 12}) {
    const Scene scene = Pot(steps);
    EventRun run(scene);
    const std::vector<Event> events = EventsOf(run.simulator);
    ASSERT_GE(events.size(), 2u);
    EXPECT_EQ(events.back().b, "corner");
    EXPECT_EQ(events.back().a, "ball");
    for (int row = 0; row < 8; ++row) {
      const Sensitivity found = run.GradientOf(row);
      for (int column = 0; column < 8; ++column) {
        const double expected = Difference<EventRun>(scene, row, column);
        EXPECT_NEAR(found.initial[column], expected, 1e-7 * (1 + std::abs(expected))) << row << " by " << column;
      }
    }
    const Sensitivity gradient = run.Gradient();
    const auto loss = [&](auto&& change) {
      Scene changed = scene;
      change(&changed);
      return EventRun(changed).Loss();
    };
    const double w = 1e-6;
    double by_force = 0;
    for (std::size_t k = 0; k < gradient.control.size(); k += 2) by_force += gradient.control[k];
    const auto push = [&](double by) { return loss([&](Scene* s) { s->control.initial[0][0] += by; }); };
    EXPECT_NEAR(by_force, (push(w) - push(-w)) / (2 * w), 1e-7);
    const auto bounce = [&](double by) { return loss([&](Scene* s) { s->contact.restitution += by; }); };
    EXPECT_NEAR(gradient.parameters.restitution, (bounce(w) - bounce(-w)) / (2 * w), 1e-7);
  }
}

TEST(EventPockets, WhatLiesInAPocketIsInNoOnesWay) {
  // The second follows the first and goes through where it lies; the third passes over the rim's disc from the side.
  Scene scene = WithPocket(40);
  scene.bodies.push_back({.name = "second", .radius = 0.15, .position = {-1.0, 0}, .velocity = {2.5, 0.5}});
  scene.bodies.push_back({.name = "third", .radius = 0.3, .position = {0.45, -2}, .velocity = {0, 2.5}});
  EventRun run(scene);
  const std::vector<double> end = run.End();
  int pocketed = 0;
  for (const Event& event : EventsOf(run.simulator)) {
    EXPECT_EQ(event.b, "corner");
    EXPECT_EQ(event.mode, ContactMode::kPocketed);
    ++pocketed;
  }
  EXPECT_EQ(pocketed, 2);  // both are in, and overlap there
  EXPECT_LT((PositionOf(end, 0) - PositionOf(end, 1)).norm(), 0.25);
  for (int i = 0; i < 3; ++i) {
    Scene alone = scene;
    alone.bodies = {scene.bodies[i]};
    const std::vector<double> expected = EventRun(alone).End();
    for (int j = 0; j < 4; ++j) EXPECT_EQ(end[4 * i + j], expected[j]) << "disc " << i;
  }
}

TEST(EventPockets, ADiscThatPassesBesideStaysInPlay) {
  for (const double beside : {1e-9, -1e-9}) {
    Scene scene = WithPocket(5);
    scene.bodies[0].position = {-0.5, kPocket.position[1] - kPocket.radius - beside};
    scene.bodies[0].velocity = {2.5, 0};
    EventRun run(scene);
    EXPECT_EQ(EventsOf(run.simulator).size(), beside > 0 ? 0u : 1u);
    EXPECT_EQ(run.End()[2], beside > 0 ? 2.5 : 0);
  }
}

TEST(EventPockets, ADiscThatRollsInIsLetGoAndItsAngleStays) {
  Scene scene = WithPocket(20);
  scene.gravity = {0, -9.81};
  scene.contact = {.restitution = 0.5, .friction = 0.4};
  scene.planes = {{"ground", {0, 0}, {0, 1}}};
  Body& ball = scene.bodies[0];
  ball = {.name = "ball", .radius = 0.1, .position = {-0.5, 0.1}, .velocity = {2, 0}};
  ball.inertia.kind = Inertia::Kind::kSolid;
  ball.angular_velocity = -20;
  scene.pockets = {{"hole", {0.6, 0.1}, 0.1}};
  EventRun run(scene);
  const std::vector<double> end = run.End();
  const double time = 1.0 / 2;  // it rolls all the way
  EXPECT_NEAR(end[0], 0.5, 1e-12);
  EXPECT_NEAR(end[4], -20 * time, 1e-10);
  for (const int j : {2, 3, 5}) EXPECT_EQ(end[j], 0);
  EXPECT_EQ(EventsOf(run.simulator).back().b, "hole");
  // Its angle follows the way: d theta = d theta0 + t dw - (w / v_x) (dx + t dv_x), with dv_x, dw those of rolling.
  const Sensitivity angle = run.GradientOf(4);
  EXPECT_NEAR(angle.initial[0], 10, 1e-9);
  EXPECT_NEAR(angle.initial[4], 1, 1e-12);
  EXPECT_NEAR(run.GradientOf(0).initial[0], 0, 1e-12);
}

TEST(EventPockets, OnATableToo) {
  Scene scene = WithPocket(3);
  scene.table = TableFriction{.friction = 0.2, .gravity = 9.81};
  const Body& ball = scene.bodies[0];
  const Vec2d slowing = -0.2 * 9.81 * ball.velocity.normalized();
  const double time = EntryByBisection(ball.position, ball.velocity, slowing, 1);
  EventRun run(scene);
  const std::vector<double> end = run.End();
  const Vec2d at = ball.position + time * ball.velocity + (0.5 * time * time) * slowing;
  EXPECT_NEAR(end[0], at[0], 1e-13);
  EXPECT_NEAR(end[1], at[1], 1e-13);
  EXPECT_EQ(EventsOf(run.simulator).back().b, "corner");
  for (const int row : {0, 1}) {
    const Sensitivity found = run.GradientOf(row);
    for (int column = 0; column < 4; ++column) {
      EXPECT_NEAR(found.initial[column], Difference<EventRun>(scene, row, column), 1e-8);
    }
  }
}

TEST(EventPockets, OtherModelsAndSequencesOfImpactsRefuseThem) {
  const Scene scene = WithPocket(6);
  for (const ModelTraits& model : AllContactModels()) {
    EXPECT_EQ(ReasonNotApplicable(std::string(model.name), scene).empty(), model.event_driven) << model.name;
  }
  EXPECT_EQ(NonPlaneGeometry(scene), "pockets that discs fall into");
}

TEST(EventPockets, NoDiscStartsInOne) {
  Scene scene = WithPocket(5);
  scene.bodies[0].position = {1.1, 0.5};
  const std::optional<SceneError> error = Validate(scene);
  ASSERT_TRUE(error.has_value());
  EXPECT_EQ(error->key, "bodies[0].position");
  EXPECT_NE(error->message.find("corner"), std::string::npos) << error->message;
  scene.pockets[0].radius = 0;
  EXPECT_EQ(Validate(scene)->key, "pockets[0].radius");
  scene.pockets[0] = {"ball", {1, 0.5}, 0.2};
  EXPECT_EQ(Validate(scene)->key, "pockets[0].name");
}

}  // namespace
}  // namespace saltus
