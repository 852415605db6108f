#include "exact/closed_forms.h"

#include <gtest/gtest.h>

#include <functional>

#include "exact/exact_scenes.h"
#include "parameter_name.h"

namespace saltus {
namespace {

using namespace exact_test;

void ExpectVector(const Vec2d& actual, const Vec2d& expected) {
  EXPECT_LT((actual - expected).norm(), kTolerance * std::max(1e-3, expected.norm()))
      << actual.transpose() << " is not " << expected.transpose();
}

ClosedForm Evaluate(const Scene& scene) {
  std::string reason_not_applicable;
  const std::optional<ClosedForm> form = EvaluateClosedForm(scene, &reason_not_applicable);
  EXPECT_TRUE(form) << reason_not_applicable;
  return form.value_or(ClosedForm());
}

// Every component of the gradient by initial state, restitution and friction against differences of the loss.
void ExpectGradientOfLoss(const Scene& scene, bool two_sided_friction, double tolerance = 2e-9) {
  const ClosedForm form = Evaluate(scene);
  const auto difference = [&](const std::function<void(Scene*, double)>& change) {
    return Richardson(
        [&](double h) {
          Scene changed = scene;
          change(&changed, h);
          return Evaluate(changed).loss;
        },
        1e-3);
  };
  for (int i = 0; i < scene.num_bodies(); ++i) {
    for (int c = 0; c < 2; ++c) {
      EXPECT_NEAR(form.gradient.position[i][c],
                  difference([&](Scene* s, double h) { s->bodies[i].position[c] += h; }),
                  tolerance);
      EXPECT_NEAR(form.gradient.velocity[i][c],
                  difference([&](Scene* s, double h) { s->bodies[i].velocity[c] += h; }),
                  tolerance);
    }
  }
  EXPECT_NEAR(
      form.gradient.restitution, difference([](Scene* s, double h) { s->contact.restitution += h; }), tolerance);
  if (two_sided_friction) {
    EXPECT_NEAR(form.gradient.friction, difference([](Scene* s, double h) { s->contact.friction += h; }), tolerance);
  }
}

// A constant force for the whole time is a sum over the steps.
void ExpectControlGradientSum(const Scene& scene, double tolerance = 2e-9) {
  const ClosedForm form = Evaluate(scene);
  for (int c = 0; c < 2; ++c) {
    double sum = 0;
    for (const auto& step : form.gradient.control) sum += step[0][c];
    const double difference = Richardson(
        [&](double h) {
          Scene changed = scene;
          changed.control.initial[0][c] += h;
          return Evaluate(changed).loss;
        },
        1e-3);
    EXPECT_NEAR(sum, difference, tolerance);
  }
}

TEST(BounceOnceTest, EqualsReference) {
  const ClosedForm form = Evaluate(BounceOnce());
  const auto& reference = References()["task1"];
  EXPECT_EQ(form.family, "disc among planes");
  EXPECT_RELATIVE(form.loss, Number(reference["height_T"]));
  ASSERT_EQ(form.events.size(), 1u);
  EXPECT_RELATIVE(form.events[0].time, Number(reference["impact_time"]));
  EXPECT_EQ(form.events[0].a, "ball");
  EXPECT_EQ(form.events[0].b, "ground");
  EXPECT_RELATIVE(form.gradient.position[0].y(), Number(reference["dp"]));
  EXPECT_RELATIVE(form.gradient.velocity[0].y(), Number(reference["dv"]));
  EXPECT_EQ(form.gradient.position[0].x(), 0);
  EXPECT_RELATIVE(form.gradient.control[0][0].y(), Number(reference["du0"]));
  EXPECT_RELATIVE(form.gradient.control[0][0].y(), -959.0 / 460800);
}

TEST(BounceOnceTest, ControlGradientChangesSignAtTheNodeOfTheImpact) {
  const Scene scene = BounceOnce();
  const ClosedForm form = Evaluate(scene);
  ASSERT_EQ(form.gradient.control.size(), 480u);
  for (int k = 0; k < 480; ++k) {
    const double expected = (k < 216 ? -1 : 1) * scene.dt() * (1 - (k + 0.5) * scene.dt());
    EXPECT_NEAR(form.gradient.control[k][0].y(), expected, 1e-15) << k;
  }
}

TEST(BounceOnceTest, GradientIsThatOfTheLoss) {
  Scene scene = BounceOnce();
  scene.contact.restitution = 0.8;
  scene.contact.friction = 0.1;
  scene.gravity = {0.3, -1};
  scene.bodies[0].mass = 2;
  scene.control.initial[0] = {1, 0.5};
  scene.objective.effort = 0.05;
  scene.objective.terminal = {ReachTerm(0, {1, 1})};
  scene.objective.terminal.push_back(scene.objective.terminal[0]);
  scene.objective.terminal[1].quantity = TerminalTerm::Quantity::kVelocity;
  ASSERT_EQ(Evaluate(scene).events.size(), 1u);
  ASSERT_EQ(Evaluate(scene).events[0].mode, ExactEvent::Mode::kSlip);
  ExpectGradientOfLoss(scene, true);
  ExpectControlGradientSum(scene);
  scene.contact.friction = 3;
  ASSERT_EQ(Evaluate(scene).events[0].mode, ExactEvent::Mode::kStick);
  ExpectGradientOfLoss(scene, true);
  ExpectControlGradientSum(scene);
}

TEST(BounceOnceTest, ManyBouncesEqualReference) {
  Scene scene = BounceOnce();
  scene.duration = 2;
  scene.gravity = {0, -9.8};
  scene.contact.restitution = 0.8;
  scene.bodies[0].position = {0, 1};
  scene.bodies[0].velocity = {0, 0.5};
  const auto& reference = References()["extra"]["X1"];
  for (const bool velocity : {false, true}) {
    if (velocity) scene.objective.terminal[0].quantity = TerminalTerm::Quantity::kVelocity;
    const ClosedForm form = Evaluate(scene);
    const auto& derivatives = reference[velocity ? "dv" : "dy"];
    EXPECT_RELATIVE(form.loss, Number(reference[velocity ? "v" : "y"]));
    EXPECT_RELATIVE(form.gradient.position[0].y(), Number(derivatives[0]));
    EXPECT_RELATIVE(form.gradient.velocity[0].y(), Number(derivatives[1]));
    EXPECT_RELATIVE(form.gradient.restitution, Number(derivatives[2]));
    // A constant force on a unit mass is a change of gravity.
    double by_gravity = 0;
    for (const auto& step : form.gradient.control) by_gravity -= step[0].y();
    EXPECT_RELATIVE(by_gravity, Number(derivatives[3]));
    ASSERT_EQ(form.events.size(), 3u);
    for (int i = 0; i < 3; ++i) EXPECT_RELATIVE(form.events[i].time, Number(reference["impacts"][i]));
  }
}

class GroundWallTest : public ::testing::TestWithParam<double> {};

TEST_P(GroundWallTest, EqualsReference) {
  const bool slips = GetParam() > 0;
  const ClosedForm form = Evaluate(GroundWall(GetParam()));
  const auto& reference = References()["task2"][slips ? "mu0.1" : "frictionless"];
  EXPECT_RELATIVE(form.loss, Number(reference["loss"]));
  ExpectVector(form.position[0], Vector(reference["p_T"]));
  ExpectVector(form.velocity[0], Vector(reference["v_T"]));
  const auto& gradient = reference["grad_px_py_vx_vy"];
  EXPECT_RELATIVE(form.gradient.position[0].x(), Number(gradient[0]));
  EXPECT_RELATIVE(form.gradient.position[0].y(), Number(gradient[1]));
  EXPECT_RELATIVE(form.gradient.velocity[0].x(), Number(gradient[2]));
  EXPECT_RELATIVE(form.gradient.velocity[0].y(), Number(gradient[3]));
  EXPECT_TRUE(form.gradient.control.empty());
  ASSERT_EQ(form.events.size(), reference["events"].size());
  for (size_t i = 0; i < form.events.size(); ++i) {
    EXPECT_EQ(form.events[i].b, reference["events"][i]["plane"].get<std::string>());
    EXPECT_RELATIVE(form.events[i].time, Number(reference["events"][i]["time"]));
    EXPECT_EQ(form.events[i].mode, slips ? ExactEvent::Mode::kSlip : ExactEvent::Mode::kFrictionless);
  }
}

TEST_P(GroundWallTest, GradientIsThatOfTheLoss) { ExpectGradientOfLoss(GroundWall(GetParam()), GetParam() > 0, 1e-7); }

// The learning curve of gradient descent at a rate of 0.01.
TEST_P(GroundWallTest, GradientDescentEqualsReference) {
  const auto& reference = References()["exact_gradient_descent"][GetParam() > 0 ? "task2_mu0.1" : "task2_mu0"];
  Scene scene = GroundWall(GetParam());
  std::vector<double> losses;
  for (int i = 0; i < 1000; ++i) {
    const ClosedForm form = Evaluate(scene);
    losses.push_back(form.loss);
    scene.bodies[0].velocity -= 0.01 * form.gradient.velocity[0];
  }
  const auto& expected = reference["losses_at_0_1_10_100_999"];
  const int at[] = {0, 1, 10, 100, 999};
  for (int i = 0; i < 5; ++i) EXPECT_RELATIVE(losses[at[i]], Number(expected[i]));
  ExpectVector(scene.bodies[0].velocity, Vector(reference["velocity_1000"]));
  EXPECT_NEAR(Evaluate(scene).loss, Number(reference["loss_1000"]), 1e-12);
}

INSTANTIATE_TEST_SUITE_P(Friction, GroundWallTest, ::testing::Values(0.0, 0.1), ParameterName());

TEST(TwoBallsTest, EqualsReference) {
  const ClosedForm form = Evaluate(TwoBalls());
  const auto& reference = References()["task3_gradients_N480"];
  EXPECT_EQ(form.family, "two discs");
  EXPECT_RELATIVE(form.loss, Number(reference["loss"]));
  EXPECT_RELATIVE(form.terminal, Number(reference["terminal"]));
  EXPECT_RELATIVE(form.running, Number(reference["running"]));
  ASSERT_EQ(form.events.size(), 1u);
  EXPECT_RELATIVE(form.events[0].time, Number(reference["s"]));
  EXPECT_EQ(form.events[0].a, "striker");
  EXPECT_EQ(form.events[0].b, "target");
  EXPECT_EQ(form.events[0].mode, ExactEvent::Mode::kFrictionless);
  for (int c = 0; c < 2; ++c) {
    EXPECT_RELATIVE(form.position[1][c], Number(reference["x2T"]));
    EXPECT_RELATIVE(form.gradient.position[0][c], Number(reference["dp1"]));
    EXPECT_RELATIVE(form.gradient.position[1][c], Number(reference["dp2"]));
    EXPECT_RELATIVE(form.gradient.velocity[0][c], Number(reference["dv1"]));
    EXPECT_RELATIVE(form.gradient.velocity[1][c], Number(reference["dv2"]));
    EXPECT_RELATIVE(form.gradient.control[0][0][c], Number(reference["du0_analytic_correct"]));
    for (const int k : {100, 200, 330, 331, 332, 400}) {
      const std::string key = "du" + std::to_string(k);
      EXPECT_RELATIVE(form.gradient.control[k][0][c], Number(reference[key + "_correct"]));
      EXPECT_NEAR(
          form.gradient.control[k][0][c] - Number(reference["run_correct"]), Number(reference[key + "_term"]), 1e-15);
    }
  }
}

TEST(TwoBallsTest, OtherStepCount) {
  EXPECT_RELATIVE(Evaluate(TwoBalls(240)).gradient.control[0][0].x(),
                  Number(References()["task3_du0_N240"]["du0_analytic_correct"]));
}

TEST(TwoBallsTest, GradientIsThatOfTheLoss) {
  Scene scene = TwoBalls();
  scene.contact.restitution = 0.95;  // above 1 there is none
  ExpectGradientOfLoss(scene, false, 1e-7);
  ExpectControlGradientSum(scene);
}

TEST(TwoBallsTest, GradientIsThatOfTheLossInGeneralPosition) {
  Scene scene = TwoBalls(50);
  scene.bodies[0].mass = 2;
  scene.bodies[0].velocity = {2.5, 2};
  scene.bodies[0].position = {-2, -1.9};
  scene.bodies[1].velocity = {0.3, -0.2};
  scene.bodies[1].radius = 0.3;
  scene.gravity = {0, -1};
  scene.contact.restitution = 0.7;
  for (const double friction : {0.02, 5.0}) {
    scene.contact.friction = friction;
    ASSERT_EQ(Evaluate(scene).events.size(), 1u);
    EXPECT_EQ(Evaluate(scene).events[0].mode, friction < 1 ? ExactEvent::Mode::kSlip : ExactEvent::Mode::kStick);
    ExpectGradientOfLoss(scene, true, 1e-7);
    ExpectControlGradientSum(scene, 1e-7);
  }
}

// The follow-up paper's first problem: head-on, but not towards the target.
TEST(TwoBallsTest, SingleCollisionEqualsReference) {
  const ClosedForm form = Evaluate(SingleCollision());
  const auto& reference = References()["followup_initial_gradients"]["single"];
  EXPECT_RELATIVE(form.loss, Number(reference["loss"]));
  EXPECT_RELATIVE(form.events.at(0).time, Number(reference["events"][0]["time"]));
  for (int i = 0; i < 2; ++i) {
    ExpectVector(form.gradient.position[i], {Number(reference["dp"][2 * i]), Number(reference["dp"][2 * i + 1])});
    ExpectVector(form.gradient.velocity[i], {Number(reference["dv"][2 * i]), Number(reference["dv"][2 * i + 1])});
  }
  ASSERT_EQ(form.gradient.control.size(), reference["du"].size());
  for (size_t k = 0; k < form.gradient.control.size(); ++k) {
    ExpectVector(form.gradient.control[k][0], Vector(reference["du"][k]));
  }
}

TEST(TwoBallsTest, NoCollision) {
  Scene scene = TwoBalls();
  scene.control.initial[0] = {0, 0};
  const ClosedForm form = Evaluate(scene);
  EXPECT_TRUE(form.events.empty());
  EXPECT_DOUBLE_EQ(form.loss, 2);
  ExpectVector(form.gradient.position[1], {-2, -2});
  ExpectVector(form.gradient.position[0], {0, 0});
}

void ExpectRefusal(const Scene& scene, const std::string& reason) {
  std::string reason_not_applicable;
  EXPECT_FALSE(EvaluateClosedForm(scene, &reason_not_applicable));
  EXPECT_NE(reason_not_applicable.find(reason), std::string::npos) << reason_not_applicable;
}

TEST(ClosedFormRefusalTest, OtherFamilies) {
  ExpectRefusal(MultipleCollisions(), "neither one disc among planes nor two discs alone");
  Scene fixed = TwoBalls();
  fixed.bodies[1].fixed = true;
  ExpectRefusal(fixed, "fixed");
}

TEST(ClosedFormRefusalTest, OtherTermsThanTerminalCostsAndEffort) {
  Scene waypoint = TwoBalls();
  waypoint.objective.via = {{.body = 0, .time = 0.5}};
  ExpectRefusal(waypoint, "waypoint costs");
  Scene constrained = TwoBalls();
  constrained.objective.terminal[0].hard = true;
  ExpectRefusal(constrained, "terminal equality constraints");
  Scene free = TwoBalls();
  free.objective.duration = FreeDuration{.min = 0.5, .max = 2, .weight = 0.5};
  ExpectRefusal(free, "a free duration");
  Scene bounded = TwoBalls();  // the loss does not depend on bounds
  bounded.control.max = {5};
  EXPECT_DOUBLE_EQ(Evaluate(bounded).loss, Evaluate(TwoBalls()).loss);
}

TEST(ClosedFormRefusalTest, UnassumedCollisions) {
  Scene twice = TwoBalls();
  twice.duration = 3;
  ExpectRefusal(twice, "twice");
  Scene resting = BounceOnce();
  resting.gravity = {0, -9.8};
  resting.bodies[0].position.y() = 0.1;
  resting.bodies[0].velocity.y() = 0;
  ExpectRefusal(resting, "rests");
  Scene corner = BounceOnce();
  corner.bodies[0] = Disc("ball", 0.1, {1, 1}, {2, -2});
  corner.planes.push_back({"wall", {2, 0}, {-1, 0}});
  ExpectRefusal(corner, "two planes");
  Scene zeno = BounceOnce();
  zeno.gravity = {0, -9.8};
  zeno.contact.restitution = 0.5;
  zeno.duration = 10;
  ExpectRefusal(zeno, "plane");
}

}  // namespace
}  // namespace saltus
