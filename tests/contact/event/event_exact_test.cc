// The event-driven model against every exact value, on fine and on coarse time grids.
#include <gtest/gtest.h>

#include "contact/event/event_run.h"
#include "exact/exact_scenes.h"
#include "parameter_name.h"

namespace saltus {
namespace {

using exact_test::References;
using saltus::testing::EventRun;
using saltus::testing::StartOf;

constexpr double kTolerance = 1e-10;

void ExpectRelative(double actual, double expected, const std::string& what) {
  EXPECT_NEAR(actual, expected, kTolerance * std::max(1e-3, std::abs(expected))) << what;
}

void ExpectEvents(const EventRun& run, const std::vector<double>& times) {
  const std::vector<StepTouch>& touches = run.simulator.touches();
  ASSERT_EQ(touches.size(), times.size());
  for (std::size_t i = 0; i < times.size(); ++i) {
    EXPECT_NEAR(run.TimeOf(touches[i]), times[i], 1e-13);
    EXPECT_EQ(touches[i].touch.kind, ContactKind::kImpact);
  }
}

class EventExact : public ::testing::TestWithParam<int> {
 protected:
  Scene WithSteps(Scene scene) const {
    scene.steps = GetParam();
    return scene;
  }
};
INSTANTIATE_TEST_SUITE_P(Steps, EventExact, ::testing::Values(1, 7, 100, 480), ParameterName());

TEST_P(EventExact, BounceOnce) {
  const auto& exact = References()["task1"];
  const int n = GetParam();
  EventRun run(WithSteps(exact_test::BounceOnce()));
  ExpectRelative(run.Loss(), Number(exact["height_T"]), "height");
  ExpectEvents(run, {Number(exact["impact_time"])});
  const Sensitivity gradient = run.Gradient();
  ExpectRelative(gradient.initial[1], -1, "position");
  ExpectRelative(gradient.initial[3], -1, "velocity");
  // Where a step holds the impact, its force acts before and after it.
  const double dt = 1.0 / n;
  for (int k = 0; k < n; ++k) {
    const double begin = k * dt, end = begin + dt;
    const auto lever = [](double a, double b) { return (b - a) * (1 - 0.5 * (a + b)); };  // integral of 1 - t
    const double before = lever(std::min(begin, 0.45), std::min(end, 0.45));
    const double after = lever(std::max(begin, 0.45), std::max(end, 0.45));
    EXPECT_NEAR(gradient.control[2 * k + 1], after - before, 1e-13) << k;
  }
}

TEST(EventExactGrid, TwoBallsOnHalfTheGrid) {
  EventRun run(exact_test::TwoBalls(240));
  ExpectRelative(run.Gradient().control[0], Number(References()["task3_du0_N240"]["du0_analytic_correct"]), "u_0");
}

// The impact time crosses nodes of the grid on the way.
TEST(EventExactGrid, GradientDescentOnTheControl) {
  const auto& exact = References()["exact_gradient_descent"];
  const auto descend = [](const Scene& scene, double rate, int updates) {
    EventRun run(scene);
    for (int i = 0; i < updates; ++i) {
      const std::vector<double> gradient = run.Gradient().control;
      for (std::size_t k = 0; k < gradient.size(); ++k) run.control[k] -= rate * gradient[k];
      EXPECT_TRUE(run.simulator.Rollout(StartOf(scene), run.control));
    }
    return run.Loss();
  };
  EXPECT_NEAR(descend(exact_test::TwoBalls(), 10, 1000), Number(exact["task3_480"]["loss_1000"]), 1e-11);
}

// The impact sits on node 216 of 480, and every published value is about this grid.
TEST(EventExactGrid, BounceOnceOnTheNode) {
  EventRun run(exact_test::BounceOnce());
  const std::vector<double> control = run.Gradient().control;
  ExpectRelative(control[1], -959.0 / 460800, "u_0");
  ExpectRelative(control[2 * 100 + 1], -0.001647135416666667, "u_100");
  ExpectRelative(control[2 * 215 + 1], -0.001148003472222222, "u_215");
  ExpectRelative(control[2 * 216 + 1], 0.001143663194444444, "u_216");
  ExpectRelative(control[2 * 479 + 1], 2.17013888888889e-6, "u_479");
  EXPECT_EQ(run.simulator.touches()[0].step, 216);
}

TEST_P(EventExact, GroundAndWall) {
  for (double friction : {0.0, 0.1}) {
    const auto& exact = References()["task2"][friction > 0 ? "mu0.1" : "frictionless"];
    EventRun run(WithSteps(exact_test::GroundWall(friction)));
    ExpectRelative(run.Loss(), Number(exact["loss"]), "loss");
    ExpectEvents(run, {Number(exact["events"][0]["time"]), Number(exact["events"][1]["time"])});
    for (const StepTouch& touch : run.simulator.touches()) {
      EXPECT_EQ(touch.touch.mode, friction > 0 ? ContactMode::kSlip : ContactMode::kFrictionless);
    }
    const Sensitivity gradient = run.Gradient();
    for (int i = 0; i < 4; ++i) {
      ExpectRelative(gradient.initial[i], Number(exact["grad_px_py_vx_vy"][i]), "gradient " + std::to_string(i));
    }
    const std::vector<double> end = run.End();
    for (int i = 0; i < 2; ++i) {
      ExpectRelative(end[i], Number(exact["p_T"][i]), "p");
      ExpectRelative(end[2 + i], Number(exact["v_T"][i]), "v");
    }
  }
}

TEST_P(EventExact, TwoBalls) {
  const auto& exact = References()["task3_gradients_N480"];
  EventRun run(WithSteps(exact_test::TwoBalls()));
  ExpectRelative(run.Loss(), Number(exact["loss"]), "loss");
  ExpectEvents(run, {Number(exact["s"])});
  const Sensitivity gradient = run.Gradient();
  const char* names[] = {"dp1", "dv1", "dp2", "dv2"};
  for (int i = 0; i < 8; ++i) ExpectRelative(gradient.initial[i], Number(exact[names[i / 2]]), names[i / 2]);
  if (GetParam() != 480) return;
  for (int k : {100, 200, 330, 331, 332, 400}) {
    const double expected = Number(exact["du" + std::to_string(k) + "_correct"]);
    ExpectRelative(gradient.control[2 * k], expected, "u_" + std::to_string(k));
    ExpectRelative(gradient.control[2 * k + 1], expected, "u_" + std::to_string(k));
  }
  ExpectRelative(gradient.control[0], Number(exact["du0_analytic_correct"]), "u_0");
}

TEST_P(EventExact, FollowUps) {
  for (const char* name : {"single", "multi"}) {
    const auto& exact = References()["followup_initial_gradients"][name];
    EventRun run(
        WithSteps(name == std::string("single") ? exact_test::SingleCollision() : exact_test::MultipleCollisions()));
    ExpectRelative(run.Loss(), Number(exact["loss"]), "loss");
    std::vector<double> times;
    for (const auto& event : exact["events"]) times.push_back(Number(event["time"]));
    ExpectEvents(run, times);
    const Sensitivity gradient = run.Gradient();
    for (int i = 0; i < 8; ++i) {
      const int entry = 2 * (i / 4) + i % 2;
      ExpectRelative(gradient.initial[i], Number(exact[i % 4 < 2 ? "dp" : "dv"][entry]), "initial");
    }
    // A constant force has the same derivative on every grid.
    Vec2d sum(0, 0), expected(0, 0);
    for (int k = 0; k < GetParam(); ++k) sum += Vec2d(gradient.control[2 * k], gradient.control[2 * k + 1]);
    for (int k = 0; k < 480; ++k) expected += exact_test::Vector(exact["du"][k]);
    for (int i = 0; i < 2; ++i) ExpectRelative(sum[i], expected[i], "constant force");
    if (GetParam() != 480) continue;
    for (int k = 0; k < 480; ++k) {
      for (int i = 0; i < 2; ++i) {
        ExpectRelative(gradient.control[2 * k + i], Number(exact["du"][k][i]), "u_" + std::to_string(k));
      }
    }
  }
}

// Every launch that hits the target is a minimum: no loss, no gradient.
TEST_P(EventExact, LaunchesThatHitTheTarget) {
  for (double friction : {0.0, 0.1}) {
    for (const auto& velocity : References()["task2"][friction > 0 ? "minima_mu0.1" : "minima_frictionless"]) {
      Scene scene = WithSteps(exact_test::GroundWall(friction));
      scene.bodies[0].velocity = exact_test::Vector(velocity);
      EventRun run(scene);
      EXPECT_LT(run.Loss(), 1e-25);
      for (double derivative : run.Gradient().initial) EXPECT_NEAR(derivative, 0, 1e-12);
    }
  }
}

// A thousand gradients in a row.
TEST_P(EventExact, GradientDescentOnTheLaunch) {
  for (double friction : {0.0, 0.1}) {
    const auto& exact = References()["exact_gradient_descent"][friction > 0 ? "task2_mu0.1" : "task2_mu0"];
    Scene scene = WithSteps(exact_test::GroundWall(friction));
    std::vector<double> losses;
    for (int i = 0; i < 1000; ++i) {
      EventRun run(scene);
      losses.push_back(run.Loss());
      const Sensitivity gradient = run.Gradient();
      scene.bodies[0].velocity -= 0.01 * Vec2d(gradient.initial[2], gradient.initial[3]);
    }
    const int iterations[] = {0, 1, 10, 100, 999};
    for (int i = 0; i < 5; ++i) {
      ExpectRelative(losses[iterations[i]], Number(exact["losses_at_0_1_10_100_999"][i]), "loss");
    }
    ExpectRelative(EventRun(scene).Loss(), Number(exact["loss_1000"]), "last loss");
    for (int i = 0; i < 2; ++i) ExpectRelative(scene.bodies[0].velocity[i], Number(exact["velocity_1000"][i]), "v");
  }
}

// A ball that bounces three times.
TEST_P(EventExact, Bouncing) {
  const auto& exact = References()["extra"]["X1"];
  Scene scene;
  scene.duration = 2;
  scene.gravity = {0, -9.8};
  scene.bodies = {exact_test::Disc("ball", 0.1, {0, 1}, {0, 0.5})};
  scene.planes = {{"ground", {0, 0}, {0, 1}}};
  scene.contact.restitution = 0.8;
  EventRun run(WithSteps(scene));
  ExpectRelative(run.End()[1], Number(exact["y"]), "y");
  ExpectRelative(run.End()[3], Number(exact["v"]), "v");
  ExpectEvents(run, {Number(exact["impacts"][0]), Number(exact["impacts"][1]), Number(exact["impacts"][2])});
  for (const auto& [entry, row] : {std::pair(1, exact["dy"]), std::pair(3, exact["dv"])}) {
    const Sensitivity gradient = run.GradientOf(entry);
    ExpectRelative(gradient.initial[1], Number(row[0]), "y0");
    ExpectRelative(gradient.initial[3], Number(row[1]), "v0");
    ExpectRelative(gradient.parameters.restitution, Number(row[2]), "e");
    ExpectRelative(-gradient.parameters.gravity[1], Number(row[3]), "g");
  }
}

TEST_P(EventExact, ThreeBallChain) {
  const auto& exact = References()["extra"]["X2"];
  Scene scene;
  scene.duration = 2;
  const char* const names[] = {"a", "b", "c"};
  const double mass[] = {2, 1, 3}, x[] = {0, 0.7, 1.5}, v[] = {1.5, 0.2, -0.4};
  for (int i = 0; i < 3; ++i) {
    scene.bodies.push_back(exact_test::Disc(names[i], 0.1, {x[i], 0}, {v[i], 0}));
    scene.bodies[i].mass = mass[i];
  }
  scene.contact.restitution = 0.9;
  EventRun run(WithSteps(scene));
  std::vector<double> times;
  for (const auto& event : exact["events"]) times.push_back(Number(event[2]));
  ExpectEvents(run, times);
  for (std::size_t i = 0; i < times.size(); ++i) {
    EXPECT_EQ(run.simulator.touches()[i].touch.candidate.a, exact["events"][i][0].get<int>());
    EXPECT_EQ(run.simulator.touches()[i].touch.candidate.b, exact["events"][i][1].get<int>());
  }
  const std::vector<double> end = run.End();
  for (int i = 0; i < 3; ++i) {
    ExpectRelative(end[4 * i], Number(exact["x"][i]), "x");
    ExpectRelative(end[4 * i + 2], Number(exact["v"][i]), "v");
  }
  for (int row = 0; row < 6; ++row) {
    const Sensitivity gradient = run.GradientOf(4 * (row % 3) + (row < 3 ? 0 : 2));
    for (int column = 0; column < 6; ++column) {
      const double actual = gradient.initial[4 * (column % 3) + (column < 3 ? 0 : 2)];
      EXPECT_NEAR(actual, Number(exact["Jac"][row][column]), 1e-12) << row << " " << column;
    }
  }
}

}  // namespace
}  // namespace saltus
