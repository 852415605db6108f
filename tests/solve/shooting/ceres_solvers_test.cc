// All solvers on a problem without contact, against its KKT solution; those by Ceres on the tasks; how they end.
#include <gmock/gmock.h>

#include <Eigen/Dense>
#include <cmath>

#include "base/linear_algebra.h"
#include "parameter_name.h"
#include "saltus/control/single_shooting.h"
#include "saltus/simulate/registry.h"
#include "saltus/solve/solver.h"
#include "test_scenes.h"

namespace saltus {
namespace {

using testing::HasSubstr;

constexpr int kSteps = 24;

// One disc under gravity, pushed towards a position and a velocity; a second one that nothing touches.
Scene LinearQuadraticScene() {
  Scene scene;
  scene.name = "flight";
  scene.duration = 0.8;
  scene.steps = kSteps;
  scene.gravity = {0.3, -2};
  scene.bodies = {{.name = "ball", .radius = 0.1, .mass = 1.7, .position = {1, 2}, .velocity = {-0.4, 0.9}},
                  {.name = "other", .radius = 0.1, .position = {50, 0}}};
  scene.control = {{0}, {{1, -1}}};
  scene.objective.terminal = {
      {.body = 0, .quantity = TerminalTerm::Quantity::kPosition, .target = {2, 1}, .weight = 5},
      {.body = 0, .quantity = TerminalTerm::Quantity::kVelocity, .target = {0.5, -0.2}, .weight = 0.7}};
  scene.objective.effort = 0.3;
  scene.optimize = Optimize::kControl;
  return scene;
}

struct Optimum {
  Eigen::VectorXd control;
  double loss;
};

// Per axis: minimize w_p (p_K - p*)^2 + w_v (v_K - v*)^2 + effort dt sum u^2, subject to v' = v + h (u/m + g) and
// p' = p + h v' (or p' = p + h v, if explicit). Unknowns: u_0..u_{K-1}, then p_1, v_1, ..., p_K, v_K, then multipliers.
Optimum SolveKkt(const Scene& scene, int num_steps, bool explicit_position) {
  const int n = 3 * num_steps, constraints = 2 * num_steps;
  const double h = scene.duration / num_steps;
  Optimum optimum{Eigen::VectorXd(2 * num_steps), 0};
  for (int axis = 0; axis < 2; ++axis) {
    Eigen::MatrixXd kkt = Eigen::MatrixXd::Zero(n + constraints, n + constraints);
    Eigen::VectorXd right = Eigen::VectorXd::Zero(n + constraints);
    for (int k = 0; k < num_steps; ++k) kkt(k, k) = 2 * scene.objective.effort * h;
    for (int j = 0; j < 2; ++j) {
      const TerminalTerm& term = scene.objective.terminal[j];
      kkt(n - 2 + j, n - 2 + j) = 2 * term.weight;
      right[n - 2 + j] = 2 * term.weight * term.target[axis];
    }
    const auto position = [&](int k) { return num_steps + 2 * (k - 1); };
    const Body& body = scene.bodies[0];
    Eigen::MatrixXd rows = Eigen::MatrixXd::Zero(constraints, n);
    for (int k = 0; k < num_steps; ++k) {
      const int p = 2 * k, v = p + 1;
      rows(p, position(k + 1)) = 1;
      rows(v, position(k + 1) + 1) = 1;
      rows(v, k) = -h / body.mass;
      right[n + v] = h * scene.gravity[axis];
      if (!explicit_position) rows(p, position(k + 1) + 1) = -h;
      if (k == 0) {
        right[n + p] = body.position[axis] + (explicit_position ? h * body.velocity[axis] : 0);
        right[n + v] += body.velocity[axis];
      } else {
        rows(p, position(k)) = -1;
        rows(v, position(k) + 1) = -1;
        if (explicit_position) rows(p, position(k) + 1) = -h;
      }
    }
    kkt.bottomLeftCorner(constraints, n) = rows;
    kkt.topRightCorner(n, constraints) = rows.transpose();
    const Eigen::VectorXd x = SolveFullPivotLu(kkt, right);
    for (int k = 0; k < num_steps; ++k) optimum.control[2 * k + axis] = x[k];
    optimum.loss += scene.objective.effort * h * x.head(num_steps).squaredNorm();
    for (int j = 0; j < 2; ++j) {
      const TerminalTerm& term = scene.objective.terminal[j];
      optimum.loss += term.weight * std::pow(x[n - 2 + j] - term.target[axis], 2);
    }
  }
  return optimum;
}

class LinearQuadratic : public testing::TestWithParam<std::string> {};

TEST_P(LinearQuadratic, ReachesTheKktSolution) {
  const Scene scene = LinearQuadraticScene();
  const Optimum optimum = SolveKkt(scene, kSteps, /*explicit_position=*/false);
  const SolveReport report =
      Solve(GetParam(), {scene, "direct_toi"}, {.limits = {.iterations = 3000}, .descent = {.learning_rate = 2}});
  ASSERT_EQ(report.solution.control.size(), optimum.control.size());
  const Eigen::Map<const Eigen::VectorXd> control(report.solution.control.data(), report.solution.control.size());
  EXPECT_LT((control - optimum.control).norm(), 1e-6 * optimum.control.norm());
  EXPECT_NEAR(report.solution.loss, optimum.loss, 1e-12 * optimum.loss);
  EXPECT_GT(report.guess.loss, 1.1 * optimum.loss);
  if (std::string(GetParam()) != "gd") {
    EXPECT_EQ(report.termination, Termination::kConverged) << report.reason;
    EXPECT_LE(report.work.iterations, 80);
  }
  EXPECT_EQ(report.work.iterations + 1, static_cast<int>(report.history.losses.size()));
  EXPECT_EQ(report.history.losses.back(), report.solution.loss);
  EXPECT_GT(report.work.evaluations, 0);
  EXPECT_GT(report.work.seconds, 0);
}

INSTANTIATE_TEST_SUITE_P(Solvers, LinearQuadratic,
                         testing::Values("gd", "ceres_lbfgs", "ceres_lm", "ceres_shooting", "ceres_lagrangian"),
                         ParameterName());

// All models fly, with one of two ways to advance positions or the exact one between them.
TEST(CeresLm, ReachesTheKktSolutionUnderEveryModel) {
  const Scene scene = LinearQuadraticScene();
  for (const ModelTraits& model : AllContactModels()) {
    if (!ReasonNotApplicable(model.name, scene).empty()) continue;
    const int num_steps = kSteps / model.grid_steps;
    const double implicit_loss = SolveKkt(scene, num_steps, false).loss;
    const double explicit_loss = SolveKkt(scene, num_steps, true).loss;
    const SolveReport report = Solve("ceres_lm", {scene, std::string(model.name)}, {});
    EXPECT_EQ(report.termination, Termination::kConverged) << model.name << ": " << report.reason;
    const double tolerance = model.push_gap > 50 ? 1e-7 : 1e-10;  // the other disc may be felt at its distance of 50 m
    EXPECT_GE(report.solution.loss, std::min(implicit_loss, explicit_loss) - tolerance) << model.name;
    EXPECT_LE(report.solution.loss, std::max(implicit_loss, explicit_loss) + tolerance) << model.name;
  }
}

TEST(CeresLm, BeatsGradientDescentOnGroundWall) {
  const SolveRequest request{ProblemScene("ground_wall"), "direct_toi"};
  const SolveReport descent =
      Solve("gd", request, {.limits = {.iterations = 1000}, .descent = {.learning_rate = 0.01}});
  const SolveReport least_squares = Solve("ceres_lm", request, {.limits = {.iterations = 30}});
  EXPECT_LT(least_squares.solution.loss, descent.solution.loss);
  EXPECT_LT(least_squares.solution.loss, 1e-20);
  EXPECT_EQ(least_squares.termination, Termination::kConverged) << least_squares.reason;
}

TEST(CeresLbfgs, HitsTheTargetOfGroundWall) {
  const SolveReport report =
      Solve("ceres_lbfgs", {ProblemScene("ground_wall"), "direct_toi"}, {.limits = {.iterations = 100}});
  EXPECT_LT(report.solution.loss, 1e-18);
  EXPECT_EQ(report.termination, Termination::kConverged) << report.reason;
}

class ByCeres : public testing::TestWithParam<std::string> {};

// The effort of a control that is not optimized is part of the loss.
TEST_P(ByCeres, ReportsTheLossOfTheScene) {
  Scene scene = LinearQuadraticScene();
  scene.optimize = Optimize::kVelocity;
  scene.free = {0};
  scene.objective.terminal.resize(1);
  const SolveReport report = Solve(GetParam(), {scene, "direct_toi"}, {});
  EXPECT_NEAR(report.solution.loss, 0.3 * 0.8 * 2, 1e-12);
  EXPECT_EQ(report.termination, Termination::kConverged) << report.reason;
}

// A rejected step leaves loss and iterate as they are.
TEST_P(ByCeres, LossesFallAndBelongToIterates) {
  const Scene scene = ProblemScene("single_collision");
  const SolveReport report =
      Solve(GetParam(), {scene, "direct_toi"}, {.limits = {.iterations = 40}, .keep_iterates = true});
  ASSERT_EQ(report.history.iterates.size(), report.history.losses.size());
  SingleShooting shooting(MakeSimulator("direct_toi", scene, Precision::kDouble));
  for (size_t k = 0; k < report.history.losses.size(); ++k) {
    double loss = 0;
    ASSERT_TRUE(shooting.Evaluate(report.history.iterates[k], &loss, nullptr));
    EXPECT_NEAR(report.history.losses[k], loss, 1e-13) << k;
    EXPECT_LE(report.history.losses[k], k > 0 ? report.history.losses[k - 1] + 1e-9 : loss + 1e-13) << k;
  }
  EXPECT_EQ(report.solution.control, report.history.iterates.back());
}

TEST_P(ByCeres, StopsWhenTold) {
  SolverOptions options;
  int calls = 0;
  options.monitor.callback = [&](int iteration, double) {
    EXPECT_EQ(iteration, calls++);
    return iteration < 2;
  };
  const Scene scene = ProblemScene("two_balls");
  const SolveReport report = Solve(GetParam(), {scene, "direct_toi"}, options);
  EXPECT_EQ(report.termination, Termination::kInterrupted);
  EXPECT_EQ(report.work.iterations, 2);
  EXPECT_EQ(calls, 3);
  EXPECT_LT(report.solution.loss, report.guess.loss);
  SingleShooting shooting(MakeSimulator("direct_toi", scene, Precision::kDouble));
  double loss = 0;
  ASSERT_TRUE(shooting.Evaluate(report.solution.control, &loss, nullptr));
  EXPECT_NEAR(report.solution.loss, loss, 1e-13);
}

TEST_P(ByCeres, StopsAtTheIterationLimit) {
  const SolveReport report =
      Solve(GetParam(), {ProblemScene("ground_wall"), "direct_toi"}, {.limits = {.iterations = 2}});
  EXPECT_EQ(report.termination, Termination::kIterationLimit);
  EXPECT_EQ(report.history.losses.size(), 3u);
}

// Starting at the optimum is not a failure.
TEST_P(ByCeres, HasConvergedAtTheOptimum) {
  Scene scene = LinearQuadraticScene();
  scene.objective.terminal.resize(1);
  scene.objective.terminal[0].target = {1, 2};
  scene.optimize = Optimize::kPosition;
  scene.free = {1};
  scene.objective.effort = 0;
  const SolveReport report = Solve(GetParam(), {scene, "direct_toi"}, {});
  EXPECT_EQ(report.termination, Termination::kConverged) << report.reason;
  EXPECT_EQ(report.work.iterations, 0);
}

// Where the discs cannot but be driven onto a kink, steps become small and no gradient vanishes.
TEST_P(ByCeres, AKinkIsNotConvergence) {
  const SolveReport report =
      Solve(GetParam(), {ProblemScene("single_collision"), "direct_toi"}, {.limits = {.iterations = 1000}});
  EXPECT_EQ(report.termination, Termination::kNoProgress);
  EXPECT_FALSE(report.reason.empty());
}

TEST_P(ByCeres, EffortAloneIsLeastAtRest) {
  Scene scene = LinearQuadraticScene();
  scene.objective.terminal.clear();
  const SolveReport report = Solve(GetParam(), {scene, "direct_toi"}, {});
  EXPECT_LT(report.solution.loss, 1e-15);
  EXPECT_EQ(report.termination, Termination::kConverged) << report.reason;
}

// Between two walls that are too close for it, a disc meets them more often in a step than the model can follow.
TEST_P(ByCeres, FailsWhereTheGuessHasNoLoss) {
  Scene scene = LinearQuadraticScene();
  Body& body = scene.bodies[0];
  body.velocity = {1e4, 0};
  const double room = body.radius + 5e-4;
  scene.planes = {{"left", body.position - Vec2d(room, 0), {1, 0}}, {"right", body.position + Vec2d(room, 0), {-1, 0}}};
  const SolveReport report = Solve(GetParam(), {scene, "lcp_kkt"}, {});
  EXPECT_EQ(report.termination, Termination::kFailed);
  EXPECT_FALSE(report.reason.empty());
  EXPECT_TRUE(report.history.losses.empty());
  EXPECT_EQ(report.solution.control.size(), 2u * kSteps);
}

INSTANTIATE_TEST_SUITE_P(Solvers, ByCeres, testing::Values("ceres_lbfgs", "ceres_lm", "ceres_shooting"),
                         ParameterName());

TEST(CeresLm, RefusesALinearObjective) {
  Scene scene = ProblemScene("bounce_once");
  scene.optimize = Optimize::kControl;
  const SolveReport report = Solve("ceres_lm", {scene, "direct_toi"}, {});
  EXPECT_EQ(report.termination, Termination::kNotApplicable);
  EXPECT_THAT(report.reason, HasSubstr("sum of squares"));
}

}  // namespace
}  // namespace saltus
