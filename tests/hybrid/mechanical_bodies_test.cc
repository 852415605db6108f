// Planar rigid bodies: boxes against exact values, discs against the contact model `event`, and random tosses.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <nlohmann/json.hpp>
#include <vector>

#include "campaign/tossed_boxes.h"
#include "reference_values.h"
#include "saltus/hybrid/hybrid_simulator.h"
#include "saltus/hybrid/mechanical_system.h"
#include "saltus/hybrid/rigid_bodies.h"
#include "saltus/simulate/registry.h"
#include "saltus/simulate/simulator.h"
#include "test_scenes.h"

namespace saltus {
namespace {

using testing::HasSubstr;

TEST(RigidBodies, ATossedBoxHasTheExactMotion) {
  const nlohmann::json& reference = ReferenceFile("mechanical_references.json").at("P4r");
  const RigidBodies2D scene({.bodies = {{.name = "box",
                                         .polygon = BoxPolygon(0.3, 0.2),
                                         .mass = 0.8,
                                         .position = {0, 0.9},
                                         .velocity = {1.5, -0.5},
                                         .angle = 0.6,
                                         .spin = -3}},
                             .planes = {{}},
                             .restitution = 0.6,
                             .friction = 0.3});
  const MechanicalSystem system(scene);
  HybridSimulator simulator(system.hybrid(), {.tolerance = 1e-14});
  ASSERT_TRUE(simulator.Rollout({.initial = scene.InitialState(), .parameters = scene.Parameters(), .duration = 1.05}));
  ASSERT_EQ(simulator.events().size(), reference.at("events").size());
  const std::vector<std::string> corners = {"A", "B", "C", "D"};
  for (size_t i = 0; i < simulator.events().size(); ++i) {
    const HybridEvent& event = simulator.events()[i];
    const auto expected = reference["events"][i].at("contact").get<std::string>();
    EXPECT_EQ(system.hybrid().GuardName(event.mode, event.guard),
              "hit box." + std::to_string(std::find(corners.begin(), corners.end(), expected) - corners.begin()) +
                  "-plane 0");
  }
  for (int i = 0; i < 6; ++i) {
    EXPECT_NEAR(simulator.final_state()[i], Number(reference.at("state_at_T")[i]), 1e-10);
  }
}

// Discs of a scene without edges and pockets. Those that do not spin do not turn.
RigidScene2D RigidOf(const Scene& scene) {
  RigidScene2D out{.bodies = {},
                   .planes = {},
                   .gravity = {scene.gravity[0], scene.gravity[1]},
                   .restitution = scene.contact.restitution,
                   .friction = scene.contact.friction};
  for (size_t i = 0; i < scene.bodies.size(); ++i) {
    const Body& body = scene.bodies[i];
    RigidBody2D disc{.name = body.name,
                     .radius = body.radius,
                     .mass = body.mass,
                     .position = {body.position[0], body.position[1]},
                     .velocity = {body.velocity[0], body.velocity[1]},
                     .angle = body.angle,
                     .spin = body.angular_velocity};
    if (body.Spins()) disc.inertia = body.MomentOfInertia();
    disc.joint.kind = body.fixed     ? RigidJoint2D::Kind::kWeld
                      : body.Spins() ? RigidJoint2D::Kind::kFree
                                     : RigidJoint2D::Kind::kTranslation;
    disc.pushed = std::count(scene.control.bodies.begin(), scene.control.bodies.end(), static_cast<int>(i)) > 0;
    out.bodies.push_back(disc);
  }
  for (const Plane& plane : scene.planes) {
    const double length = std::hypot(plane.normal[0], plane.normal[1]);
    out.planes.push_back(
        {.point = {plane.point[0], plane.point[1]}, .normal = {plane.normal[0] / length, plane.normal[1] / length}});
  }
  return out;
}

// The motion of a scene by `event` and as a mechanical system: final positions and velocities, and their derivatives by
// these at the start.
void ExpectSameMotion(const Scene& scene, double tolerance, double gradient_tolerance) {
  const auto exact = MakeSimulator({"event"}, scene, Precision::kDouble);
  const std::vector<double> x0 = InitialState(scene), control = InitialControl(scene, exact->num_steps());
  ASSERT_TRUE(exact->Rollout(x0, control));
  std::vector<double> state(exact->state_size());
  exact->GetState(exact->num_steps(), state);

  const RigidBodies2D bodies(RigidOf(scene));
  const MechanicalSystem system(bodies);
  HybridInput input{.initial = bodies.InitialState(),
                    .parameters = bodies.Parameters(),
                    .duration = scene.duration,
                    .num_intervals = scene.steps};
  const int width = system.hybrid().num_controls();
  for (int k = 0; k < scene.steps && width > 0; ++k) {
    std::vector<double> forces(width, 0.0);
    int place = 0;
    for (size_t b = 0; b < scene.bodies.size(); ++b) {
      const auto found = std::find(scene.control.bodies.begin(), scene.control.bodies.end(), static_cast<int>(b));
      if (found == scene.control.bodies.end()) continue;
      const size_t index = found - scene.control.bodies.begin();
      for (int i = 0; i < 2; ++i) forces[place + i] = control[(k * scene.control.bodies.size() + index) * 2 + i];
      place += 3;
    }
    input.control.insert(input.control.end(), forces.begin(), forces.end());
  }
  const MechanicalSystem::Start start =
      system.FindMode(input.initial, std::span(input.control).first(width), input.parameters);
  ASSERT_GE(start.mode, 0) << start.reason;
  input.mode = start.mode;
  HybridSimulator simulator(system.hybrid(), {.tolerance = 1e-13});
  ASSERT_TRUE(simulator.Rollout(input)) << simulator.FailureReason();
  // Where x, y of a disc and their rates are in the states of the scene, in its initial state and in the mechanical
  // ones.
  struct Place {
    int of_scene, at_start, of_system;
  };
  std::vector<Place> places;
  const int n = static_cast<int>(input.initial.size()) / 2, per_body = exact->body_size();
  int coordinate = 0;
  for (size_t b = 0; b < scene.bodies.size(); ++b) {
    if (scene.bodies[b].fixed) continue;
    for (int i = 0; i < 2; ++i) {
      const int disc = static_cast<int>(b);
      places.push_back({disc * per_body + i, disc * 4 + i, coordinate + i});
      places.push_back({disc * per_body + 2 + i, disc * 4 + 2 + i, n + coordinate + i});
    }
    coordinate += scene.bodies[b].Spins() ? 3 : 2;
  }
  for (const Place& place : places) {
    EXPECT_NEAR(simulator.final_state()[place.of_system], state[place.of_scene], tolerance) << place.of_scene;
  }
  for (const Place& of : places) {
    std::vector<double> cotangent(state.size()), own(2 * n);
    cotangent[of.of_scene] = 1;
    own[of.of_system] = 1;
    Sensitivity expected;
    exact->Adjoint(cotangent, /*with_parameters=*/false, &expected);
    const HybridGradient gradient = simulator.Adjoint(own);
    double largest = 1;
    for (const double entry : expected.initial) largest = std::max(largest, std::abs(entry));
    for (const Place& by : places) {
      EXPECT_NEAR(gradient.initial[by.of_system], expected.initial[by.at_start], gradient_tolerance * largest)
          << of.of_scene << " by " << by.at_start;
    }
  }
}

TEST(DiscsAsRigidBodies, EqualTheModelEvent) {
  {
    SCOPED_TRACE("two_balls");
    ExpectSameMotion(ProblemScene("two_balls"), 1e-10, 1e-9);
  }
  for (const double friction : {0.0, 0.3}) {
    SCOPED_TRACE(friction);
    ExpectSameMotion(FourDiscs(friction), 1e-10, 1e-9);
  }
}

TEST(DiscsAsRigidBodies, EqualTheModelEventInClosedContact) {
  Scene scene;
  scene.name = "slope";
  scene.duration = 1.5;
  scene.steps = 60;
  scene.gravity = {0, -9.81};
  scene.planes = {{"slope", {0, 0}, {0.3, 1}}};
  scene.contact = {.restitution = 0, .friction = 0.2};
  scene.bodies = {{.name = "disc", .radius = 0.2, .mass = 1.5, .position = {0, 1}, .velocity = {1, 0}}};
  scene.optimize = Optimize::kVelocity;
  ExpectSameMotion(scene, 1e-10, 1e-9);  // it lands and slides on
  scene.contact.restitution = 0.5;
  scene.duration = 2.5;
  ExpectSameMotion(scene, 1e-8, 1e-6);  // its bounces accumulate before
  scene.contact.friction = 0.6;
  ExpectSameMotion(scene, 1e-8, 1e-6);  // it comes to rest
  scene.bodies[0].inertia.kind = Inertia::Kind::kSolid;
  scene.contact.restitution = 0;
  ExpectSameMotion(scene, 1e-10, 1e-9);  // it rolls
}

TEST(RigidBodies, JointsToTheWorld) {
  // A rod that turns about its end is a pendulum; a block on a slide falls along it.
  const RigidBodies2D scene({.bodies = {{.name = "rod",
                                         .polygon = BoxPolygon(0.01, 0.5),
                                         .mass = 2,
                                         .position = {0, -0.5},
                                         .angle = 0.1,
                                         .joint = {.kind = RigidJoint2D::Kind::kRevolute, .point = {0, 0}}},
                                        {.name = "block",
                                         .polygon = BoxPolygon(0.1, 0.1),
                                         .mass = 3,
                                         .position = {5, 0},
                                         .joint = {.kind = RigidJoint2D::Kind::kPrismatic, .axis = {0.6, -0.8}}}},
                             .friction = 0});
  const MechanicalSystem system(scene);
  const std::vector<double> x = scene.InitialState();
  const MechanicalSystem::Motion motion = system.MotionIn(0, x, {}, scene.Parameters());
  // The centre is at (0, -0.5) when the angle is 0.1, so gravity has no moment there.
  EXPECT_NEAR(motion.acceleration[0], 0, 1e-15);
  EXPECT_NEAR(motion.acceleration[1], 0.8 * 9.81, 1e-14);
  std::vector<double> turned = x;
  turned[0] += 0.5;
  const double inertia = 2 * (0.01 * 0.01 + 0.25) / 3 + 2 * 0.25;
  EXPECT_NEAR(system.MotionIn(0, turned, {}, scene.Parameters()).acceleration[0],
              -2 * 9.81 * 0.5 * std::sin(0.5) / inertia,
              1e-13);
}

TEST(RigidBodies, WrongScenesAreReported) {
  EXPECT_EQ(Validate(RigidScene2D{.bodies = {{.name = "box", .polygon = BoxPolygon(1, 1)}}}), "");
  EXPECT_THAT(Validate(RigidScene2D{.bodies = {{.name = "box"}}}), HasSubstr("either a polygon or a radius"));
  EXPECT_THAT(Validate(RigidScene2D{.bodies = {{.polygon = {{0, 0}, {0, 1}, {1, 0}}}}}), HasSubstr("not convex"));
  EXPECT_THAT(Validate(RigidScene2D{.bodies = {{.radius = 1, .mass = -1}}}), HasSubstr("mass"));
  EXPECT_THAT(Validate(RigidScene2D{.bodies = {{.radius = 1}}, .planes = {{.normal = {1, 1}}}}),
              HasSubstr("normal of a plane"));
}

// A box that slides on two corners and stops, where no speed is left to tell that both do: one event, and then rest.
// The whole scene is turned by an angle, so that rounding leaves some speed. x = v^2 / (2 mu g).
TEST(RigidBodies, CornersOfABoxStopTogether) {
  for (const double angle : {0.0, 0.1, 0.7, 2.5}) {
    const double c = std::cos(angle), s = std::sin(angle);
    const RigidBodies2D scene({.bodies = {{.name = "box",
                                           .polygon = BoxPolygon(0.13, 0.07),
                                           .position = {-0.07 * s, 0.07 * c},
                                           .velocity = {0.31 * c, 0.31 * s},
                                           .angle = angle}},
                               .planes = {{.normal = {-s, c}}},
                               .gravity = {9.81 * s, -9.81 * c},
                               .friction = 0.24});
    const MechanicalSystem system(scene);
    const std::vector<double> initial = scene.InitialState(), p = scene.Parameters();
    const MechanicalSystem::Start start = system.FindMode(initial, {}, p);
    ASSERT_EQ(start.reason, "") << angle;
    HybridSimulator simulator(system.hybrid(), {.steps_per_interval = 100, .most_events = 100});
    ASSERT_TRUE(simulator.Rollout({.mode = start.mode, .initial = initial, .parameters = p, .duration = 0.9})) << angle;
    ASSERT_EQ(simulator.events().size(), 1u) << angle;
    EXPECT_NEAR(simulator.events()[0].time, 0.31 / (0.24 * 9.81), 1e-12);
    const std::span<const double> last = simulator.final_state();
    EXPECT_NEAR(c * last[0] + s * last[1], 0.31 * 0.31 / (2 * 0.24 * 9.81), 1e-12);
    EXPECT_EQ(simulator.ReasonNotDifferentiable(), "");
    const HybridGradient gradient = simulator.Adjoint(std::vector<double>{c, s, 0, 0, 0, 0});
    EXPECT_NEAR(c * gradient.initial[3] + s * gradient.initial[4], 0.31 / (0.24 * 9.81), 1e-10);
  }
}

// A disc that is in the ground by rounding and rises by less than that comes back without having been above it.
TEST(RigidBodies, AGapBelowZeroByRoundingIsNotMissed) {
  const RigidBodies2D scene(
      {.bodies = {{.name = "disc", .radius = 0.5, .position = {0, 1.5 - 8.5e-13}, .velocity = {0, 6.25e-7}}},
       .planes = {{.point = {0, 1}}},
       .restitution = 0.5});
  const MechanicalSystem system(scene);
  for (const double duration : {1e-3, 0.09}) {
    HybridSimulator simulator(system.hybrid(), {.steps_per_interval = 100});
    ASSERT_TRUE(
        simulator.Rollout({.initial = scene.InitialState(), .parameters = scene.Parameters(), .duration = duration}));
    EXPECT_NEAR(simulator.final_state()[1], 1.5, 2e-12) << duration;
  }
}

TEST(RigidBodies, RandomTosses) {
  int simulated = 0, with_gradient = 0;
  // 8, 38, 49, 515: a corner cuts a corner within a step. 340: closed contacts come to the end of an edge. 887: a
  // corner falls back while another one leaves its edge.
  for (const int seed : {1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 38, 49, 340, 515, 887}) {
    const TossedBoxes::Result result = TossedBoxes(seed).Run(/*with_gradient=*/seed <= 6);
    EXPECT_EQ(result.wrong, "") << "seed " << seed;
    simulated += result.refused.empty() ? 1 : 0;
    with_gradient += result.gradient_compared ? 1 : 0;
  }
  EXPECT_GT(simulated, 8);
  EXPECT_GT(with_gradient, 1);
}

// Three boxes rattle against each other and the ground, with speeds that fall in 1600 impacts to where contacts are
// held closed. Those whose impulses would be lost in rounding are not.
TEST(RigidBodies, ContactsThatAreHeldDoNotApproach) {
  const TossedBoxes::Result result = TossedBoxes(296).Run(/*with_gradient=*/false, /*most_events=*/2500);
  EXPECT_EQ(result.wrong, "");
  EXPECT_GT(result.impacts, 1500);
}

// A box flies past a corner of another and cuts it, or not, for less than a step of the integration: the hit is where
// no normal separates the boxes any more.
TEST(RigidBodies, ACornerThatCutsACornerHits) {
  int hits = 0, misses = 0;
  for (int k = 0; k < 60; ++k) {
    SCOPED_TRACE(k);
    const RigidBodies2D bodies({.bodies = {{.name = "table", .polygon = BoxPolygon(0.5, 0.5)},
                                           {.name = "box",
                                            .polygon = BoxPolygon(0.5, 0.5),
                                            .position = {-1.6, -0.7 + 0.02 * k},
                                            .velocity = {2, 2},
                                            .angle = 0.5}},
                                .gravity = {0, 0}});
    std::vector<double> x = bodies.InitialState();
    const double start_x = x[3], start_y = x[4];
    const auto separation = [&](double time) {
      x[3] = start_x + 2 * time;
      x[4] = start_y + 2 * time;
      return SeparationOf(bodies, 0, 1, x.data());
    };
    constexpr double kDuration = 0.7;
    double least = 1, above = 0, below = 0;
    for (int i = 0; i <= 7000; ++i) {
      const double time = kDuration * i / 7000, now = separation(time);
      least = std::min(least, now);
      if (now < 0 && below == 0) below = time;
    }
    if (std::abs(least) < 1e-3) continue;
    for (int i = 0; i < 60; ++i) {
      const double middle = 0.5 * (above + below);
      (separation(middle) < 0 ? below : above) = middle;
    }
    const MechanicalSystem system(bodies);
    HybridSimulator simulator(system.hybrid(), {.steps_per_interval = 12});
    const HybridInput input{.initial = bodies.InitialState(), .parameters = bodies.Parameters(), .duration = kDuration};
    ASSERT_TRUE(simulator.Rollout(input)) << simulator.FailureReason();
    ASSERT_EQ(simulator.events().empty(), least > 0);
    (least > 0 ? misses : hits) += 1;
    if (least < 0) {
      EXPECT_NEAR(simulator.events()[0].time, below, 1e-12);
    }
  }
  EXPECT_GT(hits, 10);
  EXPECT_GT(misses, 10);
}

}  // namespace
}  // namespace saltus
