// Optimal torques, against optima known by hand and against each other; their certificates and bounds.
#include <gmock/gmock.h>

#include <Eigen/Dense>
#include <cmath>
#include <string>

#include "saltus/optimality/certificate.h"
#include "saltus/simulate/simulator.h"
#include "saltus/solve/solver.h"
#include "spin_control.h"

namespace saltus {
namespace {

using ::testing::HasSubstr;
using Quantity = TerminalTerm::Quantity;

constexpr double kRadius = 0.25, kMass = 1.5, kInertia = 0.5 * kMass * kRadius * kRadius, kTime = 1.25, kEffort = 0.3;
constexpr double kAngle = 1.5;  // rad

// A disc at rest that is to have turned by kAngle and to be at rest again.
Scene RestToRest(int steps, bool hard) {
  Scene scene;
  scene.name = "rest_to_rest";
  scene.duration = kTime;
  scene.steps = steps;
  scene.bodies = {Spinning("disc", kRadius, kMass, {0, 0}, {0, 0}, 0)};
  scene.control = {.bodies = {0}, .initial = {{0.1, 0}}, .torque_bodies = {0}, .initial_torque = {0.01}};
  scene.objective.terminal = {{.body = 0, .quantity = Quantity::kAngle, .target = {kAngle, 0}, .hard = hard},
                              {.body = 0, .quantity = Quantity::kAngularVelocity, .target = {0, 0}, .hard = hard}};
  scene.objective.effort = kEffort;
  scene.optimize = Optimize::kControl;
  return scene;
}

double TorqueOf(const Scene& scene, const SolveReport& report, int k, int t = 0) {
  return report.solution.control[scene.TorqueIndex(k, t)] * scene.bodies[scene.control.torque_bodies[t]].radius;
}

// In continuous time 6 I d / T^2 (1 - 2 t / T), at the cost 12 I^2 d^2 / (T^3 r^2); in N equal intervals by 1 / (1 -
// 1/N^2) more.
TEST(TorqueControl, TurnsFromRestToRest) {
  for (const int steps : {8, 40}) {
    const Scene scene = RestToRest(steps, /*hard=*/true);
    const SolveReport report = Solve("ceres_phases", {scene, "event"}, {});
    ASSERT_EQ(report.termination, Termination::kConverged) << report.reason;
    const double more = 1 / (1 - 1.0 / (steps * steps)), most = 6 * kInertia * kAngle / (kTime * kTime) * more;
    for (int k = 0; k < steps; ++k) {
      EXPECT_NEAR(TorqueOf(scene, report, k), most * (1 - 2 * (k + 0.5) / steps), 1e-8 * most) << k;
      EXPECT_NEAR(report.solution.control[scene.ForceIndex(k, 0)], 0, 1e-6 * most / kRadius);
    }
    const double cost = 12 * std::pow(kInertia * kAngle / kRadius, 2) / std::pow(kTime, 3) * kEffort * more;
    EXPECT_NEAR(report.solution.loss, cost, 1e-8 * cost);
    ASSERT_TRUE(report.certificate);
    EXPECT_EQ(report.certificate->verdict, Certificate::Verdict::kStationary) << report.certificate->reason;
    // The loss is the effort alone, and the motion is linear in the torques.
    ASSERT_TRUE(report.certificate->curvature) << report.certificate->reason;
    EXPECT_EQ(report.certificate->curvature->kind, Curvature::Kind::kMinimum);
    EXPECT_NEAR(report.certificate->curvature->smallest, 1, 1e-9);
    // The loss falls by multiplier . d if the target moves by d.
    ASSERT_EQ(report.certificate->constraints.size(), 2u);
    EXPECT_NEAR(std::abs(report.certificate->constraints[0].multiplier[0]), 2 * cost / kAngle, 1e-6 * cost);

    std::vector<double> other = report.solution.control;
    other[scene.TorqueIndex(1, 0)] *= 1.01;
    EXPECT_EQ(Certify(scene, InitialState(scene), other, report.solution.durations).verdict,
              Certificate::Verdict::kNotStationary);
  }
}

// With terms that are not hard the torque is linear in time too: u = -(lambda_angle (T - t) + lambda_w) r^2 / (2 effort
// I), of the two numbers at the end a linear system.
TEST(TorqueControl, SolversFindWhatALinearSystemSays) {
  constexpr int kSteps = 20;
  Scene scene = RestToRest(kSteps, /*hard=*/false);
  scene.objective.terminal[0].weight = 3;
  scene.objective.terminal[1].weight = 0.5;
  const double h = kTime / kSteps, gain = -kRadius * kRadius / (2 * kEffort * kInertia);
  Eigen::Matrix2d system = Eigen::Matrix2d::Identity();
  Eigen::Vector2d given = Eigen::Vector2d::Zero();
  const Eigen::Vector2d slope(2 * 3, 2 * 0.5), target(kAngle, 0);
  for (int k = 0; k < kSteps; ++k) {
    const Eigen::Vector2d by(h * (kTime - (k + 0.5) * h) / kInertia, h / kInertia);  // of the end by torque k
    const Eigen::RowVector2d torque(gain * kInertia / h * by.cwiseProduct(slope).transpose());  // by the end
    system -= by * torque;
    given -= by * torque.dot(target);
  }
  const Eigen::Vector2d end = system.inverse() * given;
  for (const char* solver :
       {"ceres_lm", "ceres_lbfgs", "ceres_shooting", "ceres_lagrangian", "ceres_phases", "mode_search"}) {
    const SolveReport report = Solve(solver, {scene, "event"}, {});
    ASSERT_EQ(report.termination, Termination::kConverged) << solver << ": " << report.reason;
    for (int k = 0; k < kSteps; ++k) {
      const double lambda = slope[0] * (end[0] - kAngle) * (kTime - (k + 0.5) * h) + slope[1] * end[1];
      EXPECT_NEAR(TorqueOf(scene, report, k), gain * lambda, 2e-5) << solver << " " << k;
    }
  }
}

// A bound cuts the line off, and is met exactly.
TEST(TorqueControl, KeepsBounds) {
  Scene scene = RestToRest(20, /*hard=*/false);
  scene.objective.terminal[0].weight = 3;
  scene.objective.terminal[1].weight = 0.5;
  const double free = TorqueOf(scene, Solve("ceres_lm", {scene, "event"}, {}), 0);
  scene.control.max_torque = {0.6 * free};
  const SolveReport phases = Solve("ceres_phases", {scene, "event"}, {});
  ASSERT_EQ(phases.termination, Termination::kConverged) << phases.reason;
  ASSERT_TRUE(phases.certificate);
  EXPECT_EQ(phases.certificate->verdict, Certificate::Verdict::kStationary) << phases.certificate->reason;
  for (const char* solver : {"ceres_lm", "gd", "ceres_phases"}) {
    SolverOptions options;
    options.descent.learning_rate = 0.1;
    options.limits.iterations = 3000;
    const SolveReport report = Solve(solver, {scene, "event"}, options);
    int at_bound = 0;
    for (int k = 0; k < scene.steps; ++k) {
      EXPECT_LE(std::abs(TorqueOf(scene, report, k)), 0.6 * free * (1 + 1e-12)) << solver;
      at_bound += std::abs(TorqueOf(scene, report, k)) > 0.6 * free * (1 - 1e-9);
    }
    EXPECT_GE(at_bound, 4) << solver;
    // Steps of ceres_lm may end early at bounds.
    const double slack = solver == std::string("ceres_lm") ? 0.1 : 1e-4;
    EXPECT_NEAR(report.solution.loss, phases.solution.loss, slack * phases.solution.loss) << solver;
  }
  EXPECT_THAT(Solve("ceres_lbfgs", {scene, "event"}, {}).reason, HasSubstr("bounds on the control"));
}

// A disc that the wall spins is helped by a torque: solvers agree, and the exact loss does not fall along any change of
// the control.
TEST(TorqueControl, HelpsThroughAnImpact) {
  Scene scene = SpinControl(40);
  const double without = Solve("ceres_phases", {scene, "event"}, {}).solution.loss;
  scene.control.torque_bodies = {0};
  scene.control.initial_torque = {0};
  const SolveReport report = Solve("ceres_phases", {scene, "event"}, {});
  ASSERT_EQ(report.termination, Termination::kConverged) << report.reason;
  EXPECT_LT(report.solution.loss, 0.9 * without);
  ASSERT_TRUE(report.certificate);
  EXPECT_EQ(report.certificate->verdict, Certificate::Verdict::kStationary) << report.certificate->reason;
  ASSERT_EQ(report.certificate->impacts.size(), 1u);
  const SolveReport shooting = Solve("ceres_lm", {scene, "event"}, {});
  EXPECT_NEAR(shooting.solution.loss, report.solution.loss, 1e-2 * report.solution.loss);
  // Under the steps of another model, between exact impacts.
  const SolveReport stepped = Solve("ceres_phases", {scene, "compliant_warp"}, {});
  EXPECT_EQ(stepped.termination, Termination::kConverged) << stepped.reason;
  EXPECT_NEAR(stepped.solution.loss, report.solution.loss, 0.1 * report.solution.loss);
}

TEST(TorqueControl, SolversByClosedArcsRefuse) {
  const Scene scene = RestToRest(20, /*hard=*/false);
  for (const char* solver : {"ceres_event", "hmp"}) {
    const SolveReport report = Solve(solver, {scene, "event"}, {});
    EXPECT_EQ(report.termination, Termination::kNotApplicable) << solver;
    EXPECT_THAT(report.reason, HasSubstr("discs that spin")) << solver;
  }
}

// Half the change of an angle is kept as a sine there.
TEST(TorqueControl, PhasesRefuseAModelThatTurnsOtherThanLinearly) {
  const SolveReport report = Solve("ceres_phases", {RestToRest(20, /*hard=*/false), "pbd_brax"}, {});
  EXPECT_EQ(report.termination, Termination::kNotApplicable);
  EXPECT_THAT(report.reason, HasSubstr("does not change rotations linearly"));
}

}  // namespace
}  // namespace saltus
