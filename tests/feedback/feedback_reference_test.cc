// Regulator, covariance and filter against exact values: those of the regulator by Taylor series and by the exponential
// of the Hamiltonian matrix in 84 digits, those of transitions also by differences of the motion.
#include <gtest/gtest.h>

#include <Eigen/Core>
#include <array>
#include <cmath>
#include <vector>

#include "problems/hybrid_systems.h"
#include "saltus/feedback/covariance.h"
#include "saltus/feedback/filter.h"
#include "saltus/feedback/regulator.h"

namespace saltus {
namespace {

using Eigen::MatrixXd;

constexpr double kTolerance = 1e-10;

MatrixXd Matrix(int rows, const std::vector<double>& numbers) {
  const int columns = static_cast<int>(numbers.size()) / rows;
  return Eigen::Map<const Eigen::Matrix<double, -1, -1, Eigen::RowMajor>>(numbers.data(), rows, columns);
}

void ExpectClose(const MatrixXd& found, const MatrixXd& expected, double tolerance = kTolerance) {
  ASSERT_EQ(found.rows(), expected.rows());
  ASSERT_EQ(found.cols(), expected.cols());
  EXPECT_LE((found - expected).cwiseAbs().maxCoeff(), tolerance * expected.cwiseAbs().maxCoeff())
      << "found\n"
      << found << "\nexpected\n"
      << expected;
}

// The optimum of the controlled ball with a control that is continuous in time, linear before and after its impact.
// Modes are the phases, so that a ball which is late keeps the control of the first, continued.
struct OptimalBall {
  static constexpr double kImpact = 0.697936180950424916232723;
  static constexpr double kStart = -13.261035960757762298, kBefore = 6.6523834449838246927;
  static constexpr double kAfter = -9.5034049214054638468, kEnd = -13.258802112336916118;

  static constexpr int kNumControls = 1;  // added to the optimum
  static constexpr int kNumParameters = 0;
  static constexpr std::array kStateSizes = {2, 2};
  static constexpr std::array kNumGuards = {1, 1};

  template <typename T>
  void Flow(int mode, const T& t, const T* x, const T* u, const T*, T* xdot) const {
    const T optimal = mode == 0 ? kStart + (kBefore - kStart) * t / kImpact
                                : kAfter + (kEnd - kAfter) * (t - kImpact) / (1 - kImpact);
    xdot[0] = x[1];
    xdot[1] = optimal + u[0] - 9.8;
  }
  template <typename T>
  T Guard(int, int, const T&, const T* x, const T*) const {
    return x[0];
  }
  template <typename T>
  int Reset(int, int, const T&, const T* x, const T*, T* x_plus) const {
    x_plus[0] = x[0];
    x_plus[1] = -0.7 * x[1];
    return 1;
  }
};

const TrackingCost kCost{.Q = {Matrix(2, {1, 0, 0, 0.1})}, .R = Matrix(1, {0.05}), .QT = Matrix(2, {20, 0, 0, 5})};
const MatrixXd kInitialCovariance = Matrix(2, {1e-4, 0, 0, 1e-4});

TEST(FeedbackReference, ContinuousRegulatorAboutTheOptimum) {
  HybridSimulator motion(HybridSystem(OptimalBall()), {.tolerance = 1e-14});
  const HybridInput input{.initial = {4, 0}, .duration = 1};
  ASSERT_TRUE(motion.Rollout(input)) << motion.FailureReason();
  ASSERT_EQ(motion.events().size(), 1u);
  const Regulator regulator = TrackContinuously(motion, input, kCost);
  ASSERT_EQ(regulator.gains.size(), 1u);
  ExpectClose(
      regulator.cost_to_go[0],
      Matrix(2, {1.08319703617475276636, 0.33866169546461259145, 0.33866169546461259145, 0.204527488336335026504}));
  ExpectClose(regulator.gains[0], Matrix(1, {6.77323390929225183, 4.09054976672670053}));
  const Regulator::EventJump& event = regulator.events[0];
  EXPECT_NEAR(event.time, OptimalBall::kImpact, 1e-13);
  ExpectClose(event.saltation, Matrix(2, {-0.7, 0, 2.35149524296556742, -0.7}));
  ExpectClose(event.cost_before,
              Matrix(2, {2.152817730992582289, 0.0903904665724959926, 0.0903904665724959926, 0.2002181199612840437}));
  ExpectClose(event.cost_after,
              Matrix(2, {10.24392593745802581, 1.557099951152233063, 1.557099951152233063, 0.4086084080842531505}));
  ExpectClose(event.gain_before, Matrix(1, {1.80780933144991985, 4.00436239922568087}));
  ExpectClose(event.gain_after, Matrix(1, {31.1419990230446613, 8.17216816168506301}));
  EXPECT_NEAR((regulator.cost_to_go[0] * kInitialCovariance).trace(), 0.000128772452451108779, 1e-14);
  ExpectClose(
      regulator.closed_loop[0],
      Matrix(2, {-0.00598638587862657331, -0.0132328523221370562, 0.0453014146148162575, 0.0196598263281364937}));
  const LinearMotion linear = Linearize(motion, input);
  ExpectClose(linear.intervals[0].A,
              Matrix(2, {0.010301633567087753, -0.204254790545338629, 2.35149524296556742, 0.941193609398479664}));
  ExpectClose(
      Propagate(linear, {.initial = kInitialCovariance}).nodes[1],
      Matrix(
          2,
          {0.00000418261431148707039, -0.0000168019061222516462, -0.0000168019061222516462, 0.000641537528806223084}));
  const MatrixXd& closed = regulator.closed_loop[0];
  ExpectClose(
      closed * kInitialCovariance * closed.transpose(),
      Matrix(2, {2.10945196467307731e-8, -5.31347327211035747e-8, -5.31347327211035747e-8, 2.43872693735597685e-7}));
}

// A motion cut into several intervals, and so with more modes of the recursion, has the same cost to go.
TEST(FeedbackReference, ContinuousRegulatorDoesNotDependOnIntervals) {
  HybridSimulator motion(HybridSystem(OptimalBall()), {.tolerance = 1e-14});
  const HybridInput input{.initial = {4, 0}, .duration = 1, .num_intervals = 7};
  ASSERT_TRUE(motion.Rollout(input));
  const Regulator regulator = TrackContinuously(motion, input, kCost);
  ExpectClose(
      regulator.cost_to_go[0],
      Matrix(2, {1.08319703617475276636, 0.33866169546461259145, 0.33866169546461259145, 0.204527488336335026504}));
  MatrixXd transition = MatrixXd::Identity(2, 2);
  for (const MatrixXd& closed : regulator.closed_loop) transition = closed * transition;
  ExpectClose(
      transition,
      Matrix(2, {-0.00598638587862657331, -0.0132328523221370562, 0.0453014146148162575, 0.0196598263281364937}));
}

// Prediction in pieces, of a flow that depends on time: the state at the end and the open-loop covariance.
TEST(FeedbackReference, PredictionInPieces) {
  SaltedKalmanFilter filter(
      HybridSystem(OptimalBall()), {}, 0, 0, Eigen::Vector2d(4, 0), kInitialCovariance, {.tolerance = 1e-14});
  for (const double time : {0.25, 0.6, 0.65, 0.9, 1.0}) {
    ASSERT_TRUE(filter.Predict(time)) << filter.FailureReason();
    EXPECT_EQ(filter.mode(), time < OptimalBall::kImpact ? 0 : 1);
  }
  EXPECT_NEAR(filter.mean()[0], 0.9961148553777191287356, 1e-13);
  EXPECT_NEAR(filter.mean()[1], 0.004143375660105286286961, 1e-13);
  ExpectClose(
      filter.covariance(),
      Matrix(
          2,
          {0.00000418261431148707039, -0.0000168019061222516462, -0.0000168019061222516462, 0.000641537528806223084}));
}

class PassiveBall : public ::testing::Test {
 protected:
  LinearMotion LinearOf(int num_intervals) {
    const HybridInput input{.initial = {4, 0}, .parameters = {9.8, 0.7}, .duration = 1, .num_intervals = num_intervals};
    EXPECT_TRUE(motion_.Rollout(input)) << motion_.FailureReason();
    return Linearize(motion_, input);
  }
  HybridSimulator motion_{HybridSystem(BouncingBall()), {.tolerance = 1e-14}};
};

TEST_F(PassiveBall, Covariance) {
  const LinearMotion linear = LinearOf(1);
  EXPECT_NEAR(motion_.events()[0].time, 0.9035079029052512377, 1e-13);
  ExpectClose(linear.intervals[0].A, Matrix(2, {-0.518444792199814297, -0.535963434938927104, 1.8815552078001857, 1}));
  const MatrixXd expected =
      Matrix(2, {0.0000556041806150642175, -0.000151144593365937279, -0.000151144593365937279, 0.000454025});
  ExpectClose(Propagate(linear, {.initial = kInitialCovariance}).nodes[1], expected);
  const Covariance in_steps = Propagate(LinearOf(20), {.initial = kInitialCovariance});
  ExpectClose(in_steps.nodes[20], expected);
  // The time of the impact, s = sqrt(2 y / g) + v / g to first order, by the covariance before it.
  ASSERT_EQ(in_steps.event_times.size(), 1u);
  const double by_y = 1 / 8.85437744847146213, by_v = 0.9035079029052512377 / 8.85437744847146213;
  EXPECT_NEAR(in_steps.event_times[0], 0.01 * std::hypot(by_y, by_v), 1e-14);
}

TEST_F(PassiveBall, SampledRegulator) {
  const LinearMotion linear = LinearOf(20);
  ExpectClose(linear.intervals[18].A,
              Matrix(2, {-0.612522552589823583, -0.0346931376080858798, 1.8815552078001857, -0.693399687020167132}));
  ExpectClose(linear.intervals[18].B, Matrix(2, {0.0009628260501654683, 0.0440481416896116575}));
  const Regulator regulator = Track(linear, kCost);
  ExpectClose(regulator.cost_to_go[0],
              Matrix(2, {17.985378351607516321, 5.6676179259690914369, 5.6676179259690914369, 3.7320096207788540269}));
  ExpectClose(regulator.gains[0], Matrix(1, {5.242983467178904, 3.490319172629627}));
  ExpectClose(regulator.gains[17], Matrix(1, {-3.183742293031526, 1.476514951343563}));
  ExpectClose(regulator.gains[18], Matrix(1, {5.300930898806861, -2.221581020167541}));
  ExpectClose(regulator.gains[19], Matrix(1, {0.399800099950025, 4.017991004497751}));
  ExpectClose(
      Propagate(linear, {.initial = kInitialCovariance}, &regulator).nodes[20],
      Matrix(2,
             {8.0271828309788786e-7, -0.0000041792147402346302, -0.0000041792147402346302, 0.000038770574513935986}));
}

// The table of a filter of a ball's height and speed, which are entries `y` and y + `apart` of the state; the height is
// that of the ball above `ground`.
void FollowTable(SaltedKalmanFilter* filter, int y, int apart, double ground) {
  const int v = y + apart;
  const bool of_system = ground == 0;  // which has events
  const Eigen::Index n = filter->mean().size();
  MatrixXd W = MatrixXd::Zero(n, n), C = MatrixXd::Zero(1, n), V = Matrix(1, {0.0025});
  W(y, y) = 1e-4;
  W(v, v) = 4e-4;
  C(0, y) = 1;
  const auto covariance = [&] {
    const MatrixXd& P = filter->covariance();
    return Matrix(2, {P(y, y), P(y, v), P(v, y), P(v, v)});
  };
  // z, predicted y and v, y, v, P11, P12, P22.
  const double table[10][8] = {{1.02,
                                0.951,
                                -0.98,
                                1.00673076923077,
                                -0.958769230769231,
                                0.00201923076923077,
                                0.000769230769230769,
                                0.0391692307692308},
                               {0.88,
                                0.861853846153846,
                                -1.93876923076923,
                                0.871216377230348,
                                -1.92230466771916,
                                0.00128987816865747,
                                0.00226832682970421,
                                0.0353173393702898},
                               {0.61,
                                0.629985910458431,
                                -2.90230466771916,
                                0.620638234517606,
                                -2.92698563038031,
                                0.00116928322583396,
                                0.00308729526138967,
                                0.0285547393219268},
                               {0.29,
                                0.278939671479575,
                                -3.90698563038031,
                                0.284081954834537,
                                -3.8929177997821,
                                0.00116232608856648,
                                0.00317979492477037,
                                0.0213960243935929},
                               {0.11,
                                0.0990271299453086,
                                2.86587643754478,
                                0.101692265533964,
                                2.86005963148611,
                                0.000607210232002052,
                                -0.00132526996803953,
                                0.00888424864619332},
                               {0.34,
                                0.338698228682575,
                                1.88005963148611,
                                0.338926285165719,
                                1.87987201265898,
                                0.000437973398422737,
                                -0.000360314489608489,
                                0.00922128799800259},
                               {0.44,
                                0.477913486431618,
                                0.89987201265898,
                                0.470994078487485,
                                0.89290684592879,
                                0.000456262968364334,
                                0.000459280284256707,
                                0.00951807590356884},
                               {0.46,
                                0.511284763080364,
                                -0.08709315407121,
                                0.499531315706144,
                                -0.109406018175395,
                                0.000572950261844926,
                                0.00108769460771517,
                                0.00930414283467706},
                               {0.37,
                                0.439590713888605,
                                -1.08940601817539,
                                0.419942659936861,
                                -1.12972190860256,
                                0.000705843238768721,
                                0.00144832148480669,
                                0.00853499464836524},
                               {0.22,
                                0.257970469076605,
                                -2.10972190860256,
                                0.245789146455739,
                                -2.13346670763665,
                                0.000802026082183117,
                                0.00156337277439146,
                                0.0074955529666868}};
  double log_likelihood = 0;
  for (int step = 0; step < 10; ++step) {
    const double* row = table[step];
    ASSERT_TRUE(filter->Predict(0.1 * (step + 1), {}, W)) << filter->FailureReason();
    if (of_system) {
      ASSERT_EQ(filter->events().size(), step == 4 ? 1u : 0u);
      if (step == 4) {
        EXPECT_NEAR(filter->events()[0].time, 0.46727694944161565, kTolerance);
        EXPECT_NEAR(filter->events()[0].before[1], -4.5522319043099288, kTolerance);
      }
    }
    EXPECT_NEAR(filter->mean()[y] - ground, row[1], kTolerance);
    EXPECT_NEAR(filter->mean()[v], row[2], kTolerance);
    if (step == 4) {
      ExpectClose(covariance(),
                  Matrix(2, {0.000802004324870578, -0.00175041886643505, -0.00175041886643505, 0.00981215966826378}));
    }
    const std::optional<double> likelihood = filter->Update(Eigen::VectorXd::Constant(1, row[0] + ground), C, V);
    ASSERT_TRUE(likelihood) << filter->FailureReason();
    log_likelihood += *likelihood;
    EXPECT_NEAR(filter->mean()[y] - ground, row[3], kTolerance);
    EXPECT_NEAR(filter->mean()[v], row[4], kTolerance);
    ExpectClose(covariance(), Matrix(2, {row[5], row[6], row[6], row[7]}));
  }
  EXPECT_NEAR(log_likelihood, 16.3066638320523, 1e-10);
}

TEST(FeedbackReference, Filter) {
  const MatrixXd P = Matrix(2, {0.01, 0, 0, 0.04});
  SaltedKalmanFilter filter(
      HybridSystem(BouncingBall()), {9.8, 0.7}, 0, 0, Eigen::Vector2d(1, 0), P, {.tolerance = 1e-14});
  FollowTable(&filter, 0, 1, 0);
}

TEST(FeedbackReference, FilterOfADisc) {
  Scene scene;
  scene.bodies = {{.name = "ball", .radius = 0.25, .position = Vec2d(0, 1.25)}};
  scene.planes = {{.name = "ground", .point = Vec2d(0, 0), .normal = Vec2d(0, 1)}};
  scene.gravity = Vec2d(0, -9.8);
  scene.contact.restitution = 0.7;
  SaltedKalmanFilter filter(
      scene, 0, Eigen::Vector4d(0, 1.25, 0, 0), Eigen::Vector4d(1, 0.01, 1, 0.04).asDiagonal().toDenseMatrix());
  FollowTable(&filter, 1, 2, 0.25);
}

}  // namespace
}  // namespace saltus
