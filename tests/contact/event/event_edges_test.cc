// Segments, polygons, arcs and tables under the event-driven model, against values computed elsewhere (spec/
// static-geometry.md and table-friction.md, 50 digits), planes, fixed discs and differences.
#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <numbers>
#include <random>

#include "contact/event/event.h"
#include "contact/event/event_run.h"
#include "saltus/simulate/events.h"
#include "scene/units.h"

namespace saltus {
namespace {

using testing::EventRun;

// The motion of a scene with thresholds in its natural units, and what it says in those of the scene.
struct NaturalRun {
  explicit NaturalRun(const Scene& given)
      : scene(given), run(ToNaturalUnits(given)), units(run.simulator.scene().units) {}

  std::vector<double> End() const { return ConvertStates(run.End(), units, scene.units); }
  std::vector<Event> Events() const {
    std::vector<Event> events = EventsOf(run.simulator);
    for (Event& event : events) event.time *= units.time / scene.units.time;
    return events;
  }
  // d End()[row] / d of the initial state's numbers, and then of the restitution.
  std::vector<double> DerivativesOf(int row) {
    const double speed = units.speed() / scene.units.speed();
    const auto size = [&](int i) { return i % 4 < 2 ? units.length / scene.units.length : speed; };
    const Sensitivity gradient = run.GradientOf(row);
    std::vector<double> all = gradient.initial;
    for (int i = 0; i < static_cast<int>(all.size()); ++i) all[i] *= size(row) / size(i);
    all.push_back(gradient.parameters.restitution * size(row));
    return all;
  }

  Scene scene;
  EventRun run;
  Units units;
};

void ExpectNear(const std::vector<double>& found, const std::vector<double>& expected, double tolerance) {
  ASSERT_EQ(found.size(), expected.size());
  for (std::size_t i = 0; i < found.size(); ++i) {
    EXPECT_NEAR(found[i], expected[i], tolerance * (1 + std::abs(expected[i]))) << "entry " << i;
  }
}

Scene Empty(double duration, int steps) {
  Scene scene;
  scene.name = "edges";
  scene.duration = duration;
  scene.steps = steps;
  scene.optimize = Optimize::kNone;
  return scene;
}

Scene Gate(int steps) {
  Scene scene = Empty(1.0, steps);
  scene.gravity = {0, -9.81};
  scene.bodies = {{.name = "ball", .radius = 0.1, .position = {-0.76, 1.09}, .velocity = {0.4, -0.3}}};
  scene.segments = {{"left", {-1, 0.55}, {-0.15, 0.4}}, {"right", {0.15, 0.45}, {1, 0.6}}};
  scene.contact = {.restitution = 0.8, .friction = 0};
  return scene;
}

TEST(EventEdges, ThroughAGate) {
  for (const int steps : {1, 7, 480}) {
    NaturalRun run(Gate(steps));
    const std::vector<Event> events = run.Events();
    ASSERT_EQ(events.size(), 2u);
    EXPECT_EQ(events[0].b, "left");
    EXPECT_EQ(events[1].b, "right.a");
    EXPECT_NEAR(events[0].time, 0.29057452029726394146, 1e-13);
    EXPECT_NEAR(events[1].time, 0.80604862652974672687, 1e-13);
    ExpectNear(
        run.End(), {0.023944565074957126, -0.35137410074965002, -0.14205208786746608, -4.9943184413781695}, 1e-11);
    // By position, velocity and restitution.
    const std::vector<std::vector<double>> expected = {
        {-43.059312236007826, -45.963795197067841, -28.363398407224239, -0.33563040238688193, -38.329715741444786},
        {3.9970231155004202, 7.2105775777938935, 2.1841702218072139, 0.45157537352091432, 5.4348129038309706},
        {-217.71590605508173, -232.88488799638085, -143.36558162102895, -1.7554430196858755, -194.15413481291726},
        {21.273633633336146, 27.140211657215097, 12.99757182074588, 1.0374505561844984, 20.935296871061431}};
    for (int row = 0; row < 4; ++row) ExpectNear(run.DerivativesOf(row), expected[row], 1e-10);
  }
}

Scene Shot(int steps) {
  Scene scene = Empty(4.0, steps);
  scene.table = TableFriction{.friction = 0.1};
  scene.bodies = {{.name = "striker", .radius = 0.0206, .mass = 0.015, .velocity = {1.8, 0.12}},
                  {.name = "coin1", .radius = 0.0159, .mass = 0.0055, .position = {0.3, 0.03}},
                  {.name = "coin2", .radius = 0.0159, .mass = 0.0055, .position = {0.45, 0.09}}};
  scene.planes = {{"cushion", {0.74, 0}, {-1, 0}}};
  scene.contact = {.restitution = 0.9, .friction = 0};
  return scene;
}

void ExpectEventsOfTheShot(const std::vector<Event>& events) {
  struct Expected {
    double time;
    const char *a, *b;
  };
  const std::array<Expected, 6> expected = {{{0.15402346046544412804, "striker", "coin1"},
                                             {0.21372309598312825445, "coin1", "coin2"},
                                             {0.37887393561296819682, "coin2", "cushion"},
                                             {0.64030661235935609847, "coin1", "table"},
                                             {1.0724282258384527202, "striker", "table"},
                                             {2.1226719982363336650, "coin2", "table"}}};
  std::size_t next = 0;
  for (const Event& event : events) {
    // The begin of sliding, and rest at time 0, are not among the expected events.
    if (event.b == "table" && (event.mode == ContactMode::kSlip || event.time == 0)) continue;
    ASSERT_LT(next, expected.size());
    EXPECT_NEAR(event.time, expected[next].time, 1e-12);
    EXPECT_EQ(event.a, expected[next].a);
    EXPECT_EQ(event.b, expected[next].b);
    ++next;
  }
  EXPECT_EQ(next, expected.size());
}

TEST(EventEdges, AShotOnATable) {
  for (const int steps : {1, 100, 479}) {
    NaturalRun run(Shot(steps));
    ExpectNear(run.End(),
               {0.67252719335600192,
                -0.057130624227987841,
                0,
                0,
                0.48588822777449465,
                0.010899964357333747,
                0,
                0,
                -0.52352095278649834,
                1.0689900128508549,
                0,
                0},
               1e-11);
    if (steps > 1) ExpectEventsOfTheShot(run.Events());  // of one step, which says once that a disc rests
    // Derivatives of the final positions of the first and second coin, by the initial state and the restitution.
    ExpectNear(run.DerivativesOf(4),
               {-5.8751936738998279,
                88.848777191661263,
                -0.78749649062576498,
                13.138084506431998,
                12.505813572068805,
                -107.30944465176268,
                0,
                0,
                -5.6306198981689767,
                18.460667460101416,
                0,
                0,
                -0.16421071914636762},
               1e-10);
    ExpectNear(run.DerivativesOf(9),
               {-10.527525500948283,
                168.93043448606778,
                -0.33815442272080365,
                25.332881986910011,
                25.7210606301816,
                -210.19706788249944,
                0,
                0,
                -15.236677919136621,
                42.266633396431662,
                0,
                0,
                2.7277543084674447},
               1e-10);
  }
}

TEST(EventEdges, DiscsThatSlideOnATableStop) {
  Scene scene = Empty(3.0, 30);
  scene.table = TableFriction{.friction = 0.2, .gravity = 9.81};
  scene.bodies = {{.name = "puck", .radius = 0.1, .position = {0.5, -0.25}, .velocity = {1.2, -0.9}}};
  NaturalRun run(scene);
  const double way = 1.5 * 1.5 / (2 * 0.2 * 9.81);
  ExpectNear(run.End(), {0.5 + 0.8 * way, -0.25 - 0.6 * way, 0, 0}, 1e-13);
  scene.control = {{0}, {{1, 0}}};
  EXPECT_NE(EventDriven::ReasonNotApplicable(scene), "");
  scene.control = {};
  scene.gravity = {0, -1};
  EXPECT_NE(EventDriven::ReasonNotApplicable(scene), "");
}

// A floor of many short segments is a floor: nothing is missed or met twice at their joints, also not where the disc
// comes down on one, and what slides goes on.
TEST(EventEdges, JointsInALineAreNotFelt) {
  for (const double friction : {0.0, 0.3}) {
    for (const double x : {0.0, 0.02, 0.05, 0.1}) {  // over joints, and beside
      Scene plane = Empty(1.5, 60);
      plane.gravity = {0.7, -9.81};
      plane.bodies = {{.name = "ball", .radius = 0.1, .position = {x - 0.5, 0.35}, .velocity = {0.5, 0}}};
      plane.planes = {{"floor", {0, 0}, {0, 1}}};
      plane.contact = {.restitution = 0.4, .friction = friction};
      Scene edges = plane;
      edges.planes.clear();
      for (int k = -20; k < 60; ++k) {
        edges.segments.push_back({"s" + std::to_string(k), {0.05 * k, 0}, {0.05 * (k + 1), 0}});
      }
      EventRun expected(plane), found(edges);
      ExpectNear(found.End(), expected.End(), 1e-10);
      for (int row = 0; row < 4; ++row) {
        ExpectNear(found.GradientOf(row).initial, expected.GradientOf(row).initial, 1e-9);
      }
      int impacts = 0, expected_impacts = 0;
      for (const StepTouch& at : found.simulator.touches()) impacts += at.touch.kind == ContactKind::kImpact;
      for (const StepTouch& at : expected.simulator.touches())
        expected_impacts += at.touch.kind == ContactKind::kImpact;
      EXPECT_EQ(impacts, expected_impacts);
    }
  }
}

// A ball slides off a table's edge, fast enough to fly at once.
TEST(EventEdges, SlidesOffAnEnd) {
  Scene scene = Empty(1.0, 50);
  scene.gravity = {0, -9.81};
  scene.bodies = {{.name = "ball", .radius = 0.1, .position = {-0.5, 0.1}, .velocity = {1.6, 0}}};
  scene.segments = {{"shelf", {-1, 0}, {0.013, 0}}};
  NaturalRun run(scene);
  const double fall = 1.0 - 0.513 / 1.6;
  ExpectNear(run.End(), {1.1, 0.1 - 0.5 * 9.81 * fall * fall, 1.6, -9.81 * fall}, 1e-10);
  // By the position and the velocity along the shelf; the time at which it is left changes with both.
  ExpectNear(run.DerivativesOf(1), {-9.81 * fall / 1.6, 0, -9.81 * fall * 0.513 / (1.6 * 1.6), 0, 0}, 1e-9);
}

// In a bowl a disc swings as a pendulum: energy stays, and the mirrored motion is mirrored.
TEST(EventEdges, SlidesAlongAnArc) {
  const double start = 1.25 * std::numbers::pi;
  Scene scene = Empty(1.2, 100);
  scene.gravity = {0, -9.81};
  scene.bodies = {{.name = "ball", .radius = 0.1, .position = {0.9 * std::cos(start), 0.9 * std::sin(start)}}};
  scene.arcs = {{"bowl", {0, 0}, 1.0, std::numbers::pi + 0.1, 2 * std::numbers::pi - 0.1}};
  scene.contact.restitution = 0;
  Scene mirrored = scene;
  mirrored.bodies[0].position[0] *= -1;
  const std::vector<double> end = NaturalRun(scene).End(), other = NaturalRun(mirrored).End();
  EXPECT_NEAR(0.5 * (end[2] * end[2] + end[3] * end[3]) + 9.81 * (end[1] - scene.bodies[0].position[1]), 0, 1e-9);
  EXPECT_NEAR(std::hypot(end[0], end[1]), 0.9, 1e-9);
  ExpectNear(other, {-end[0], end[1], -end[2], end[3]}, 1e-9);
  // The pendulum of length 0.9 by small steps of its angle (Runge-Kutta of order 4).
  double angle = start, rate = 0;
  const int n = 20000;
  const double h = scene.duration / n;
  const auto bend = [](double a) { return -9.81 / 0.9 * std::cos(a); };
  for (int k = 0; k < n; ++k) {
    const double k1 = rate, l1 = bend(angle), k2 = rate + h / 2 * l1, l2 = bend(angle + h / 2 * k1);
    const double k3 = rate + h / 2 * l2, l3 = bend(angle + h / 2 * k2), k4 = rate + h * l3, l4 = bend(angle + h * k3);
    angle += h / 6 * (k1 + 2 * k2 + 2 * k3 + k4);
    rate += h / 6 * (l1 + 2 * l2 + 2 * l3 + l4);
  }
  EXPECT_NEAR(end[0], 0.9 * std::cos(angle), 1e-5);
  EXPECT_NEAR(end[1], 0.9 * std::sin(angle), 1e-5);
}

// Along the inside of a ring without any force but the ring's.
TEST(EventEdges, SlidesAroundARing) {
  for (const double friction : {0.0, 0.1}) {
    Scene scene = Empty(1.2, 40);
    scene.bodies = {{.name = "ball", .radius = 0.1, .position = {0.9, 0}, .velocity = {0, 1}}};
    scene.arcs = {{"ring", {0, 0}, 1.0, 0, 2 * std::numbers::pi}};
    scene.contact = {.restitution = 0.5, .friction = friction};
    // v' = -mu v^2 / R.
    const double faster = 1 + friction * scene.duration / 0.9;
    const double angle = friction > 0 ? std::log(faster) / friction : scene.duration / 0.9;
    const std::vector<double> end = NaturalRun(scene).End();
    ExpectNear(
        end, {0.9 * std::cos(angle), 0.9 * std::sin(angle), -std::sin(angle) / faster, std::cos(angle) / faster}, 1e-5);
  }
}

// Two discs in a room with a box and a post, all of edges.
Scene Room(double friction) {
  Scene scene = Empty(4.0, 100);
  scene.bodies = {{.name = "a", .radius = 0.1, .position = {0.8, 0.5}, .velocity = {0.9, 0.5}},
                  {.name = "b", .radius = 0.1, .mass = 2, .position = {0.6, 1.1}, .velocity = {0.3, -0.5}}};
  scene.polygons = {{"room", {{0, 0}, {2, 0}, {1.7, 1.5}, {0.3, 1.6}}, EdgePolygon::Solid::kOutside},
                    {"box", {{1.2, 0.6}, {1.5, 0.6}, {1.4, 1.0}}, EdgePolygon::Solid::kInside}};
  scene.arcs = {{"post", {1.0, 0.2}, 0.05, 0, 2 * std::numbers::pi}};
  scene.contact = {.restitution = 0.9, .friction = friction};
  return scene;
}

TEST(EventEdges, DerivativesEqualDifferences) {
  for (const double friction : {0.0, 0.2}) {
    const Scene scene = Room(friction);
    NaturalRun run(scene);
    EXPECT_GE(run.Events().size(), 5u);
    constexpr double kStep = 1e-6;
    std::vector<std::vector<double>> differences(8);
    for (int j = 0; j < 8; ++j) {
      std::array<std::vector<double>, 2> ends;
      for (const int side : {0, 1}) {
        Scene moved = scene;
        Body& body = moved.bodies[j / 4];
        (j % 4 < 2 ? body.position : body.velocity)[j % 2] += (2 * side - 1) * kStep;
        ends[side] = NaturalRun(moved).End();
      }
      for (int i = 0; i < 8; ++i) differences[i].push_back((ends[1][i] - ends[0][i]) / (2 * kStep));
    }
    for (int i = 0; i < 8; ++i) {
      std::vector<double> derivatives = run.DerivativesOf(i);
      derivatives.pop_back();
      ExpectNear(derivatives, differences[i], 1e-6);
    }
  }
}

// Nothing leaves a random polygon of walls, and without friction and with restitution 1 the speed stays.
TEST(EventEdges, NothingLeaksOut) {
  std::mt19937 engine(7);
  std::uniform_real_distribution<double> uniform(0, 1);
  for (int trial = 0; trial < 20; ++trial) {
    Scene scene = Empty(10.0, 200);
    EdgePolygon room{"room", {}, EdgePolygon::Solid::kOutside};
    const int corners = 5 + trial;
    for (int k = 0; k < corners; ++k) {
      const double angle = 2 * std::numbers::pi * k / corners, radius = 0.6 + 0.8 * uniform(engine);
      room.points.push_back({radius * std::cos(angle), radius * std::sin(angle)});
    }
    scene.polygons = {room};
    scene.bodies = {
        {.name = "ball", .radius = 0.08, .velocity = {3 * uniform(engine) - 1.5, 3 * uniform(engine) - 1.5}}};
    const double speed = scene.bodies[0].velocity.norm();
    EventRun run(ToNaturalUnits(scene));
    if (!run.finite) continue;
    for (int k = 0; k <= scene.steps; ++k) {
      const std::vector<double> x = ConvertStates(run.State(k), run.simulator.scene().units, scene.units);
      ASSERT_LT(std::hypot(x[0], x[1]), 1.4);
      ASSERT_NEAR(std::hypot(x[2], x[3]), speed, 1e-10);
    }
  }
}

}  // namespace
}  // namespace saltus
