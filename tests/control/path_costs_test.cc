// Running and via terms and a free final time by single shooting: gradients and Jacobians against differences, losses
// against the exact re-simulation.
#include <gtest/gtest.h>

#include <cmath>

#include "saltus/control/single_shooting.h"
#include "saltus/simulate/exact_run.h"
#include "saltus/simulate/registry.h"
#include "test_scenes.h"

namespace saltus {
namespace {

using Quantity = TerminalTerm::Quantity;

// A disc that is pushed against another, which then strikes a wall, with gravity, friction and every kind of term.
Scene Struck() {
  Scene scene = ProblemScene("two_balls");
  scene.steps = 37;
  scene.gravity = {0.1, -0.3};
  scene.planes = {{"wall", {-0.5, -0.5}, {-1, -0.3}}};
  scene.contact.restitution = 0.8;
  scene.contact.friction = 0.2;
  scene.control.initial = {{3.3, 2.9}};
  RunningTerm track{
      .body = 0, .times = {0.1, 0.43, 0.9}, .targets = {{-2, -2}, {-1.7, -1.5}, {-1, -1.3}}, .weight = 0.7};
  RunningTerm slow{.body = 1, .quantity = Quantity::kVelocity, .times = {0.5}, .targets = {{0.3, 0.1}}, .weight = 0.2};
  RunningTerm along{
      .body = 0, .quantity = Quantity::kVelocity, .times = {0, 2}, .targets = {{0, 0}, {4, 2}}, .weight = 0.1};
  scene.objective.running = {track, slow, along};
  scene.objective.via = {{.body = 0, .time = 0.31, .target = {-1.8, -1.9}, .weight = 2},
                         {.body = 1, .time = 0.83, .quantity = Quantity::kVelocity, .target = {1, 1}, .weight = 0.5}};
  return scene;
}

SingleShooting Shooting(const Scene& scene, const std::string& contact) {
  SingleShooting::SimulatorFactory of_scene;
  if (scene.objective.duration) {
    of_scene = [=](const Scene& other) { return MakeSimulator(contact, other, Precision::kDouble); };
  }
  return SingleShooting(
      MakeSimulator(contact, scene, Precision::kDouble), SingleShooting::Variables::kOptimized, of_scene);
}

// Forces that differ from step to step.
std::vector<double> Wavy(const SingleShooting& shooting) {
  std::vector<double> z = shooting.initial_guess();
  for (size_t i = 0; i < z.size() - shooting.has_duration(); ++i) z[i] += 0.3 * std::sin(1.7 * double(i));
  return z;
}

void ExpectGradient(const Scene& scene, const std::string& contact, double tolerance) {
  SCOPED_TRACE(contact);
  constexpr double kStep = 1e-5;
  SingleShooting shooting = Shooting(scene, contact);
  std::vector<double> z = Wavy(shooting), gradient(z.size());
  double loss = 0;
  ASSERT_TRUE(shooting.Evaluate(z, &loss, gradient.data())) << shooting.FailureReason();
  double largest = 1;
  for (double g : gradient) largest = std::max(largest, std::abs(g));
  for (size_t i = 0; i < z.size(); ++i) {
    if (i % 5 != 0 && i + 1 < z.size()) continue;
    const auto at = [&](double by) {
      std::vector<double> moved = z;
      moved[i] += by;
      double there = 0;
      EXPECT_TRUE(shooting.Evaluate(moved, &there, nullptr));
      return there;
    };
    // This difference is of fourth order.
    const double slope = (8 * (at(kStep) - at(-kStep)) - (at(2 * kStep) - at(-2 * kStep))) / (12 * kStep);
    EXPECT_NEAR(gradient[i], slope, tolerance * largest) << i;
  }
}

// The residuals are those of the loss, and so are their derivatives.
void ExpectResiduals(const Scene& scene, const std::string& contact) {
  SCOPED_TRACE(contact);
  SingleShooting shooting = Shooting(scene, contact);
  const std::vector<double> z = Wavy(shooting);
  const size_t rows = shooting.num_residuals(), n = z.size();
  std::vector<double> r(rows), jacobian(rows * n), gradient(n);
  double loss = 0;
  ASSERT_TRUE(shooting.EvaluateResiduals(z, r.data(), jacobian.data())) << shooting.FailureReason();
  ASSERT_TRUE(shooting.Evaluate(z, &loss, gradient.data()));
  const size_t forces = n - shooting.has_duration();
  const bool controls = scene.optimize == Optimize::kControl;
  const double dt = shooting.simulator().step();
  double effort = 0;
  const std::vector<double> control = shooting.ControlAt(z);
  for (double u : control) effort += scene.objective.effort * dt * u * u;
  double sum = effort;
  for (double x : r) sum += x * x;
  if (shooting.has_duration()) sum += scene.objective.duration->weight * z.back();
  EXPECT_NEAR(sum, loss, 1e-12 * loss);
  for (size_t i = 0; i < n; ++i) {
    double slope = i < forces && controls ? 2 * scene.objective.effort * dt * z[i] : 0.0;
    if (i == forces) slope += scene.objective.duration->weight + effort / z.back();
    for (size_t row = 0; row < rows; ++row) slope += 2 * r[row] * jacobian[row * n + i];
    EXPECT_NEAR(slope, gradient[i], 1e-11) << i;
  }
}

TEST(PathCosts, ExactGradientIsTheDerivative) {
  ExpectGradient(Struck(), "event", 2e-9);
  Scene thrown = Struck();
  thrown.optimize = Optimize::kVelocity;
  thrown.free = {0, 1};
  ExpectGradient(thrown, "event", 2e-9);
}

TEST(PathCosts, ExactGradientByTheFinalTimeIsTheDerivative) {
  Scene scene = Struck();
  scene.objective.duration = FreeDuration{0.9, 3, 0.4};
  ExpectGradient(scene, "event", 2e-9);
}

TEST(PathCosts, GradientOfAModelsOwnStepsIsTheDerivative) {
  Scene scene = Struck();
  scene.contact.friction = 0;
  for (const char* contact : {"direct_toi", "compliant_warp", "toi_velocity"}) ExpectGradient(scene, contact, 1e-8);
  scene.optimize = Optimize::kVelocity;
  scene.free = {0};
  ExpectGradient(scene, "direct_toi", 1e-8);
}

TEST(PathCosts, ResidualsAreThoseOfTheLoss) {
  Scene scene = Struck();
  ExpectResiduals(scene, "event");
  scene.objective.duration = FreeDuration{0.9, 3, 0.4};
  ExpectResiduals(scene, "event");
  scene.objective.duration.reset();
  scene.contact.friction = 0;
  ExpectResiduals(scene, "direct_toi");
  scene.optimize = Optimize::kVelocity;
  scene.free = {0, 1};
  ExpectResiduals(scene, "event");
  ExpectResiduals(scene, "direct_toi");
}

TEST(PathCosts, ExactLossIsThatOfTheReSimulation) {
  Scene scene = Struck();
  scene.objective.duration = FreeDuration{0.9, 3, 0.4};
  SingleShooting shooting = Shooting(scene, "event");
  std::vector<double> z = Wavy(shooting);
  z.back() = 1.2;
  double loss = 0;
  ASSERT_TRUE(shooting.Evaluate(z, &loss, nullptr));
  const ExactRun run =
      SimulateExactly(scene, shooting.InitialStateAt(z), shooting.ControlAt(z), shooting.DurationsAt(z));
  ASSERT_TRUE(run.ok) << run.reason;
  EXPECT_GE(run.events.size(), 2u);
  EXPECT_NEAR(loss, run.loss, 1e-12 * loss);
}

// The trapezoidal rule on smooth flight is off by the square of the step, and the exact integral is what it tends to.
TEST(PathCosts, OwnStepsApproachTheExactIntegral) {
  Scene scene = Struck();
  scene.contact.friction = 0;
  scene.control.initial = {{0.5, -0.2}};  // meets nothing
  scene.objective.via.clear();
  scene.objective.running.resize(1);
  std::vector<double> errors;
  for (int steps : {100, 400}) {
    scene.steps = steps;
    double exact = 0, own = 0;
    SingleShooting event = Shooting(scene, "event"), other = Shooting(scene, "direct_toi");
    // The flight of the two is not the same; the loss at the end is not the subject.
    ASSERT_TRUE(event.Evaluate(event.initial_guess(), &exact, nullptr));
    ASSERT_TRUE(other.Evaluate(other.initial_guess(), &own, nullptr));
    errors.push_back(std::abs(own - exact));
  }
  EXPECT_LT(errors[0], 1e-2);
  EXPECT_GT(std::log(errors[0] / errors[1]) / std::log(4.0), 0.9);
}

TEST(PathCosts, SaysWhyAFinalTimeBeforeAViaTermIsNone) {
  Scene scene = Struck();
  scene.objective.duration = FreeDuration{0.5, 3, 0.4};
  SingleShooting shooting = Shooting(scene, "event");
  std::vector<double> z = shooting.initial_guess();
  z.back() = 0.6;
  double loss = 0;
  EXPECT_FALSE(shooting.Evaluate(z, &loss, nullptr));
  EXPECT_EQ(shooting.FailureReason(), "the final time is not after the times of all waypoint costs");
}

}  // namespace
}  // namespace saltus
