// Plans under feedback and noise: what first order says against samples of the motion itself.
#include "saltus/feedback/closed_loop.h"

#include <gtest/gtest.h>

#include <Eigen/Core>
#include <cmath>
#include <numbers>
#include <vector>

#include "feedback/bouncing_disc.h"
#include "problems/hybrid_systems.h"
#include "saltus/feedback/covariance.h"
#include "saltus/feedback/filter.h"
#include "saltus/feedback/regulator.h"
#include "saltus/simulate/registry.h"
#include "test_scenes.h"

namespace saltus {
namespace {

using Eigen::MatrixXd;
using Eigen::VectorXd;

TrackingCost Weights(Eigen::Index n, double control) {
  return {
      .Q = {MatrixXd::Identity(n, n)}, .R = control * MatrixXd::Identity(1, 1), .QT = 20 * MatrixXd::Identity(n, n)};
}

// Each entry of a sample covariance of N normal vectors has the standard error sqrt((P_ii P_jj + P_ij^2) / N).
void ExpectCovariance(const MatrixXd& found, const MatrixXd& expected, int samples, double errors) {
  for (Eigen::Index i = 0; i < expected.rows(); ++i) {
    for (Eigen::Index j = 0; j <= i; ++j) {
      const double error = std::sqrt((expected(i, i) * expected(j, j) + expected(i, j) * expected(i, j)) / samples);
      EXPECT_NEAR(found(i, j), expected(i, j), errors * error) << i << ", " << j;
    }
  }
}

// A ball that bounces once, at 0.9035 s, between the nodes at 0.9 and 0.95 s.
class BallInClosedLoop : public ::testing::Test {
 protected:
  BallInClosedLoop() {
    EXPECT_TRUE(motion_.Rollout(input_)) << motion_.FailureReason();
    linear_ = Linearize(motion_, input_);
    plan_ = MakePlan(motion_, input_);
    regulator_ = Track(linear_, Weights(2, 0.05));
  }
  std::unique_ptr<Plant> Ball() const { return MakePlant(motion_, input_); }

  const HybridInput input_{.initial = {4, 0}, .parameters = {9.8, 0.7}, .duration = 1.2, .num_intervals = 24};
  HybridSimulator motion_{HybridSystem(BouncingBall())};
  LinearMotion linear_;
  Plan plan_;
  Regulator regulator_;
};

TEST_F(BallInClosedLoop, ReferencesContinueBeyondTheImpact) {
  ASSERT_EQ(plan_.events.size(), 1u);
  EXPECT_EQ(plan_.phases[18], 0);
  EXPECT_EQ(plan_.phases[19], 1);
  const double s = std::sqrt(8 / 9.8), after = 0.7 * 9.8 * s;
  ASSERT_EQ(plan_.late[0].first, 19);
  ASSERT_EQ(plan_.late[0].states.size(), 5u);
  ASSERT_EQ(plan_.early[0].first, 0);
  ASSERT_EQ(plan_.early[0].states.size(), 19u);
  for (int k : {19, 23}) {
    const double t = 0.05 * k;
    const VectorXd& state = plan_.late[0].states[k - 19];
    EXPECT_NEAR(state[0], 4 - 4.9 * t * t, 1e-12);
    EXPECT_NEAR(state[1], -9.8 * t, 1e-12);
    // At the reference the planned control acts; beside it the gain of the last interval before the impact.
    double u = 1;
    EXPECT_TRUE(FeedbackControl(plan_, regulator_.gains, k, state, {}, {&u, 1}));
    EXPECT_NEAR(u, 0, 1e-12);
    EXPECT_TRUE(FeedbackControl(plan_, regulator_.gains, k, state + Eigen::Vector2d(0.1, 0), {}, {&u, 1}));
    EXPECT_NEAR(u, -0.1 * regulator_.gains[18](0, 0), 1e-12);
  }
  for (int k : {0, 18}) {
    const double t = 0.05 * k - s;
    const VectorXd& state = plan_.early[0].states[k];
    EXPECT_NEAR(state[0], after * t - 4.9 * t * t, 1e-12);
    EXPECT_NEAR(state[1], after - 9.8 * t, 1e-12);
    double u = 1;
    EXPECT_TRUE(FeedbackControl(plan_, regulator_.gains, k, state + Eigen::Vector2d(0, 0.1), plan_.events, {&u, 1}));
    EXPECT_NEAR(u, -0.1 * regulator_.gains[19](0, 1), 1e-12);
  }
  // Two events more than planned: no feedback.
  const std::vector<EventLabel> two = {plan_.events[0], plan_.events[0]};
  double u = 1;
  EXPECT_FALSE(FeedbackControl(plan_, regulator_.gains, 20, plan_.states[20], two, {&u, 1}));
  EXPECT_EQ(u, 0);
}

TEST_F(BallInClosedLoop, SamplesHaveThePropagatedCovariance) {
  const Noise noise{.initial = 1e-6 * MatrixXd::Identity(2, 2),
                    .control = MatrixXd::Constant(1, 1, 1e-4),
                    .process = 1e-8 * MatrixXd::Identity(2, 2),
                    .measurement = 1e-8 * MatrixXd::Identity(2, 2)};
  const MonteCarloOptions options{.samples = 2000, .threads = 2};
  const auto make = [&] { return Ball(); };
  const MonteCarlo open = RunMonteCarlo(plan_, {}, noise, make, options);
  const MonteCarlo closed = RunMonteCarlo(plan_, regulator_.gains, noise, make, options);
  EXPECT_EQ(open.off_plan + closed.off_plan + open.failed + closed.failed, 0);
  ExpectCovariance(open.covariance, Propagate(linear_, noise).nodes[24], 2000, 4);
  ExpectCovariance(closed.covariance, Propagate(linear_, noise, &regulator_).nodes[24], 2000, 4);
  EXPECT_LT(closed.covariance.trace(), 0.2 * open.covariance.trace());
}

TEST_F(BallInClosedLoop, SamplesDoNotDependOnThreads) {
  const Noise noise{.initial = 1e-4 * MatrixXd::Identity(2, 2)};
  const auto loss = [](const ClosedLoopRun& run) { return run.final_state.squaredNorm(); };
  const auto run = [&](int threads) {
    return RunMonteCarlo(
        plan_, regulator_.gains, noise, [&] { return Ball(); }, {.samples = 60, .threads = threads}, loss);
  };
  const MonteCarlo one = run(1), three = run(3);
  EXPECT_EQ(one.covariance, three.covariance);
  EXPECT_EQ(one.loss, three.loss);
  EXPECT_EQ(one.loss_error, three.loss_error);
  EXPECT_GT(one.loss_error, 0);
}

TEST_F(BallInClosedLoop, NoFurtherSampleBeginsWhenAskedToStop) {
  const Noise noise{.initial = 1e-4 * MatrixXd::Identity(2, 2)};
  const auto make = [&] { return Ball(); };
  int asked = 0;
  const MonteCarlo some =
      RunMonteCarlo(plan_, {}, noise, make, {.samples = 100'000, .threads = 1, .stop = [&] { return ++asked > 30; }});
  EXPECT_EQ(some.counted, 30);
  EXPECT_EQ(some.failed, 0);
  EXPECT_EQ(some.covariance, RunMonteCarlo(plan_, {}, noise, make, {.samples = 30}).covariance);
}

// Balls that start 30 cm too high or too low, so that the impact is in another interval than planned.
TEST_F(BallInClosedLoop, LateAndEarlyBallsComeBackToThePlan) {
  for (const double offset : {0.3, -0.3}) {
    const std::unique_ptr<Plant> ball = Ball();
    const VectorXd start = plan_.states[0] + Eigen::Vector2d(offset, 0);
    Plan moved = plan_;
    moved.states[0] = start;
    const ClosedLoopRun open = RunClosedLoop(moved, {}, {}, 1, 0, ball.get());
    ball->Start(start);
    for (int k = 0; k < 24; ++k) {
      double u = 0;
      EXPECT_TRUE(FeedbackControl(plan_, regulator_.gains, k, ball->state(), ball->events(), {&u, 1})) << k;
      ASSERT_TRUE(ball->Advance(k, {&u, 1}));
    }
    EXPECT_EQ(ball->events(), plan_.events);
    EXPECT_LT((ball->state() - plan_.states[24]).norm(), 0.3 * (open.final_state - plan_.states[24]).norm());
  }
}

TEST_F(BallInClosedLoop, ProbabilityThatTheImpactComesTooLate) {
  const HybridInput input{.initial = {4, 0}, .parameters = {9.8, 0.7}, .duration = 1, .num_intervals = 20};
  ASSERT_TRUE(motion_.Rollout(input));
  const Noise noise{.initial = Eigen::Vector2d(0.16, 0).asDiagonal()};
  const Covariance covariance = Propagate(Linearize(motion_, input), noise);
  // dt = dy / 8.854; at 1 s the impact is 0.0965 s away.
  const double expected = 0.5 * std::erfc((1 - 0.9035079029052512) / (0.4 / 8.85437744847146) / std::numbers::sqrt2);
  ASSERT_FALSE(covariance.risks.empty());
  EXPECT_NEAR(covariance.risks[0].probability, expected, 1e-12);
  EXPECT_NE(covariance.Warning().find("comes after the end"), std::string::npos) << covariance.Warning();
  EXPECT_EQ(Propagate(Linearize(motion_, input), {.initial = Eigen::Vector2d(1e-4, 0).asDiagonal()}).Warning(), "");
  const MonteCarlo samples =
      RunMonteCarlo(MakePlan(motion_, input), {}, noise, [&] { return MakePlant(motion_, input); }, {.samples = 4000});
  // The height is quadratic in the time: within a tenth, and four standard errors.
  EXPECT_NEAR(
      samples.off_plan / 4000.0, covariance.change_probability, 0.1 * expected + 4 * std::sqrt(expected / 4000));
}

// Two bounces in one interval: the second may come before the first, whose times are correlated.
TEST_F(BallInClosedLoop, TwoImpactsInOneInterval) {
  const HybridInput input{.initial = {4, 0}, .parameters = {9.8, 0.7}, .duration = 2.5};
  ASSERT_TRUE(motion_.Rollout(input));
  ASSERT_EQ(motion_.events().size(), 2u);
  const Noise noise{.initial = Eigen::Vector2d(1, 0).asDiagonal()};
  const Covariance covariance = Propagate(Linearize(motion_, input), noise);
  // t_1 = s and t_2 = s (1 + 2 e), with ds = dy / (g s).
  const double s = std::sqrt(8 / 9.8), deviation = 1 / (9.8 * s);
  ASSERT_EQ(covariance.event_times.size(), 2u);
  EXPECT_NEAR(covariance.event_times[0], deviation, 1e-10);
  EXPECT_NEAR(covariance.event_times[1], 2.4 * deviation, 1e-10);
  // Both in two intervals.
  HybridInput halves = input;
  halves.num_intervals = 2;
  ASSERT_TRUE(motion_.Rollout(halves));
  const Covariance in_halves = Propagate(Linearize(motion_, halves), noise);
  EXPECT_GT(covariance.change_probability, 0.05);
  EXPECT_NEAR(in_halves.change_probability, covariance.change_probability, 1e-9);
}

class DiscsInClosedLoop : public ::testing::Test {
 protected:
  DiscsInClosedLoop() {
    scene_.steps = 60;
    control_ = InitialControl(scene_, 60);
    motion_ = MakeSimulator({"event"}, scene_, Precision::kDouble);
    EXPECT_TRUE(motion_->Rollout(InitialState(scene_), control_));
    linear_ = Linearize(*motion_, control_);
    plan_ = MakePlan(*motion_, control_);
    regulator_ = Track(
        linear_,
        {.Q = {1e-2 * MatrixXd::Identity(8, 8)}, .R = 1e-4 * MatrixXd::Identity(2, 2), .QT = MatrixXd::Identity(8, 8)});
    noise_.initial = 1e-8 * MatrixXd::Identity(8, 8);
    noise_.control = 1e-6 * MatrixXd::Identity(2, 2);
  }
  std::unique_ptr<Plant> Discs(const char* model) const {
    return MakePlant(MakeSimulator({model}, scene_, Precision::kDouble));
  }

  Scene scene_ = ProblemScene("two_balls");
  std::vector<double> control_;
  std::unique_ptr<Simulator> motion_;
  LinearMotion linear_;
  Plan plan_;
  Regulator regulator_;
  Noise noise_;
};

TEST_F(DiscsInClosedLoop, LinearizationIsTheDerivativeOfTheMotion) {
  MatrixXd transition = MatrixXd::Identity(8, 8);
  for (const LinearInterval& interval : linear_.intervals) transition = interval.A * transition;
  std::vector<double> cotangent(8);
  for (int i = 0; i < 8; ++i) {
    std::fill(cotangent.begin(), cotangent.end(), 0.0);
    cotangent[i] = 1;
    Sensitivity expected;
    motion_->Adjoint(cotangent, false, &expected);
    for (int j = 0; j < 8; ++j) EXPECT_NEAR(transition(i, j), expected.initial[j], 1e-11);
  }
  ASSERT_EQ(plan_.events.size(), 1u);
  int events = 0;
  for (const LinearInterval& interval : linear_.intervals) events += static_cast<int>(interval.events.size());
  EXPECT_EQ(events, 1);
}

TEST_F(DiscsInClosedLoop, SamplesHaveThePropagatedCovariance) {
  const auto make = [&] { return Discs("event"); };
  const MonteCarlo open = RunMonteCarlo(plan_, {}, noise_, make, {.samples = 1000});
  const MonteCarlo closed = RunMonteCarlo(plan_, regulator_.gains, noise_, make, {.samples = 1000});
  EXPECT_EQ(open.off_plan + closed.off_plan, 0);
  ExpectCovariance(open.covariance, Propagate(linear_, noise_).nodes[60], 1000, 4.5);
  ExpectCovariance(closed.covariance, Propagate(linear_, noise_, &regulator_).nodes[60], 1000, 4.5);
  EXPECT_LT(closed.covariance.trace(), open.covariance.trace());
}

// Discs with large errors miss each other: as often as the overlap of their paths says.
TEST_F(DiscsInClosedLoop, ProbabilityThatTheDiscsMiss) {
  const Noise noise{.initial = 0.01 * MatrixXd::Identity(8, 8)};
  const Covariance covariance = Propagate(linear_, noise);
  EXPECT_NE(covariance.Warning().find("the overlap of the paths of striker and target falls below zero"),
            std::string::npos)
      << covariance.Warning();
  // Head-on: the offset across is that of positions at the time at which the centres would meet.
  const auto k = static_cast<std::size_t>(std::lround(covariance.risks[0].time / motion_->step()));
  const VectorXd& x = plan_.states[k];
  const double distance = std::hypot(x[0] - x[4], x[1] - x[5]), speed = std::hypot(x[2] - x[6], x[3] - x[7]);
  const double time = linear_.intervals[k].begin + distance / speed, deviation = std::sqrt(0.02 * (1 + time * time));
  EXPECT_NEAR(covariance.risks[0].probability, 0.5 * std::erfc(0.4 / deviation / std::numbers::sqrt2), 1e-9);
  const MonteCarlo samples = RunMonteCarlo(plan_, {}, noise, [&] { return Discs("event"); }, {.samples = 2000});
  const double expected = covariance.change_probability;
  EXPECT_NEAR(samples.off_plan / 2000.0, expected, 0.5 * expected + 4 * std::sqrt(expected / 2000));
}

// The plan of exact dynamics, followed under a model that resolves no impact times.
TEST_F(DiscsInClosedLoop, FollowsThePlanUnderAnotherModel) {
  const std::unique_ptr<Plant> discs = Discs("lcp");
  const ClosedLoopRun open = RunClosedLoop(plan_, {}, {}, 1, 0, discs.get());
  const ClosedLoopRun closed = RunClosedLoop(plan_, regulator_.gains, {}, 1, 0, discs.get());
  ASSERT_TRUE(open.ok && closed.ok);
  EXPECT_TRUE(closed.as_planned);
  const VectorXd planned = plan_.states.back();
  EXPECT_LT((closed.final_state - planned).norm(), (open.final_state - planned).norm());
}

// A mean that a measurement has put below the ground bounces at once; its covariance passes the saltation matrix there.
TEST(Filter, MeanBehindAGuard) {
  const HybridSystem system{BouncingBall()};
  SaltedKalmanFilter filter(system, {9.8, 0.7}, 2, 0, Eigen::Vector2d(0.01, -3), 0.01 * MatrixXd::Identity(2, 2));
  const MatrixXd C = Eigen::RowVector2d(1, 0);
  filter.Update(VectorXd::Constant(1, -0.05), C, MatrixXd::Constant(1, 1, 0.01));
  EXPECT_NEAR(filter.mean()[0], -0.02, 1e-15);
  EXPECT_NEAR(filter.covariance()(0, 0), 0.005, 1e-15);
  ASSERT_TRUE(filter.Predict(2.1)) << filter.FailureReason();
  EXPECT_NEAR(filter.mean()[0], 2.1 * 0.1 - 4.9 * 0.01, 1e-13);  // the reset puts it onto the ground
  EXPECT_NEAR(filter.mean()[1], 2.1 - 0.98, 1e-13);
  Eigen::Matrix2d salted{{-0.7, 0}, {1.7 * 9.8 / 3, -0.7}}, flow{{1, 0.1}, {0, 1}};
  const Eigen::Matrix2d F = flow * salted, expected = F * Eigen::Vector2d(0.005, 0.01).asDiagonal() * F.transpose();
  EXPECT_LE((filter.covariance() - expected).cwiseAbs().maxCoeff(), 1e-14);
}

// A disc that a measurement has put into the ground bounces where it touched: the mean and the derivative are those of
// the closed form, as of a disc that is followed from before the bounce.
TEST(Filter, MeanOfADiscInTheGround) {
  Scene scene;
  scene.bodies = {{.name = "disc", .radius = kDiscRadius, .position = Vec2d(0, 1)}};
  scene.planes = {{.name = "ground", .point = Vec2d(0, 0), .normal = Vec2d(0, 1)}};
  scene.gravity = Vec2d(0, -kDiscGravity);
  scene.contact.restitution = kDiscRestitution;
  const Eigen::Vector4d x(0.3, kDiscRadius - 0.02, 1, -3);
  const MatrixXd P = Eigen::Vector4d(0.04, 0.01, 0.02, 0.03).asDiagonal();
  SaltedKalmanFilter filter(scene, 0, x, P);
  ASSERT_TRUE(filter.Predict(0.1)) << filter.FailureReason();
  const Eigen::Vector4d expected = BounceFor(x, 0.1);
  EXPECT_GT(expected[3], 0);
  EXPECT_LE((filter.mean() - expected).cwiseAbs().maxCoeff(), 1e-10);
  MatrixXd F(4, 4);
  for (int j = 0; j < 4; ++j) {
    const Eigen::Vector4d width = 1e-6 * Eigen::Vector4d::Unit(j);
    F.col(j) = (BounceFor(x + width, 0.1) - BounceFor(x - width, 0.1)) / 2e-6;
  }
  EXPECT_LE((filter.covariance() - F * P * F.transpose()).cwiseAbs().maxCoeff(), 1e-8);
}

// On recordings of another simulator, with outliers: ellipsoids that hold what they promise, which those without
// saltation matrices do not, and less error.
TEST(Filter, RecordingsOfABouncingDisc) {
  const FilterScores scores = CompareFilters(50);
  EXPECT_EQ(scores.salted.lost, 0);
  EXPECT_LT(scores.salted.position, scores.plain.position);
  EXPECT_LT(scores.salted.velocity, scores.plain.velocity);
  EXPECT_NEAR(scores.salted.covered, 0.95, 0.03);
  EXPECT_LT(scores.plain.covered, 0.87);
}

}  // namespace
}  // namespace saltus
