// Optima of the expected loss, whose lower loss under noise samples show.
#include "saltus/feedback/expected_loss.h"

#include <gtest/gtest.h>

#include <cmath>
#include <vector>

#include "base/random.h"
#include "problems/hybrid_systems.h"
#include "saltus/control/single_shooting.h"
#include "saltus/simulate/registry.h"
#include "saltus/solve/hybrid_solver.h"
#include "test_scenes.h"

namespace saltus {
namespace {

using Eigen::MatrixXd;

struct Estimate {
  double mean = 0, error = 0;  // of the difference of two losses, with the same noise
};

// The mean over `samples` of what `difference` returns for one, and its standard error.
template <typename Difference>
Estimate MeanOf(int samples, const Difference& difference) {
  double sum = 0, squares = 0;
  for (int i = 0; i < samples; ++i) {
    const double value = difference(i);
    sum += value;
    squares += value * value;
  }
  Estimate estimate{.mean = sum / samples};
  estimate.error = std::sqrt((squares / samples - estimate.mean * estimate.mean) / samples);
  return estimate;
}

// A scene with the positions of all discs changed by normal errors of one seed.
Scene Moved(Scene scene, double deviation, int seed) {
  NormalStream stream(seed);
  for (Body& body : scene.bodies) {
    for (int j = 0; j < 2; ++j) body.position[j] += deviation * stream.Next();
  }
  return scene;
}

TEST(ExpectedLoss, OfABallWithoutImpactIsTheLossAndTheTraceOfTheCovariance) {
  HybridProblem problem = ControlledBallProblem();
  problem.guess.duration = 0.5;  // the ball is in the air
  const MatrixXd P = Eigen::Vector2d(0.01, 0.04).asDiagonal();
  const SolveReport plain = Solve("ceres_lbfgs", problem, {});
  const SolveReport robust = SolveExpectedLoss(problem, {.initial = P}, {});
  ASSERT_FALSE(robust.history.losses.empty()) << robust.reason;
  // The motion is linear in the initial state: the optimum is the same, and the trace of F P F' is added.
  const Eigen::Matrix2d F{{1, 0.5}, {0, 1}};
  const double trace = (F * P * F.transpose()).trace();
  EXPECT_NEAR(robust.solution.loss, plain.solution.loss + 100 * trace, 1e-8 * robust.solution.loss);
  for (std::size_t i = 0; i < plain.solution.control.size(); ++i) {
    EXPECT_NEAR(robust.solution.control[i], plain.solution.control[i], 1e-4);
  }
}

TEST(ExpectedLoss, TwoBallsLoseLessUnderNoise) {
  Scene scene = ProblemScene("two_balls");
  scene.steps = 60;
  const double deviation = 0.03;
  Errors errors;
  errors.initial = MatrixXd::Zero(8, 8);
  for (int i : {0, 1, 4, 5}) errors.initial(i, i) = deviation * deviation;
  const SolveRequest request{.scene = scene, .contact = {"event"}};
  const SolveReport nominal = Solve("ceres_lbfgs", request, {.limits = {.iterations = 200}});
  const SolveReport robust = SolveExpectedLoss(request, errors, {.limits = {.iterations = 200}});
  ASSERT_FALSE(robust.history.losses.empty()) << robust.reason;
  EXPECT_LT(robust.history.losses.back(), robust.history.losses.front());
  const auto loss_of = [&](const Scene& moved, const SolveReport& report) {
    SingleShooting shooting(MakeSimulator({"event"}, moved, Precision::kDouble));
    double loss = 0;
    EXPECT_TRUE(shooting.Evaluate(report.solution.control, &loss, nullptr));
    return loss;
  };
  const Estimate gain = MeanOf(2000, [&](int seed) {
    const Scene moved = Moved(scene, deviation, seed + 1);
    return loss_of(moved, nominal) - loss_of(moved, robust);
  });
  EXPECT_GT(gain.mean, 3 * gain.error);
}

// Errors of the shot itself: of velocity and side spin as they are executed.
TEST(ExpectedLoss, ABankShotLosesLessUnderNoise) {
  const Scene scene = ProblemScene("bank_shot");
  const SolveRequest request{.scene = scene, .contact = {"event"}};
  const SolveReport nominal = Solve("ceres_lbfgs", request, {.limits = {.iterations = 200}});
  SingleShooting shooting(MakeSimulator({"event"}, scene, Precision::kDouble));
  ASSERT_EQ(shooting.num_variables(), 3);
  const Eigen::Vector3d deviation(0.004, 0.004, 0.5);
  Scene start = scene;
  for (int i = 0; i < scene.num_bodies(); ++i) {
    start.bodies[i].velocity = {nominal.solution.initial_state[4 * i + 2], nominal.solution.initial_state[4 * i + 3]};
    start.bodies[i].angular_velocity = nominal.solution.initial_state[4 * scene.num_bodies() + 2 * i + 1];
  }
  const Errors errors{.variables = deviation.cwiseAbs2().asDiagonal()};
  const SolveReport robust =
      SolveExpectedLoss({.scene = start, .contact = {"event"}}, errors, {.limits = {.iterations = 200}});
  ASSERT_FALSE(robust.history.losses.empty()) << robust.reason;
  const auto decisions = [&](const SolveReport& report) {
    return std::vector<double>{
        report.solution.initial_state[2], report.solution.initial_state[3], report.solution.initial_state[13]};
  };
  const std::vector<double> before = decisions(nominal), after = decisions(robust);
  const auto loss_of = [&](std::vector<double> z, int seed) {
    NormalStream stream(seed + 1);
    for (int i = 0; i < 3; ++i) z[i] += deviation[i] * stream.Next();
    double loss = 0;
    EXPECT_TRUE(shooting.Evaluate(z, &loss, nullptr));
    return loss;
  };
  const Estimate gain = MeanOf(4000, [&](int seed) { return loss_of(before, seed) - loss_of(after, seed); });
  EXPECT_GT(gain.mean, 3 * gain.error);
}

TEST(ExpectedLoss, Refusals) {
  const HybridProblem problem = ControlledBallProblem();
  SolveReport report = SolveExpectedLoss(problem, {}, {});
  EXPECT_EQ(report.termination, Termination::kNotApplicable);
  EXPECT_NE(report.reason.find("covariance that is not zero"), std::string::npos) << report.reason;
  report = SolveExpectedLoss(problem, {.initial = MatrixXd::Identity(3, 3)}, {});
  EXPECT_NE(report.reason.find("expected 2 x 2"), std::string::npos) << report.reason;
  report = SolveExpectedLoss(problem, {.initial = -MatrixXd::Identity(2, 2)}, {});
  EXPECT_NE(report.reason.find("positive semidefinite"), std::string::npos) << report.reason;
}

}  // namespace
}  // namespace saltus
