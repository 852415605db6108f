// Torques on discs that spin: motion in closed form, and derivatives by them against differences, of every contact
// model that takes discs that spin.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <memory>
#include <string>
#include <vector>

#include "saltus/simulate/registry.h"
#include "saltus/simulate/simulator.h"
#include "spinning_disc.h"

namespace saltus {
namespace {

constexpr double kHigh = 50;  // m, from which nothing is felt of the ground
constexpr double kRadius = 0.2, kMass = 1.5, kInertia = 0.5 * kMass * kRadius * kRadius;

// A disc that flies above the ground, meets it slowly, or lies on it, pushed and turned.
Scene Turned(double height, double friction, int steps = 60) {
  Scene scene;
  scene.name = "turned";
  scene.duration = 0.5;
  scene.steps = steps;
  scene.bodies = {Spinning("b", 0.3, 3, {4, 4}, {0, 0}, 1),
                  Spinning("a", kRadius, kMass, {0, kRadius + height}, {0.5, -2}, 4)};
  scene.planes = {{"ground", {0, 0}, {0, 1}}};
  scene.contact = {.restitution = 0.6, .friction = friction, .stiffness = 1e4, .damping = 0};
  scene.control = {
      .bodies = {0, 1}, .initial = {{0.1, 0.2}, {0.3, -0.4}}, .torque_bodies = {1}, .initial_torque = {0.05}};
  return scene;
}

std::vector<double> VaryingControl(const Simulator& simulator) {
  std::vector<double> control = InitialControl(simulator.scene(), simulator.num_steps());
  for (size_t i = 0; i < control.size(); ++i) control[i] *= 1 + 0.5 * std::sin(1.0 + 7.0 * static_cast<double>(i));
  return control;
}

class EveryModelThatTurns : public testing::TestWithParam<std::string> {
 protected:
  const ModelTraits& traits() const { return *FindContactModel(GetParam()); }
  double Friction() const { return traits().friction ? 0.2 : 0.0; }
  std::unique_ptr<Simulator> Make(const Scene& scene) const {
    EXPECT_EQ(ReasonNotApplicable(GetParam(), scene), "");
    return MakeSimulator(GetParam(), scene, Precision::kDouble);
  }
};

std::vector<double> EndOf(Simulator* simulator, const std::vector<double>& control) {
  EXPECT_TRUE(simulator->Rollout(InitialState(simulator->scene()), control)) << simulator->FailureReason();
  std::vector<double> end(simulator->state_size());
  simulator->GetState(simulator->num_steps(), end);
  return end;
}

// torque = I dw/dt, whatever else happens.
TEST_P(EveryModelThatTurns, TorqueChangesTheAngularVelocity) {
  const Scene scene = Turned(kHigh, Friction());
  const std::unique_ptr<Simulator> simulator = Make(scene);
  const std::vector<double> end = EndOf(simulator.get(), InitialControl(scene, simulator->num_steps()));
  ASSERT_TRUE(simulator->touches().empty() || traits().push_gap > kHigh);
  // Brax takes spins from the sines of angles; what pushes at any distance is felt there.
  const double slack = traits().spins && traits().projects ? 0.05 : traits().push_gap > kHigh ? 1e-6 : 1e-9;
  EXPECT_NEAR(end[6 + 5], 4 + 0.05 / kInertia * 0.5, slack);
  const double h = simulator->step();
  EXPECT_NEAR(end[6 + 4], 4 * 0.5 + 0.5 * 0.05 / kInertia * 0.25, 0.05 / kInertia * 0.5 * h + slack);
  EXPECT_NEAR(end[5], 1, slack);
}

// By adjoints, in flight and through contact, what differences of the rollout say; of models whose derivative is
// another by their source, in flight only.
TEST_P(EveryModelThatTurns, GradientByTorqueIsThatOfDifferences) {
  for (const double height : {kHigh, 0.3}) {
    if (height < 1 && (traits().published_jacobian || traits().accuracy > 0)) continue;
    const Scene scene = Turned(height, Friction());
    const std::unique_ptr<Simulator> simulator = Make(scene);
    const std::vector<double> control = VaryingControl(*simulator);
    EndOf(simulator.get(), control);
    EXPECT_EQ(simulator->touches().empty(), height > std::max(1.0, traits().push_gap));
    std::vector<double> cotangent(simulator->state_size());
    for (size_t i = 6; i < cotangent.size(); ++i) cotangent[i] = 0.3 + std::cos(3.0 * static_cast<double>(i));
    Sensitivity gradient;
    simulator->Adjoint(cotangent, /*with_parameters=*/true, &gradient);
    const auto loss = [&](const std::vector<double>& u) {
      const std::vector<double> end = EndOf(simulator.get(), u);
      double sum = 0;
      for (size_t i = 0; i < end.size(); ++i) sum += cotangent[i] * end[i];
      return sum;
    };
    for (const int k : {0, simulator->num_steps() / 3, simulator->num_steps() - 1}) {
      const size_t at = scene.TorqueIndex(k, 0);
      std::vector<double> more = control, less = control;
      const double width = 1e-4;
      more[at] += width;
      less[at] -= width;
      const double difference = (loss(more) - loss(less)) / (2 * width);
      EXPECT_NEAR(gradient.control[at], difference, 1e-5 * (std::abs(difference) + simulator->step()))
          << height << " " << k;
    }
    if (height < 1) continue;
    // By the moment of inertia, through the torque.
    Scene heavier = scene, lighter = scene;
    const double width = 1e-5 * kInertia;
    heavier.bodies[1].inertia = {Inertia::Kind::kGiven, kInertia + width};
    lighter.bodies[1].inertia = {Inertia::Kind::kGiven, kInertia - width};
    double difference = 0;
    for (const auto& [other, sign] : {std::pair(&heavier, 1.0), std::pair(&lighter, -1.0)}) {
      const std::unique_ptr<Simulator> changed = Make(*other);
      const std::vector<double> end = EndOf(changed.get(), control);
      for (size_t i = 0; i < end.size(); ++i) difference += sign * cotangent[i] * end[i] / (2 * width);
    }
    EXPECT_NEAR(gradient.parameters.inertia[1], difference, 1e-5 * std::abs(difference));
  }
}

// The linearizations of all steps, one after the other, are the adjoint.
TEST_P(EveryModelThatTurns, LinearizationsAreTheAdjoint) {
  const Scene scene = Turned(0.3, Friction());
  const std::unique_ptr<Simulator> simulator = Make(scene);
  const std::vector<double> control = VaryingControl(*simulator);
  EndOf(simulator.get(), control);
  ASSERT_FALSE(simulator->touches().empty());
  Eigen::VectorXd lambda = Eigen::VectorXd::LinSpaced(simulator->state_size(), -1, 1.7);
  Sensitivity gradient;
  simulator->Adjoint({lambda.data(), static_cast<size_t>(lambda.size())}, /*with_parameters=*/false, &gradient);
  std::vector<double> x(simulator->state_size()), force(simulator->force_size()), row(simulator->control_width());
  ASSERT_EQ(force.size(), 6u);
  for (int k = simulator->num_steps() - 1; k >= 0; --k) {
    simulator->GetState(k, x);
    simulator->ExpandForce(control, k, force);
    StepLinearization linearization;
    simulator->Linearize(x, force, /*with_parameters=*/false, &linearization);
    Eigen::MatrixXd A, B;
    linearization.ToDense(&A, &B);
    const Eigen::VectorXd by_force = B.transpose() * lambda;
    simulator->SelectControl({by_force.data(), force.size()}, row);
    for (size_t i = 0; i < row.size(); ++i) {
      const double expected = row[i];
      EXPECT_NEAR(gradient.control[scene.ForceIndex(k, 0) + i], expected, 1e-9 * (std::abs(expected) + 1e-2)) << k;
    }
    // Forwards it is the same map.
    Eigen::VectorXd next(A.rows());
    const Eigen::VectorXd dx = Eigen::VectorXd::LinSpaced(A.cols(), 0.3, -1), du = Eigen::VectorXd::LinSpaced(6, 1, 2);
    linearization.Apply({dx.data(), x.size()}, {du.data(), force.size()}, {next.data(), x.size()});
    EXPECT_LT((next - A * dx - B * du).norm(), 1e-9 * next.norm());
    lambda = (A.transpose() * lambda).eval();
  }
}

std::vector<std::string> ModelsThatTurn() {
  std::vector<std::string> names;
  for (const ModelTraits& model : AllContactModels()) {
    if (ReasonNotApplicable(model.name, Turned(kHigh, model.friction ? 0.2 : 0)).empty())
      names.emplace_back(model.name);
  }
  return names;
}

INSTANTIATE_TEST_SUITE_P(All, EveryModelThatTurns, testing::ValuesIn(ModelsThatTurn()),
                         [](const auto& instance) { return instance.param; });

TEST(Torque, AllModelsButOneTakeIt) { EXPECT_EQ(ModelsThatTurn().size() + 1, AllContactModels().size()); }

TEST(Torque, TurnsADiscInFreeFlightExactly) {
  const Scene scene = Turned(kHigh, 0.2, 7);
  const std::unique_ptr<Simulator> simulator = MakeSimulator("event", scene, Precision::kDouble);
  const std::vector<double> end = EndOf(simulator.get(), InitialControl(scene, 7));
  EXPECT_NEAR(end[6 + 5], 4 + 0.05 / kInertia * 0.5, 1e-14 * 5);
  EXPECT_NEAR(end[6 + 4], 4 * 0.5 + 0.5 * 0.05 / kInertia * 0.25, 1e-14 * 3);
}

// A disc at rest on the ground that a torque drives: a = -tau / (r (m + I / r^2)), counter-clockwise to the left, as
// long as the friction that it needs is there; beyond that it slides, a = -mu g.
TEST(Torque, DrivesARollingDisc) {
  for (const double torque : {0.4, -0.4, 3.0}) {
    Scene scene = Turned(0, /*friction=*/0.4, 10);
    scene.gravity = {0, -9.81};
    scene.bodies[1].velocity = {0, 0};
    scene.bodies[1].angular_velocity = 0;
    scene.control.initial = {{0, 0}, {0, 0}};
    scene.control.initial_torque = {torque};
    const std::unique_ptr<Simulator> simulator = MakeSimulator("event", scene, Precision::kDouble);
    const std::vector<double> control = InitialControl(scene, 10), end = EndOf(simulator.get(), control);
    const double rolling = -torque / (kRadius * (kMass + kInertia / (kRadius * kRadius))), sliding = -0.4 * 9.81;
    const bool rolls = std::abs(rolling) <= 0.4 * 9.81;
    EXPECT_EQ(rolls, std::abs(torque) < 1);
    const double a = rolls ? rolling : sliding, f = kMass * a;
    EXPECT_NEAR(end[6 + 2], 0.5 * a, 1e-9);
    EXPECT_NEAR(end[6], 0.125 * a, 1e-9);
    EXPECT_NEAR(end[6 + 5], 0.5 * (torque + kRadius * f) / kInertia, 1e-8);
    // By the torque of the first step: that of the formula.
    std::vector<double> cotangent(12, 0.0);
    cotangent[6 + 2] = 1;
    Sensitivity gradient;
    simulator->Adjoint(cotangent, /*with_parameters=*/false, &gradient);
    const double slope = rolls ? 0.05 * rolling / torque * kRadius : 0;
    EXPECT_NEAR(gradient.control[scene.TorqueIndex(0, 0)], slope, 1e-9);
  }
}

}  // namespace
}  // namespace saltus
