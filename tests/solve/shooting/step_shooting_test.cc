// Step shooting: what the feasible path reaches, and how the augmented Lagrangian fails.
#include <gmock/gmock.h>

#include <Eigen/Dense>
#include <algorithm>

#include "base/linear_algebra.h"
#include "parameter_name.h"
#include "saltus/control/single_shooting.h"
#include "saltus/simulate/exact_run.h"
#include "saltus/simulate/registry.h"
#include "saltus/solve/solver.h"
#include "test_scenes.h"

namespace saltus {
namespace {

using testing::HasSubstr;

double LargestDefect(const SolveReport& report) {
  return report.history.defects.empty()
             ? 1e300
             : *std::max_element(report.history.defects.back().begin(), report.history.defects.back().end());
}

double ExactLoss(const Scene& scene, const SolveReport& report) {
  const ExactRun run = SimulateExactly(scene, report.solution.initial_state, report.solution.control);
  EXPECT_TRUE(run.ok) << run.reason;
  return run.loss;
}

class FeasiblePath : public testing::TestWithParam<std::tuple<std::string, int>> {};

// 1.3991 is what 1000 exact gradient steps reach, 1.39654 the optimum.
TEST_P(FeasiblePath, BeatsGradientDescentOnTwoBalls) {
  const auto [contact, steps] = GetParam();
  Scene scene = ProblemScene("two_balls");
  scene.steps = steps;
  const SolveReport report = Solve("ceres_shooting", {scene, contact}, {});
  const double exact = ExactLoss(scene, report);
  EXPECT_LT(exact, 1.3970);
  EXPECT_GE(exact, 1.396542160123);
  EXPECT_EQ(report.history.defects.back().size(), static_cast<size_t>(steps));
  EXPECT_LT(LargestDefect(report), 1e-9);
  EXPECT_LE(report.work.iterations, 400);
  EXPECT_EQ(report.history.losses.size(), report.work.iterations + 1u);
}

INSTANTIATE_TEST_SUITE_P(Grids, FeasiblePath,
                         testing::Combine(testing::Values("event", "toi_velocity"), testing::Values(480, 1000)),
                         ParameterName());

// The best control on a grid, with the impact on the right node; values from 50-digit arithmetic. Other solvers, and
// this one without moving impacts, stall at another node.
TEST(CeresShooting, MovesTheImpactToTheBestNode) {
  const struct {
    const char* problem;
    int steps;
    double loss, tolerance;
    const char* node;
    const char* theta;
  } cases[] = {{"two_balls", 480, 1.39654310059879899, 1e-13, "node 328", "theta 0.5"},
               {"two_balls", 1000, 1.39654323006339811, 1e-13, "node 683", "theta 0.48"},
               {"single_collision", 480, 0.311418376820024856, 1e-13, "node 221", "theta 0.4986"}};
  for (const auto& [problem, steps, loss, tolerance, node, theta] : cases) {
    Scene scene = ProblemScene(problem);
    scene.steps = steps;
    const SolveReport report = Solve("ceres_shooting", {scene, "event"}, {});
    EXPECT_NEAR(report.solution.loss, loss, tolerance) << problem << steps;
    EXPECT_GE(report.solution.loss, loss - 1e-12) << problem << steps;
    EXPECT_EQ(report.termination, Termination::kConverged) << report.reason;
    ASSERT_TRUE(report.certificate);
    EXPECT_EQ(report.certificate->verdict, Certificate::Verdict::kStationaryOnGrid) << problem << steps;
    EXPECT_NEAR(ExactLoss(scene, report), report.solution.loss, 1e-12);
    EXPECT_THAT(report.reason, HasSubstr(node));
    EXPECT_THAT(report.reason, HasSubstr(theta)) << problem << steps;
    for (size_t k = 1; k < report.history.losses.size(); ++k) {
      EXPECT_LE(report.history.losses[k], report.history.losses[k - 1] + 1e-9);
    }
  }
}

TEST(CeresShooting, IsToldToStopWhileItMovesImpacts) {
  const Scene scene = ProblemScene("two_balls");
  SolverOptions options;
  options.monitor.callback = [](int iteration, double) { return iteration < 90; };
  const SolveReport stopped = Solve("ceres_shooting", {scene, "event"}, options);
  EXPECT_EQ(stopped.termination, Termination::kInterrupted);
  EXPECT_EQ(stopped.work.iterations, 90);
  const SolveReport limited = Solve("ceres_shooting", {scene, "event"}, {.limits = {.iterations = 90}});
  EXPECT_EQ(limited.termination, Termination::kIterationLimit);
  EXPECT_LE(limited.work.iterations, 90);
}

// Without damping to speak of, a step is that of Gauss-Newton in the forces, J the Jacobian of all residuals by them.
TEST(CeresShooting, TakesTheGaussNewtonStepThroughACollision) {
  Scene scene = ProblemScene("two_balls");
  scene.steps = 60;
  const SolveRequest request{scene, "event"};
  const SolveReport report = Solve("ceres_shooting", request, {.limits = {.iterations = 1}, .keep_iterates = true});
  ASSERT_EQ(report.history.iterates.size(), 2u);

  SingleShooting shooting(MakeSimulator("event", scene, Precision::kDouble));
  const int n = shooting.num_variables();
  Eigen::VectorXd u = Eigen::Map<const Eigen::VectorXd>(report.history.iterates[0].data(), n), terminal(2);
  Eigen::Matrix<double, 2, Eigen::Dynamic, Eigen::RowMajor> slope(2, n);
  ASSERT_TRUE(shooting.EvaluateResiduals(report.history.iterates[0], terminal.data(), slope.data()));
  const double effort = scene.objective.effort * scene.dt();
  Eigen::MatrixXd normal = MultiplyTransposed(slope, slope);
  normal.diagonal().array() += effort;
  const Eigen::VectorXd step = SolveLdlt(normal, -slope.transpose() * terminal - effort * u);
  const Eigen::VectorXd taken = Eigen::Map<const Eigen::VectorXd>(report.history.iterates[1].data(), n) - u;
  EXPECT_LT((taken - step).norm(), 1e-3 * step.norm());
  EXPECT_GT(step.norm(), 0.1 * u.norm());
}

TEST(CeresShooting, HitsTheTargetOfGroundWall) {
  for (const double friction : {0.0, 0.1}) {
    Scene scene = ProblemScene("ground_wall");
    scene.contact.friction = friction;
    const SolveReport report = Solve("ceres_shooting", {scene, "event"}, {.limits = {.iterations = 15}});
    EXPECT_LT(report.solution.loss, 1e-20);
    EXPECT_EQ(report.termination, Termination::kConverged) << report.reason;
    EXPECT_LT(LargestDefect(report), 1e-9);
  }
}

// Discs that spin, several contacts, two forces, a terminal velocity; every model that takes the scene.
TEST(CeresShooting, LowersTheLossOfManyDiscsUnderEveryModel) {
  const Scene scene = FourDiscs(0.2);
  int models = 0;
  for (const ModelTraits& model : AllContactModels()) {
    if (!ReasonNotApplicable(model.name, scene).empty()) continue;
    if (std::isinf(model.push_gap)) continue;  // solves for all discs in every step: 20 s
    ++models;
    const SolveReport report =
        Solve("ceres_shooting", {scene, std::string(model.name)}, {.limits = {.iterations = 20}});
    EXPECT_LT(report.solution.loss, 0.9 * report.guess.loss) << model.name;
    EXPECT_LT(LargestDefect(report), 1e-9) << model.name;
  }
  EXPECT_GT(models, 5);
}

TEST(CeresLagrangian, ClosesDefectsWithoutContact) {
  Scene scene = ProblemScene("ground_wall");
  scene.planes.clear();
  const SolveReport report = Solve("ceres_lagrangian", {scene, "event"}, {});
  EXPECT_EQ(report.termination, Termination::kConverged) << report.reason;
  EXPECT_LT(LargestDefect(report), 1e-9);
  EXPECT_LT(report.solution.loss, 1e-13);
  // The launch that reaches the target in 0.6 s of free flight.
  EXPECT_NEAR(report.solution.initial_state[2], -1.5 / 0.6, 1e-6);
  EXPECT_NEAR(report.solution.initial_state[3], 0.5 / 0.6 + 9.8 * 0.3, 1e-6);
}

// Through a collision it ends at a false minimum or with open defects, and says so.
TEST(CeresLagrangian, NeverClaimsConvergenceThroughACollision) {
  const Scene scene = ProblemScene("two_balls");
  for (const char* contact : {"event", "toi_velocity", "direct_toi"}) {
    const SolveReport report = Solve("ceres_lagrangian", {scene, contact}, {.limits = {.iterations = 200}});
    EXPECT_NE(report.termination, Termination::kConverged) << contact;
    EXPECT_GT(ExactLoss(scene, report), 1.45) << contact;  // gradient descent: 1.399
    ASSERT_FALSE(report.history.defects.empty());
    EXPECT_GT(report.history.defects.size(), 2u);
    if (LargestDefect(report) > 1e-9) {
      EXPECT_THAT(report.reason, HasSubstr("defects are open")) << contact;
    }
    EXPECT_EQ(report.history.losses.size(), report.work.iterations + 1u);
  }
}

TEST(CeresLagrangian, StopsWhenToldAndAtTheLimit) {
  const Scene scene = ProblemScene("two_balls");
  EXPECT_EQ(Solve("ceres_lagrangian", {scene, "event"}, {.limits = {.iterations = 0}}).history.losses.size(), 1u);
  SolverOptions options{.limits = {.iterations = 7}};
  const SolveReport limited = Solve("ceres_lagrangian", {scene, "event"}, options);
  EXPECT_LE(limited.work.iterations, 7);
  EXPECT_EQ(limited.termination, Termination::kIterationLimit);
  options.monitor.callback = [](int iteration, double) { return iteration < 2; };
  const SolveReport stopped = Solve("ceres_lagrangian", {scene, "event"}, options);
  EXPECT_EQ(stopped.termination, Termination::kInterrupted);
  EXPECT_EQ(stopped.work.iterations, 2);
}

}  // namespace
}  // namespace saltus
