// The engine against exact values of hybrid systems, which were computed by Taylor series of order 56 in 84 digits and
// differentiated by differences there: they use neither saltation matrices nor adjoints.
#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <complex>
#include <string>
#include <utility>
#include <vector>

#include "base/linear_algebra.h"
#include "problems/hybrid_systems.h"
#include "saltus/hybrid/hybrid_simulator.h"

namespace saltus {
namespace {

// Relative errors that are allowed. Rounding errors of steps are amplified as the motion amplifies disturbances, by up
// to 1e4 here.
constexpr double kState = 1e-11;
constexpr double kDerivative = 1e-10;

// By which number of the input a row of a table is.
struct By {
  enum What { kValue, kInitial, kControl, kParameter, kDuration } what = kValue;
  int index = 0;
};
struct Row {
  std::string name;
  std::vector<double> values;
};

double Entry(const HybridGradient& gradient, const By& by) {
  switch (by.what) {
    case By::kInitial:
      return gradient.initial[by.index];
    case By::kControl:
      return gradient.control[by.index];
    case By::kParameter:
      return gradient.parameters[by.index];
    default:
      return gradient.duration;
  }
}

int Column(const HybridInput& input, const By& by, int num_controls) {
  const int initial = static_cast<int>(input.initial.size()), control = input.num_intervals * num_controls;
  switch (by.what) {
    case By::kInitial:
      return by.index;
    case By::kControl:
      return initial + by.index;
    case By::kParameter:
      return initial + control + by.index;
    default:
      return initial + control + static_cast<int>(input.parameters.size());
  }
}

void ExpectClose(double found, double expected, double tolerance, const std::string& what) {
  EXPECT_NEAR(found, expected, tolerance * std::max(std::abs(expected), 1e-3)) << what;
}

struct Motion {
  Motion(HybridSystem system, HybridInput in)
      : input(std::move(in)), simulator(std::move(system), {.tolerance = 1e-14}) {
    ok = simulator.Rollout(input);
    EXPECT_TRUE(ok) << simulator.FailureReason();
    if (!ok) return;
    EXPECT_LE(simulator.IntegrationError(), 1e-11);
    sensitivity = simulator.Sensitivity();
  }

  // Table of the final state, the first row of which is its values; the adjoint and the forward sweep are compared.
  void ExpectFinal(const std::vector<Row>& table, const std::vector<By>& by) {
    ASSERT_TRUE(ok);
    ASSERT_EQ(table.size(), by.size());
    const std::span<const double> final_state = simulator.final_state();
    ASSERT_EQ(table[0].values.size(), final_state.size());
    for (size_t i = 0; i < final_state.size(); ++i) {
      ExpectClose(final_state[i], table[0].values[i], kState, "state");
      std::vector<double> cotangent(final_state.size());
      cotangent[i] = 1;
      const HybridGradient gradient = simulator.Adjoint(cotangent);
      for (size_t row = 1; row < table.size(); ++row) {
        const std::string what = "component " + std::to_string(i) + " by " + table[row].name;
        ExpectClose(Entry(gradient, by[row]), table[row].values[i], kDerivative, what);
        const int column = Column(input, by[row], simulator.system().num_controls());
        ExpectClose(sensitivity.final_state[i * sensitivity.columns + column], table[row].values[i], kDerivative, what);
      }
    }
  }

  // Table of the first components of the state just after an event, followed by its time.
  void ExpectAfter(int event, const std::vector<Row>& table, const std::vector<By>& by) {
    ASSERT_TRUE(ok);
    ASSERT_GT(simulator.events().size(), static_cast<size_t>(event));
    const HybridEvent& at = simulator.events()[event];
    const size_t shown = table[0].values.size() - 1;
    for (size_t i = 0; i <= shown; ++i) {
      ExpectClose(i < shown ? at.after[i] : at.time, table[0].values[i], kState, "state");
      HybridCotangent cotangent;
      cotangent.after.resize(simulator.events().size());
      cotangent.event_times.resize(simulator.events().size());
      if (i < shown) {
        cotangent.after[event].resize(at.after.size());
        cotangent.after[event][i] = 1;
      } else {
        cotangent.event_times[event] = 1;
      }
      const HybridGradient gradient = simulator.Adjoint(cotangent);
      for (size_t row = 1; row < table.size(); ++row) {
        const std::string what = "component " + std::to_string(i) + " by " + table[row].name;
        ExpectClose(Entry(gradient, by[row]), table[row].values[i], kDerivative, what);
        ExpectClose(
            Forward(event, i < shown ? static_cast<int>(i) : -1, by[row]), table[row].values[i], kDerivative, what);
      }
    }
  }

  void ExpectTimes(const std::vector<double>& times, double tolerance = 1e-13) {
    ASSERT_EQ(simulator.events().size(), times.size());
    for (size_t i = 0; i < times.size(); ++i) EXPECT_NEAR(simulator.events()[i].time, times[i], tolerance * times[i]);
  }

  // The derivative of a component of the state after an event, or of its time (-1).
  double Forward(int event, int component, const By& by) const {
    const int column = Column(input, by, simulator.system().num_controls());
    if (component < 0) return sensitivity.times[event][column];
    return sensitivity.after[event][component * sensitivity.columns + column];
  }

  HybridInput input;
  HybridSimulator simulator;
  HybridSensitivity sensitivity;
  bool ok = false;
};

constexpr By kValue{};
constexpr By kDuration{By::kDuration};
By X(int i) { return {By::kInitial, i}; }
By P(int i) { return {By::kParameter, i}; }
By U(int i) { return {By::kControl, i}; }

void ExpectMatrix(const std::vector<double>& found, const std::vector<double>& expected, double tolerance = 1e-12) {
  ASSERT_EQ(found.size(), expected.size());
  for (size_t i = 0; i < found.size(); ++i) {
    EXPECT_NEAR(found[i], expected[i], tolerance * std::max(std::abs(expected[i]), 1.0)) << "entry " << i;
  }
}

// In any order.
void ExpectEigenvalues(const Eigen::MatrixXd& matrix, const std::vector<std::complex<double>>& expected) {
  Eigen::VectorXcd found = matrix.eigenvalues();
  ASSERT_EQ(found.size(), static_cast<Eigen::Index>(expected.size()));
  for (const std::complex<double>& value : expected) {
    Eigen::Index nearest = 0;
    EXPECT_LT((found.array() - value).abs().minCoeff(&nearest), 1e-10 * std::max(1.0, std::abs(value))) << value;
    found[nearest] = 1e300;
  }
}

TEST(HybridReference, BouncingBall) {
  Motion run(HybridSystem(BouncingBall()), {.initial = {1.3, 0.4}, .parameters = {9.81, 0.8}, .duration = 2});
  run.ExpectTimes({0.55720308415835660801, 1.3834884673336435927});
  run.ExpectFinal(
      {
          {"state", {0.13461823752513323273, -2.8056342918771302282}},
          {"y0", {2.203907929171727461, 6.2738614352328119871}},
          {"v0", {0.37586110739508880863, 1.2558149412938965132}},
          {"e", {7.8951741884835833065, 18.238184120136521969}},
          {"g", {-0.29366019504140142609, -1.168601440794836332}},
          {"T", {-2.8056342918771302282, -9.81}},
      },
      {kValue, X(0), X(1), P(1), P(0), kDuration});
}

TEST(HybridReference, BouncingBallOfTheSensitivityTutorial) {
  const HybridInput input{.initial = {50, 0}, .parameters = {9.8, 0.988008392024876511903389}, .duration = 15};
  Motion right(HybridSystem(BouncingBall()), input);
  EXPECT_EQ(right.simulator.events().size(), 2u);
  right.ExpectFinal({{"state", {20, -23.2772784829975162}}}, {kValue});
  EXPECT_NEAR(right.simulator.Adjoint(std::vector<double>{1, 0}).parameters[1], 488.533815009348211, 1e-10);
  // The loss (y - 20)^2 has the second derivative 2 (dy/de)^2 where it is zero.
  const auto slope = [&](double change) {
    HybridInput moved = input;
    moved.parameters[1] += change;
    Motion run(HybridSystem(BouncingBall()), moved);
    const double miss = run.simulator.final_state()[0] - 20;
    return run.simulator.Adjoint(std::vector<double>{2 * miss, 0}).parameters[1];
  };
  constexpr double kWidth = 1e-6, kSecond = 2 * 488.533815009348211 * 488.533815009348211;
  EXPECT_NEAR((slope(kWidth) - slope(-kWidth)) / (2 * kWidth), kSecond, 1e-9 * kSecond);
}

TEST(HybridReference, BouncingBallAtThePublishedLocalMinimum) {
  const HybridInput input{.initial = {50, 0}, .parameters = {9.8, 0.866554105436901}, .duration = 15};
  Motion run(HybridSystem(BouncingBall()), input);
  const double y = run.simulator.final_state()[0];
  EXPECT_NEAR(y, 19.3679028154539091, 1e-11);
  EXPECT_NEAR((y - 20) * (y - 20), 0.3995468507, 1e-10);
  // The slope changes by 6e-13 between neighbouring numbers e.
  EXPECT_NEAR(run.simulator.Adjoint(std::vector<double>{1, 0}).parameters[1], 5.17696e-11, 5e-12);
  EXPECT_EQ(run.simulator.events().size(), 3u);
  Motion top(HybridSystem(BouncingBall()),
             {.initial = {50, 0}, .parameters = {9.8, 0.86655410543691079163}, .duration = 15});
  EXPECT_NEAR(top.simulator.final_state()[0], 19.3679028154539091, 1e-11);
  EXPECT_NEAR(top.simulator.Adjoint(std::vector<double>{1, 0}).parameters[1], 0, 5e-12);
}

TEST(HybridReference, BouncingBallOfTheSensitivityTutorialHasOneSolution) {
  HybridSimulator simulator(HybridSystem(BouncingBall()), {.steps_per_interval = 16});
  constexpr int kPoints = 20000;
  int changes = 0;
  double last = 0;
  for (int i = 0; i < kPoints; ++i) {
    const double e = 0.75 + 0.25 * (i + 0.5) / kPoints;
    ASSERT_TRUE(simulator.Rollout({.initial = {50, 0}, .parameters = {9.8, e}, .duration = 15}));
    const double miss = simulator.final_state()[0] - 20;
    if (miss * last < 0) {
      ++changes;
      EXPECT_NEAR(e, 0.988008392024876511903389, 0.25 / kPoints);
    }
    last = miss;
  }
  EXPECT_EQ(changes, 1);
}

struct Wheel {
  int spokes;
  std::vector<double> parameters, start;
  double duration, after, before, period, eigenvalue;
  std::vector<double> saltation, monodromy, impacts;
  std::vector<Row> table;
};

void ExpectWheel(const Wheel& wheel) {
  const HybridSystem system{RimlessWheel{wheel.spokes}};
  Motion run(system, {.initial = wheel.start, .parameters = wheel.parameters, .duration = wheel.duration});
  run.ExpectTimes(wheel.impacts);
  run.ExpectFinal(wheel.table, {kValue, X(0), X(1), P(0), P(1), P(2)});

  // The limit cycle, from just after an impact, by Newton's method.
  double u = 1.1 * wheel.after;
  HybridInput input{
      .initial = {-M_PI / wheel.spokes, u}, .parameters = wheel.parameters, .duration = 1.5 * wheel.period};
  for (int i = 0; i < 8; ++i) {
    input.initial[1] = u;
    Motion step(system, input);
    u -= (step.simulator.events()[0].after[1] - u) / (step.Forward(0, 1, X(1)) - 1);
  }
  input.initial[1] = u;
  Motion cycle(system, input);
  const HybridEvent& impact = cycle.simulator.events()[0];
  EXPECT_NEAR(u, wheel.after, 1e-12);
  EXPECT_NEAR(impact.before[1], wheel.before, 1e-12);
  EXPECT_NEAR(impact.time, wheel.period, 1e-11);
  EXPECT_NEAR(cycle.Forward(0, 1, X(1)), wheel.eigenvalue, 1e-11);
  ExpectMatrix(SaltationMatrix(system, 0, 0, impact.time, impact.before, {}, wheel.parameters), wheel.saltation);
  // Xi Phi: the state after the impact at a time that is fixed, from that at the time of the impact.
  const double slope[2] = {impact.after[1], wheel.parameters[0] * std::sin(impact.after[0] + wheel.parameters[2])};
  Eigen::Matrix2d monodromy;
  for (int i = 0; i < 2; ++i) {
    for (int j = 0; j < 2; ++j) monodromy(i, j) = cycle.Forward(0, i, X(j)) - slope[i] * cycle.Forward(0, -1, X(j));
  }
  ExpectMatrix({monodromy(0, 0), monodromy(0, 1), monodromy(1, 0), monodromy(1, 1)}, wheel.monodromy, 1e-10);
  ExpectEigenvalues(monodromy, {1, wheel.eigenvalue});
}

TEST(HybridReference, RimlessWheelOfSixSpokes) {
  ExpectWheel(
      {.spokes = 6,
       .parameters = {2.0 / 3, 2.0 / 3, 0.2},
       .start = {-0.1, 0.5},
       .duration = 6,
       .after = 0.460341126609458278249292,
       .before = 0.69051168991418741737,
       .period = 2.31001486504538590233857,
       .eigenvalue = 4.0 / 9,
       .saltation = {0.66666666666666666667, 0, -0.7331483434536100049, 0.66666666666666666667},
       .monodromy = {2.1901962397350894744, 2.584574068210707019, -0.80391862157162063579, -0.74575179529064502999},
       .impacts = {1.0440500886894403804, 3.1241394205011489288, 5.3223301466950318184},
       .table = {
           {"state", {-0.23914503614007037852, 0.39059699118321483405}},
           {"q0", {0.53871791106265228971, -0.050942996534334235189}},
           {"u0", {1.8216050255113740765, -0.0092934042099574749312}},
           {"lambda2", {1.0745845757577014745, 0.17902765088021293523}},
           {"mu", {4.2663066642982211279, 1.1530623604194920516}},
           {"gamma", {5.1402610024554010808, 1.2907093452549274645}},
       }});
}

TEST(HybridReference, RimlessWheelOfEightSpokes) {
  ExpectWheel(
      {.spokes = 8,
       .parameters = {1, std::cos(M_PI / 4), 0.08},
       .start = {-0.1, 0.45},
       .duration = 5,
       .after = 0.349754367432509660480935,
       .before = 0.49462736992227790433,
       .period = 3.24030513899839363127047,
       .eigenvalue = 0.5,
       .saltation = {0.7071067811865475244, 0, -1.272811361265693354, 0.7071067811865475244},
       .monodromy = {8.8192450016688219242, 8.8900085473828011326, -7.3172274863681548909, -7.3192450016688219242},
       .impacts = {0.9627242309351934091, 2.9325188636338056023},
       .table = {
           {"state", {0.25463365018494425863, 0.42481736739916720918}},
           {"q0", {1.0797457662142314872, 0.84651244121668204098}},
           {"u0", {3.0536149401197415092, 2.6255467964798853768}},
           {"lambda2", {0.37498005697097618339, 0.44271856268400256893}},
           {"mu", {5.3112116983372796151, 5.01111614502567025}},
           {"gamma", {11.260572950524324524, 11.38033987873746593}},
       }});
}

// The cycle of the walker from a guess of (q1, u1), by Newton's method on the map of a step.
struct WalkerCycle {
  explicit WalkerCycle(Eigen::Vector2d guess) {
    for (int i = 0; i < 10; ++i) {
      const Eigen::Vector2d miss = Map(guess) - guess;
      guess -= (jacobian - Eigen::Matrix2d::Identity()).inverse() * miss;
    }
    fixed = guess;
    Map(fixed);
    by_gamma = (Eigen::Matrix2d::Identity() - jacobian).inverse() * map_by_gamma;
  }
  Eigen::Vector2d Map(const Eigen::Vector2d& from) {
    const double q1 = from[0], u1 = from[1], c = std::cos(2 * q1), s = std::sin(2 * q1);
    Motion step(HybridSystem(SimplestWalker()),
                {.initial = {q1, u1, 2 * q1, (1 - c) * u1}, .parameters = {0.009}, .duration = 4.5});
    const HybridEvent& strike = step.simulator.events()[1];
    period = strike.time;
    before.assign(strike.before.begin(), strike.before.end());
    for (int i = 0; i < 2; ++i) {
      const auto by = [&](int j) { return step.Forward(1, i, X(j)); };
      jacobian(i, 0) = by(0) + 2 * by(2) + 2 * s * u1 * by(3);
      jacobian(i, 1) = by(1) + (1 - c) * by(3);
      map_by_gamma[i] = step.Forward(1, i, P(0));
    }
    double slope[4];
    step.simulator.system().functions().Flow(
        {strike.next_mode, strike.time, strike.after.data(), nullptr, step.input.parameters.data()}, slope);
    for (int i = 0; i < 4; ++i) {
      for (int j = 0; j < 4; ++j) monodromy(i, j) = step.Forward(1, i, X(j)) - slope[i] * step.Forward(1, -1, X(j));
    }
    return {strike.after[0], strike.after[1]};
  }
  // Xi Phi over a step has the eigenvalues of the map and, along the motion and onto the surface of strikes, 1 and 0.
  void ExpectEigenvaluesOfMap(std::complex<double> first, std::complex<double> second) const {
    ExpectEigenvalues(jacobian, {first, second});
    ExpectEigenvalues(monodromy, {first, second, 1, 0});
  }
  // Returns the function that is zero at heel strike, and the height of the swing foot, at a time of the cycle.
  std::pair<double, double> FootAt(double time) const {
    const double c = std::cos(2 * fixed[0]);
    Motion part(
        HybridSystem(SimplestWalker()),
        {.initial = {fixed[0], fixed[1], 2 * fixed[0], (1 - c) * fixed[1]}, .parameters = {0.009}, .duration = time});
    const std::span<const double> x = part.simulator.final_state();
    return {2 * x[0] - x[2], std::cos(x[0]) - std::cos(x[0] - x[2])};
  }
  // The foot scuffs at mid-stance: both rise or fall through zero there, the guard at `closes`, the height between
  // `height` - 5e-6 and `height` + 5e-6.
  void ExpectScuffing(double closes, double height) const {
    EXPECT_NEAR(FootAt(closes).first, 0, 1e-11);
    EXPECT_LT(FootAt(closes - 1e-3).first, 0);
    EXPECT_GT(FootAt(closes + 1e-3).first, 0);
    EXPECT_GT(FootAt(height - 5e-6).second, 0);
    EXPECT_LT(FootAt(height + 5e-6).second, 0);
  }
  Eigen::Vector2d fixed, map_by_gamma, by_gamma;
  Eigen::Matrix2d jacobian;
  Eigen::Matrix4d monodromy;
  std::vector<double> before;
  double period = 0;
};

TEST(HybridReference, StableCycleOfTheSimplestWalker) {
  const WalkerCycle cycle({0.2, -0.2});
  EXPECT_NEAR(cycle.fixed[0], 0.200310900544247089360166, 1e-11);
  EXPECT_NEAR(cycle.fixed[1], -0.199832473004952354537572, 1e-11);
  EXPECT_NEAR(cycle.period, 3.88246375285137413756967, 1e-10);
  EXPECT_NEAR(cycle.before[1], -0.21701609489954125811, 1e-11);
  EXPECT_NEAR(cycle.before[3], 0.00035116964318476652476, 1e-11);
  ExpectMatrix({cycle.jacobian(0, 0), cycle.jacobian(0, 1), cycle.jacobian(1, 0), cycle.jacobian(1, 1)},
               {-6.1058394607603964605, -6.8470415084028162734, 5.1565178333520240734, 5.7256397786286201683},
               1e-10);
  cycle.ExpectEigenvaluesOfMap({-0.19009984106588814607, 0.55759877668206826877},
                               {-0.19009984106588814607, -0.55759877668206826877});
  cycle.ExpectScuffing(1.813895690556209, 1.81390);
  EXPECT_NEAR(cycle.by_gamma[0], 7.2978202116226419735, 1e-9);
  EXPECT_NEAR(cycle.by_gamma[1], -6.5709274333289764301, 1e-9);
  ExpectMatrix(
      SaltationMatrix(HybridSystem(SimplestWalker()), 1, 0, cycle.period, cycle.before, {}, std::vector{0.009}),
      {0.919265822888391875,
       0,
       -0.959632911444195938,
       0,
       -1.75655389524725763,
       0.920818675211424481,
       0.793642627290966569,
       0,
       0.0712358333661302915,
       0,
       -1.03561791668306515,
       0,
       0.746029321198440144,
       0.0729116425933016354,
       -0.301783255479599568,
       0},
      1e-10);
}

TEST(HybridReference, UnstableCycleOfTheSimplestWalker) {
  const WalkerCycle cycle({0.194, -0.204});
  EXPECT_NEAR(cycle.fixed[0], 0.193937369810181808531226, 1e-11);
  EXPECT_NEAR(cycle.fixed[1], -0.203866927442006926803098, 1e-11);
  EXPECT_NEAR(cycle.period, 3.09610586807816369990153, 1e-10);
  EXPECT_NEAR(cycle.before[1], -0.22022645639698517735, 1e-11);
  EXPECT_NEAR(cycle.before[3], -0.23657522801127327284, 1e-11);
  ExpectMatrix({cycle.jacobian(0, 0), cycle.jacobian(0, 1), cycle.jacobian(1, 0), cycle.jacobian(1, 1)},
               {8.0927108183930260697, 6.5914596801007867757, -4.735015038386639586, -3.6292568696656473035},
               1e-10);
  cycle.ExpectEigenvaluesOfMap(4.0038643589297071788, 0.45958958979767158751);
  cycle.ExpectScuffing(2.143805844268424, 1.86021);
  EXPECT_NEAR(cycle.by_gamma[0], 7.001596542711016503, 1e-9);
  EXPECT_NEAR(cycle.by_gamma[1], -6.8058099126910206699, 1e-9);
  ExpectMatrix(
      SaltationMatrix(HybridSystem(SimplestWalker()), 1, 0, cycle.period, cycle.before, {}, std::vector{0.009}),
      {3.1602727075404236,
       0,
       -2.0801363537702118,
       0,
       -3.44083665754085929,
       0.925714969842278193,
       1.63712386321281473,
       0,
       2.46931869108441093,
       0,
       -2.23465934554220546,
       0,
       1.38838446094985752,
       0.068766764452188169,
       -0.62327282868915134,
       0},
      1e-10);
}

TEST(HybridReference, SimplestWalkerFromAnotherStart) {
  Motion run(HybridSystem(SimplestWalker()),
             {.initial = {0.2, -0.2, 0.4, -0.0158}, .parameters = {0.009}, .duration = 9});
  ASSERT_EQ(run.simulator.events().size(), 4u);
  EXPECT_NEAR(run.simulator.events()[1].time, 3.8437317059508779869, 1e-12);
  EXPECT_NEAR(run.simulator.events()[3].time, 7.769962983407426769, 1e-12);
  run.ExpectFinal(
      {
          {"state",
           {0.050751984168550956873, -0.072055493900475561281, 0.21359467961428598016, -0.28231457741242938812}},
          {"q1", {0.016772628054583543267, 0.52905570058491539171, -2.2090190633734653514, -7.9844658730023675559}},
          {"u1", {0.12625396857343695194, 0.34750691005992111015, -1.4178442619678357166, -6.8591332096216909256}},
          {"q2", {0.61819972965541684439, -0.54422373126883548727, 3.0350157751128145204, 3.0933554431382947842}},
          {"u2", {0.46858438058924930448, -0.41251189184557229534, 2.3004878825368427946, 2.344708311459934879}},
          {"gamma", {-4.3369239494106241214, 2.5486474470041866539, -22.38591707609537623, -34.971746802648805348}},
      },
      {kValue, X(0), X(1), X(2), X(3), P(0)});
}

struct Hopper {
  double m, k, theta;
  double vx, y;  // a fixed apex
  std::vector<double> times, jacobian;
  double length, eigenvalue;
  std::vector<std::pair<double, double>> fixed;  // apex height and speed
  double y0, vx0;
  std::vector<double> hop_times, run_times;
  std::vector<Row> hops, run;
};

void ExpectHopper(const Hopper& hopper) {
  const HybridSystem system{SlipHopper{.m = hopper.m}};
  const std::vector<double> parameters = {hopper.k, hopper.theta};
  const auto hop = [&](double vx, double y) {
    return Motion(system, {.initial = {0, y, vx, 0}, .parameters = parameters, .duration = 1});
  };
  const Motion apex = hop(hopper.vx, hopper.y);
  const HybridEvent& at = apex.simulator.events()[2];
  for (int i = 0; i < 3; ++i) EXPECT_NEAR(apex.simulator.events()[i].time, hopper.times[i], 1e-12);
  EXPECT_NEAR(at.after[2], hopper.vx, 1e-12);
  EXPECT_NEAR(at.after[1], hopper.y, 1e-12);
  EXPECT_NEAR(at.after[0], hopper.length, 1e-12);
  Eigen::Matrix2d jacobian;
  jacobian << apex.Forward(2, 2, X(2)), apex.Forward(2, 2, X(1)), apex.Forward(2, 1, X(2)), apex.Forward(2, 1, X(1));
  ExpectMatrix({jacobian(0, 0), jacobian(0, 1), jacobian(1, 0), jacobian(1, 1)}, hopper.jacobian, 1e-10);
  ExpectEigenvalues(jacobian, {1, hopper.eigenvalue});
  for (const auto& [y, expected] : hopper.fixed) {
    double vx = 1.001 * expected;
    for (int i = 0; i < 8; ++i) {
      const Motion step = hop(vx, y);
      vx -= (step.simulator.events()[2].after[2] - vx) / (step.Forward(2, 2, X(2)) - 1);
    }
    EXPECT_NEAR(vx, expected, 1e-11);
  }

  Motion hops(
      system,
      {.initial = {0, hopper.y0, hopper.vx0, 0}, .parameters = parameters, .duration = hopper.hop_times.back() + 0.01});
  hops.ExpectTimes(hopper.hop_times, 1e-12);
  hops.ExpectAfter(8, hopper.hops, {kValue, X(0), X(1), X(2), P(0), P(1)});

  Motion run(system, {.initial = {0, hopper.y0, hopper.vx0, -0.1}, .parameters = parameters, .duration = 2.1});
  run.ExpectTimes(hopper.run_times, 1e-12);
  EXPECT_EQ(run.simulator.final_mode(), SlipHopper::kStance);
  run.ExpectFinal(hopper.run, {kValue, X(0), X(1), X(2), X(3), P(0), P(1)});
}

TEST(HybridReference, LightHopper) {
  ExpectHopper(
      {.m = 1,
       .k = 100,
       .theta = M_PI / 18,
       .vx = 1.017450873821601974169,
       .y = 1.182441943200824511354,
       .times = {0.19881357609007311047, 0.59479369275073693997, 0.79360726884081005045},
       .jacobian = {3.7317401408873674, -1.6139687100033249347, -0.27794113933993980485, 1.1642133874313606666},
       .length = 0.75186244877474557669,
       .eigenvalue = 3.8959535283187280666,
       .fixed = {{1.18, 1.0160003610819373639}, {1.2, 1.0274474699109299845}},
       .y0 = 1.18,
       .vx0 = 1.02,
       .hop_times = {0.19758150064608,
                     0.59384228258153,
                     0.79114067882815,
                     0.98815717315902,
                     1.3841589287998,
                     1.580050576578,
                     1.7748122850573,
                     2.1697285416456,
                     2.3597710919503},
       .run_times = {0.18783439892384,
                     0.58401686594204,
                     0.78158927172441,
                     0.97890128350208,
                     1.3748442093337,
                     1.5711163943046,
                     1.7663467066668},
       .hops =
           {
               {"state", {2.364368781795531144, 1.156151349129035924, 1.231816957757637596, 2.359771091950297847}},
               {"x0", {1, 0, 0, 0}},
               {"y0", {-12.59407875023292482, 4.705507803046783058, -30.08164305346289113, 4.82262065919358906}},
               {"vx0", {28.18566556284990203, -6.359990864534871708, 52.45901855660507228, -3.940146756317746645}},
               {"k", {-0.1370494257450316913, 0.03220835185185756978, -0.2614702748571401485, 0.01248851872605125728}},
               {"theta", {-160.0694500058625453, 39.0589406508405849, -317.0839661270965239, 24.23489611323611615}},
           },
       .run = {
           {"state",
            {0.1434523421370904859,
             0.8489130552112413343,
             1.139255100795511741,
             2.107296555291679943,
             1.899190288412259795}},
           {"x0", {0, 0, 0, 0, 1}},
           {"y0",
            {-8.364848597191010965,
             -6.108747553132407675,
             -35.16840971227758599,
             3.804403303494940941,
             -2.400819000020201618}},
           {"vx0",
            {10.29394884701157645,
             2.743974023850606226,
             52.98508175808313899,
             -12.01121008268199654,
             9.53254604371169236}},
           {"vy0",
            {-0.03027702410764106445,
             -0.1496421799978439175,
             0.11999429053741558,
             -0.4091230871623325906,
             0.1260081900002020162}},
           {"k",
            {-0.0440830868415837872,
             0.001933852435766758286,
             -0.246974037237585231,
             0.08386994428202119259,
             -0.04305230578443869807}},
           {"theta",
            {-62.74160176924139589,
             -16.96559666799485149,
             -320.5877114606977504,
             74.46010088592710023,
             -47.38204459146838205}},
       }});
}

TEST(HybridReference, HeavyHopper) {
  ExpectHopper(
      {.m = 100,
       .k = 10000,
       .theta = M_PI / 36,
       .vx = 0.5138060758940911827287,
       .y = 1.23831271807700218319,
       .times = {0.22005363890890632163, 0.6169034694891094021, 0.83695710839801572373},
       .jacobian = {4.1390994501654684758, -0.81045049706780437819, -0.16128883703308185982, 1.041641438960482422},
       .length = 0.40044127888331726299,
       .eigenvalue = 4.1807408891259508978,
       .fixed = {{1.24, 0.51424040845802973441}},
       .y0 = 1.24,
       .vx0 = 0.51,
       .hop_times = {0.22081906706997,
                     0.61749772417501,
                     0.83847854009073,
                     1.0596017103504,
                     1.4564282166099,
                     1.6781832841599,
                     1.9004922010363,
                     2.2977558839752,
                     2.5218959005102},
       .run_times = {0.21104538081953,
                     0.60765192052584,
                     0.82886392506767,
                     1.0502223640091,
                     1.446980978964,
                     1.6689891819432,
                     1.891566015195},
       .hops =
           {
               {"state", {1.011754139248408618, 1.250954522105162278, 0.2025081674815967327, 2.521895900510243827}},
               {"x0", {1, 0, 0, 0}},
               {"y0", {-10.79168854009306827, 1.400375599489128688, -19.77083712070593339, 2.610220575943385031}},
               {"vx0", {46.16913368581404067, -1.455129428880328052, 74.37376218503384929, -1.298534357074275286}},
               {"k",
                {-0.001007627292237182624,
                 0.00003322258814022939676,
                 -0.001640555467633104469,
                 -0.00004135271615174121091}},
               {"theta", {-261.3616110292786137, 8.864168994864687979, -437.7190858571289037, 7.86767738456949031}},
           },
       .run = {
           {"state",
            {-0.01604308533067050531,
             0.6555529663929546676,
             0.2140591219142863628,
             0.2497221124986155502,
             0.9382248907404426592}},
           {"x0", {0, 0, 0, 0, 1}},
           {"y0",
            {-1.64219901537065848,
             -1.045745430727771955,
             -7.508266496256147533,
             -50.22114976059975776,
             -2.338525742335736186}},
           {"vx0",
            {4.688754491988240214,
             0.6180014789219470054,
             34.28835097937596903,
             17.25787404797242384,
             14.04735360539702641}},
           {"vy0",
            {-0.004983922037722051479,
             -0.01451475694258383547,
             0.1593045573922562697,
             -1.939265642203444924,
             0.07438525742335736186}},
           {"k",
            {-0.00009256548152689861839,
             0.00002496536726958050135,
             -0.0007943241653684728166,
             0.001061073663793637725,
             -0.0002956298686674447508}},
           {"theta",
            {-27.94498293298696686,
             -3.786490991400536077,
             -200.3229481921998609,
             -104.2341178397330955,
             -72.1702672132503198}},
       }});
}

TEST(HybridReference, PassiveBallOfHybridIlqr) {
  const HybridSystem system{BouncingBall()};
  Motion run(system, {.initial = {4, 0}, .parameters = {9.8, 0.7}, .duration = 1});
  run.ExpectTimes({0.9035079029052512377});
  const HybridEvent& impact = run.simulator.events()[0];
  EXPECT_NEAR(impact.before[1], -8.85437744847146213, 1e-13);
  ExpectMatrix(SaltationMatrix(system, 0, 0, impact.time, impact.before, std::vector{0.0}, run.input.parameters),
               {-0.7, 0, 1.8815552078001857, -0.7});
  run.ExpectFinal({{"state", {run.simulator.final_state()[0], run.simulator.final_state()[1]}},
                   {"y0", {-0.518444792199814297, 1.8815552078001857}},
                   {"v0", {-0.535963434938927104, 1}}},
                  {kValue, X(0), X(1)});
}

TEST(HybridReference, SwitchedLine) {
  // L = int x^2 dt + (x(T) - 5/3)^2.
  const auto loss = [](double x0, double* slope) {
    Motion run(HybridSystem(SwitchedLine()), {.initial = {x0, 0}, .duration = 2});
    const double miss = run.simulator.final_state()[0] - 5.0 / 3;
    *slope = run.simulator.Adjoint(std::vector<double>{2 * miss, 1}).initial[0];
    return run.simulator.final_state()[1] + miss * miss;
  };
  double slope = 0, other = 0;
  EXPECT_NEAR(loss(-2, &slope), 145.0 / 81, 1e-13);
  EXPECT_NEAR(slope, -26.0 / 27, 1e-13);
  EXPECT_NEAR(loss(-1, &slope), 134.0 / 81, 1e-13);
  EXPECT_NEAR(slope, 16.0 / 27, 1e-13);
  double x0 = -1.4, last = -1;
  for (int i = 0; i < 8 && x0 != last; ++i) {
    loss(x0, &other);
    const double next = x0 - other * (x0 - last) / (other - slope);
    last = x0;
    slope = other;
    x0 = next;
    if (std::abs(other) < 1e-14) break;
  }
  EXPECT_NEAR(x0, -1.42757223208276713401017, 1e-12);
  EXPECT_NEAR(loss(x0, &slope), 1.52377277537495711456099, 1e-13);
  // The slope is quadratic in x0, so that central differences of any width give L''.
  loss(x0 - 0.1, &slope);
  loss(x0 + 0.1, &other);
  EXPECT_NEAR((other - slope) / 0.2, 1.51263539678978793, 1e-12);
}

TEST(HybridReference, SwitchedOscillator) {
  const HybridSystem system{SwitchedOscillator()};
  Motion run(system, {.initial = {std::exp(-1.0), 0}, .parameters = {2 * M_PI, 1}, .duration = M_PI / 2});
  run.ExpectTimes({1});
  const HybridEvent& event = run.simulator.events()[0];
  ExpectMatrix(SaltationMatrix(system, 0, 0, 1, event.before, {}, run.input.parameters), {1, 0, -4 * M_PI, 1}, 1e-11);
  run.ExpectFinal(
      {
          {"state", {-1.5974603774506981221, 0.76149362060601145276}},
          {"x1", {21.669465013239469376, 56.637502490103849577}},
          {"x2", {-2.0699542713808072979, -4.3423475157075602462}},
          {"w", {-0.32683585908635351742, -0.68563586180145053449}},
          {"R", {-9.5692110570053551047, -20.074279144799565678}},
      },
      {kValue, X(0), X(1), P(0), P(1)});
}

// Full thrust, cruise and full brake, of these many parts of the time each.
void ExpectCar(const TurboCar& car, double duration, const std::vector<int>& parts, double goal,
               const std::vector<double>& events) {
  HybridInput input{.initial = {0, 0}, .duration = duration, .num_intervals = parts[0] + parts[1] + parts[2]};
  const double u[] = {5, 0, -5};
  for (int i = 0; i < 3; ++i) input.control.insert(input.control.end(), parts[i], u[i]);
  Motion run(HybridSystem(car), input);
  run.ExpectTimes(events, 1e-12);
  EXPECT_NEAR(run.simulator.final_state()[0], goal, 1e-11 * goal);
  EXPECT_NEAR(run.simulator.final_state()[1], 0, 1e-12 * goal);
}

TEST(HybridReference, TurboCarsInMinimumTime) {
  ExpectCar(TurboCar(), 40.0 / 3, {1, 3, 1}, 200, {2, 34.0 / 3});
  ExpectCar(TurboCar(), 59.0 / 5, {15, 29, 15}, 200, {2, 49.0 / 5});
  ExpectCar(TurboCar{.on = 15, .off = 10}, 152.0 / 15, {55, 52, 45}, 150, {3, 122.0 / 15});
  ExpectCar(TurboCar{.on = 100}, 13, {3, 7, 3}, 150, {});
  // dT/dq = 1/v_max: a goal that is 1 m further takes 1/v_max of cruise more.
  ExpectCar(TurboCar(), 40.0 / 3 + 1.0 / 20, {160, 483, 160}, 201, {2, 34.0 / 3 + 1.0 / 20});
  ExpectCar(TurboCar(), 59.0 / 5 + 1.0 / 25, {75, 146, 75}, 201, {2, 49.0 / 5 + 1.0 / 25});
  ExpectCar(TurboCar{.on = 15, .off = 10}, 152.0 / 15 + 1.0 / 25, {275, 263, 225}, 151, {3, 122.0 / 15 + 1.0 / 25});
  const HybridSystem system{TurboCar()};
  ExpectMatrix(SaltationMatrix(system, 0, 0, 2, std::vector{10.0, 10.0}, std::vector{5.0}, {}), {1, 0, 0, 3});
}

TEST(HybridReference, JuggledBall) {
  const HybridSystem system{JuggledBall()};
  const HybridInput input{.initial = {0.35, 1}, .parameters = {0.025, 4 * M_PI, 9.81, 0.8}, .duration = 1.7};
  const std::vector<By> by = {kValue, X(0), X(1), P(0), P(1), P(2), P(3)};
  std::vector<Row> fifth, last;
  for (const Row& row : std::vector<Row>{
           {"state",
            {-0.02349428555446534494,
             0.9917464332567859625,
             1.84724056266734515,
             0.08827231239048660365,
             -0.03685982168662471437}},
           {"y0",
            {-0.5040089375039903412,
             16.78051162922594987,
             4.693661682132286745,
             -3.01157895965473296,
             64.25024972988459106}},
           {"v0",
            {-0.1344537474448886178,
             4.455699960412988794,
             1.252121451509318064,
             -0.8072253313092339755,
             17.1659643188747578}},
           {"A",
            {-2.050638766300949713,
             43.611156513369754,
             10.34512505444963156,
             -4.935014962475006625,
             123.6649974947417757}},
           {"w",
            {-0.04319491980314151551,
             1.383921422261005766,
             0.2552606808676900671,
             -0.2706658730049704659,
             4.112901840342016984}},
           {"g",
            {0.03451871143469354078,
             -1.062936953131450473,
             -0.3214608732535024683,
             0.2113074060795873884,
             -4.361063861711471333}},
           {"e",
            {-0.380513060203615858,
             17.13245775196558437,
             3.543587101993538722,
             -1.704995519404372403,
             44.64504591836786557}},
       }) {
    fifth.push_back({row.name, {row.values.begin(), row.values.begin() + 3}});
    last.push_back({row.name, {row.values.begin() + 3, row.values.end()}});
  }
  Motion run(system, input);
  run.ExpectTimes({0.39632067914601644525, 0.89780316458684993241, 1.3301945737365986322, 1.5790203951295593023});
  run.ExpectFinal(last, by);
  HybridInput longer = input;
  longer.duration = 1.85;
  Motion to_fifth(system, longer);
  EXPECT_NEAR(to_fifth.simulator.events()[4].time, 1.8472405626673451503, 1e-13);
  to_fifth.ExpectAfter(4, fifth, by);
}

// The orbit of the juggled ball with one impact in each period of the paddle; the other phase, -t*, is a saddle.
struct Orbit {
  double amplitude, phase, height, acceleration;  // of the paddle at that phase
  std::vector<double> map, saltation;
  std::complex<double> first, second;  // eigenvalues of the map
  double other_first, other_second;
};

void ExpectOrbit(const Orbit& orbit) {
  const double amplitude = orbit.amplitude, phase = orbit.phase;
  const double g = 9.81, omega = 4 * M_PI, period = 0.5, v = 0.5 * g * period;
  // The state at time 0 of the flight that began a period before the impact at `phase`.
  const double since = period - phase, y = amplitude * std::sin(omega * phase);
  const HybridSystem system{JuggledBall()};
  Motion run(system,
             {.initial = {y + v * since - 0.5 * g * since * since, v - g * since},
              .parameters = {amplitude, omega, g, 0.8},
              .duration = phase + 1.2 * period});
  run.ExpectTimes({phase, phase + period}, 1e-12);
  const auto by_start = [&](int event) {
    Eigen::Matrix2d by;
    for (int j = 0; j < 2; ++j) {
      by(0, j) = run.Forward(event, -1, X(j));
      by(1, j) = run.Forward(event, 1, X(j));
    }
    return by;
  };
  const Eigen::Matrix2d found = by_start(1) * by_start(0).inverse();
  ExpectMatrix({found(0, 0), found(0, 1), found(1, 0), found(1, 1)}, orbit.map, 1e-11);
  EXPECT_NEAR(found.determinant(), 0.64, 1e-11);
  ExpectEigenvalues(found, {orbit.first, orbit.second});
  const HybridEvent& impact = run.simulator.events()[0];
  EXPECT_NEAR(impact.after[1], v, 1e-12);
  EXPECT_NEAR(impact.after[0], orbit.height, 1e-12);
  EXPECT_NEAR((impact.after[1] + 0.8 * impact.before[1]) / 1.8, 0.2725, 1e-12);  // the paddle's velocity
  EXPECT_NEAR(found(1, 0) / 1.8, orbit.acceleration, 1e-10);
  const auto saltation = [&](double time, std::span<const double> before) {
    return SaltationMatrix(system, 0, 0, time, before, {}, run.input.parameters);
  };
  ExpectMatrix(saltation(impact.time, impact.before), orbit.saltation, 1e-12);
  // Xi Phi over a period has the eigenvalues of the map. At the other phase and the large amplitude, the paddle would
  // meet the ball between the impacts of the orbit.
  const auto expect_eigenvalues = [&](const std::vector<double>& xi, const auto& first, const auto& second) {
    Eigen::Matrix2d monodromy;
    monodromy << xi[0], xi[0] * period + xi[1], xi[2], xi[2] * period + xi[3];
    ExpectEigenvalues(monodromy, {first, second});
  };
  expect_eigenvalues(saltation(impact.time, impact.before), orbit.first, orbit.second);
  expect_eigenvalues(saltation(-phase, std::vector{-y, -v}), orbit.other_first, orbit.other_second);
}

TEST(HybridReference, OrbitsOfTheJuggledBall) {
  ExpectOrbit({.amplitude = 0.025,
               .phase = 0.041448258402558381342,
               .height = 0.012440530678890510706,
               .acceleration = -1.9645298614442395344,
               .map = {1, 0.1834862385321100917, -3.536153750599631162, -0.008835550568739662743},
               .saltation = {-0.8, 0, 5.182328898862520674, -0.8},
               .first = {0.4955822247156301686, 0.6280113522428608475},
               .second = {0.4955822247156301686, -0.6280113522428608475},
               .other_first = 1.962764917019969959,
               .other_second = 0.3260706335487697036});
  ExpectOrbit({.amplitude = 0.25,
               .phase = 0.11808880949516617047,
               .height = 0.24905775796704750709,
               .acceleration = -39.329624706512325539,
               .map = {1, 0.1834862385321100917, -70.79332447172218597, -12.34960082049948366},
               .saltation = {-0.8, 0, -19.49920164099896733, -0.8},
               .first = -0.05667263525470900486,
               .second = -11.29292818524477466,
               .other_first = 14.58572229415069538,
               .other_second = 0.04387852634878828503});
}

TEST(HybridReference, CartPoleBetweenWalls) {
  Motion run(HybridSystem(CartPole()),
             {.initial = {0.1, 0.4, 1.2, -0.3},
              .parameters = {0.8},
              .duration = 2,
              .num_intervals = 20,
              .control = {6, 5, 3, 1, -2, -4, -5, -5, -3, 0, 2, 4, 5, 5, 4, 2, 0, -1, -2, -2}});
  run.ExpectTimes({0.2781555432359811484, 1.0538795455023244823, 1.6062507334999344654}, 1e-13);
  ExpectMatrix({run.simulator.events()[0].before.begin(), run.simulator.events()[0].before.end()},
               {0.6, 0.276440885119771601, 2.24166884961540882, -0.42375971111038314});
  ExpectMatrix({run.simulator.events()[0].after.begin(), run.simulator.events()[0].after.end()},
               {0.6, 0.276440885119771601, -1.79333507969232705, 7.33985360031737369});
  std::vector<By> by = {kValue, X(0), X(1), X(2), X(3), P(0)};
  for (int i = 0; i < 20; ++i) by.push_back(U(i));
  run.ExpectFinal(
      {
          {"state", {-0.29906553238588283639, -0.19669431314799779745, -2.5487788682324296123, -3.0267410664953559377}},
          {"x0", {-0.0798615785161877567, 10.4098784636312094, -4.98197635374383437, 47.4043378222327523}},
          {"theta0", {8.21473735053296226, -47.4852445417273769, 32.8417231955435245, -243.018953991850026}},
          {"v0", {3.84984486983378971, -27.1055747139217201, 17.7860301341708461, -135.604119411969182}},
          {"omega0", {2.49092955841994897, -14.8902198163162749, 10.2081715927454078, -75.9017494880814829}},
          {"e", {-0.29822258945378904, -33.5748232488621536, 13.5118378191169805, -154.93829929387182}},
          {"u0", {-0.01550915028876701, -0.335344855266172394, 0.145258972422265652, -1.44341125203038326}},
          {"u1", {0.0431862771176928361, -0.773649140391330808, 0.425927920640483992, -3.62742244378052604}},
          {"u2", {0.0262771292766434176, -0.458129852281209149, 0.252340093901491189, -2.15170123203642662}},
          {"u3", {0.0459693903770291587, 0.454261935476788876, -0.158201919172275271, 1.87430946918296869}},
          {"u4", {0.234913067268403381, -0.868708209912945365, 0.71230959244877243, -4.75228101844670891}},
          {"u5", {0.491155986174389862, -2.63889471735410172, 1.88082384184224002, -13.6341259421768023}},
          {"u6", {0.417042975016264659, -2.22028591684489311, 1.59056057509101976, -11.4834291239264256}},
          {"u7", {0.164566486795267938, -0.618503759513125911, 0.511801528393683537, -3.36783765435111799}},
          {"u8", {0.0397498910698838499, 0.138125857937206385, -0.00365624189450730598, 0.488337269763669718}},
          {"u9", {-0.000871165783678824068, 0.337482417934938266, -0.147681313820280729, 1.53606284042523814}},
          {"u10", {0.00133225405119829729, -0.00481217107158547547, 0.00246658401561809266, -0.0293066980776673971}},
          {"u11", {0.0188204467231161027, -0.407284211732344418, 0.193335732420839748, -1.93655734857284118}},
          {"u12", {0.0323805855549511514, -0.425919189802658827, 0.221708457472240196, -2.07923814969412842}},
          {"u13", {0.0416699800278969442, -0.392911775968588132, 0.229394155768707116, -1.97261240248194788}},
          {"u14", {0.0227103977024162229, -0.232772833049192328, 0.134467253903046841, -1.19399566314833797}},
          {"u15", {-0.012969345729464282, -0.0549203140170367077, -0.0120135753961842502, -0.279755838271481525}},
          {"u16", {0.0261262012905245547, -0.0231319021318990481, 0.0802282291619977988, -0.119184920698837978}},
          {"u17", {0.0240632515075828095, -0.0427049516353844725, 0.101870650577695634, -0.246220399651288568}},
          {"u18", {0.0150096101030501177, -0.0306747594877331274, 0.101799383233400693, -0.238334701927325273}},
          {"u19", {0.0049914471122442824, -0.0101210290561010524, 0.0993648647250530274, -0.204423907624433365}},
      },
      by);
}

// The loss of the hopper of two masses and its gradient: int u^2 dt + 20 (H(T) - 0.6)^2 with the height of its hop H.
double HopLoss(Motion* run, std::vector<double>* gradient, double* height) {
  const TwoMassHopper hopper;
  const std::span<const double> x = run->simulator.final_state();
  const double m = hopper.m1 + hopper.m2, yc = (hopper.m1 * x[0] + hopper.m2 * x[2]) / m;
  const double vc = (hopper.m1 * x[1] + hopper.m2 * x[3]) / m, h = run->input.duration / run->input.num_intervals;
  *height = yc + vc * vc / (2 * hopper.g);
  const double by_height = 40 * (*height - 0.6), by_speed = by_height * vc / hopper.g / m;
  *gradient =
      run->simulator
          .Adjoint(std::vector<double>{
              by_height * hopper.m1 / m, by_speed * hopper.m1, by_height * hopper.m2 / m, by_speed * hopper.m2, 0})
          .control;
  double loss = 20 * (*height - 0.6) * (*height - 0.6);
  for (size_t i = 0; i < run->input.control.size(); ++i) {
    loss += h * run->input.control[i] * run->input.control[i];
    (*gradient)[i] += 2 * h * run->input.control[i];
  }
  return loss;
}

TEST(HybridReference, TwoMassHopper) {
  HybridInput input{.initial = {0.6, 0, 0.1, 0, 0.5}, .duration = 0.5, .num_intervals = 20};
  input.control.assign(20, 0.0);
  std::vector<double> gradient;
  double height = 0;
  Motion still(HybridSystem(TwoMassHopper()), input);
  EXPECT_NEAR(HopLoss(&still, &gradient, &height), 0.3656630062208, 1e-12);
  EXPECT_NEAR(height, 0.4647848, 1e-12);
  still.ExpectTimes({0.142784312292706, 0.401419709936580}, 1e-14 / 0.14);
  ExpectMatrix({still.simulator.final_state().begin(), still.simulator.final_state().end()},
               {0.5600073095073789, -0.1355395831795915, 0.0818371018328709, 0.9914427187144383, 0.5},
               2e-12);
  ExpectMatrix(gradient,
               {-0.124795883116,
                -0.0993380850012,
                -0.0296888417396,
                0.0331899412488,
                0.0432902609832,
                -0.00679228313108,
                -0.085872359461,
                -0.168885894165,
                -0.242535788759,
                -0.295463310061,
                -0.319505654904,
                -0.310954867132,
                -0.271129701067,
                -0.206172235226,
                -0.12610060374,
                -0.0432639389842,
                -0.000117963318805,
                0,
                0,
                0},
               2e-12);

  input.control = {0.1164174207551,
                   0.0801219615391,
                   -0.0119226503213,
                   -0.0923679615707,
                   -0.1023526529555,
                   -0.0345374087872,
                   0.0696361221565,
                   0.1786793144343,
                   0.2752827807502,
                   0.3445477489516,
                   0.3757917557821,
                   0.3641961611176,
                   0.3115493078559,
                   0.2259707128343,
                   0.1206588257252,
                   0.0196860350607,
                   0,
                   0,
                   0,
                   0};
  Motion best(HybridSystem(TwoMassHopper()), input);
  EXPECT_NEAR(HopLoss(&best, &gradient, &height), 0.0184634928516979, 1e-12);
  EXPECT_NEAR(height, 0.593873732801498, 1e-12);
  best.ExpectTimes({0.141609893504157, 0.390193881283024}, 1e-12);
  ExpectMatrix({best.simulator.final_state().begin(), best.simulator.final_state().end()},
               {0.67808877961454, 0.32694504488798, 0.16886189833144, 1.6329130366939, 0.5560339368332});
  ExpectMatrix(gradient, std::vector<double>(20), 2e-12);

  Eigen::MatrixXd hessian(20, 20);
  const double d = 1e-4;
  for (int j = 0; j < 20; ++j) {
    std::vector<double> sides[2];
    for (const int side : {0, 1}) {
      HybridInput moved = input;
      moved.control[j] += side == 0 ? -d : d;
      Motion run(HybridSystem(TwoMassHopper()), moved);
      HopLoss(&run, &sides[side], &height);
    }
    for (int i = 0; i < 20; ++i) hessian(i, j) = (sides[1][i] - sides[0][i]) / (2 * d);
  }
  EXPECT_NEAR((hessian - hessian.transpose()).cwiseAbs().maxCoeff(), 0, 1e-7);
  EXPECT_NEAR(EigenOf(hessian).values[0], 0.0317, 5e-5);
}

TEST(HybridReference, RockingBlock) {
  const std::vector<Row> rows = {
      {"value",
       {0.0408293336232718114,
        -0.0287593129333272783,
        1.14703360806404729,
        2.57237006314742113,
        3.69845312175860557,
        4.64007190562936983,
        5.44882995453136695,
        6.15440660840249003}},
      {"theta0",
       {0.62830978334533392,
        15.957516879895722,
        10.20116126018987,
        13.776066227853694,
        15.726570403097512,
        17.06000222453494,
        18.066317865426795,
        18.868660496823028}},
      {"alpha",
       {-1.3490295087734346,
        -29.661562650033,
        -8.1543805012041025,
        -14.360701746071124,
        -19.573777570693782,
        -24.387367491359698,
        -28.964151960275129,
        -33.366713308149083}},
      {"p",
       {-0.093467767033313654,
        -2.7138129427325152,
        -0.57351680403202365,
        -1.2861850315737106,
        -1.8492265608793028,
        -2.3200359528146849,
        -2.7244149772656835,
        -3.077203304201245}},
  };
  Motion run(HybridSystem(RockingBlock()), {.initial = {0.2, 0}, .parameters = {0.25, 2}, .duration = 6.5});
  std::vector<Row> table;
  for (const Row& row : rows) table.push_back({row.name, {row.values[0], row.values[1]}});
  const std::vector<By> by = {kValue, X(0), P(0), P(1)};
  run.ExpectFinal(table, by);
  run.ExpectTimes({rows[0].values.begin() + 2, rows[0].values.end()});
  double speed = 0.48857211287032306358;
  for (const HybridEvent& impact : run.simulator.events()) {
    EXPECT_NEAR(std::abs(impact.before[1]), speed, 1e-12);
    speed *= 0.90818692141777953709;
  }
  for (int event = 0; event < 6; ++event) {
    for (size_t row = 1; row < rows.size(); ++row) {
      ExpectClose(run.Forward(event, -1, by[row]), rows[row].values[2 + event], kDerivative, rows[row].name);
    }
  }
}

TEST(HybridReference, LinearRockingBlock) {
  Motion run(HybridSystem(RockingBlock{.linear = true}),
             {.initial = {0.2, 0}, .parameters = {0.25, 2}, .duration = 6.5});
  run.ExpectTimes({1.1462158347805888,
                   2.5673621575936953,
                   3.6890034922419481,
                   4.6262212372730488,
                   5.4307408768727564,
                   6.132301400915311});
  run.ExpectFinal({{"state", {0.0397330800660441952, -0.0491179742255871286}}}, {kValue});
  // A quarter of the period without loss ends at the first impact.
  EXPECT_NEAR(4 * run.simulator.events()[0].time, 4.584863339122355376, 1e-12);
}

TEST(HybridReference, Thermostat) {
  Motion run(HybridSystem(Thermostat()), {.initial = {15, 0}, .parameters = {0.2, 10, 18, 20}, .duration = 6});
  run.ExpectTimes({0.77075339913629,
                   1.2975559774254,
                   1.6202485831133,
                   2.1470511614024,
                   2.4697437670903,
                   2.9965463453794,
                   3.3192389510673,
                   3.8460415293564,
                   4.1687341350442,
                   4.6955367133334,
                   5.0182293190212,
                   5.5450318973104,
                   5.8677245029982},
                  3e-14 / 0.77);
  EXPECT_EQ(run.simulator.final_mode(), Thermostat::kOff);
  run.ExpectFinal(
      {
          {"value", {19.4778354235669834, 112.9562745453364166}},
          {"y0", {-0.55650958353048524, 0.639690774795283343}},
          {"a", {-32.8108775289848589, 1.41480422143316288}},
          {"b", {-1.68112270024834083, 0.362777715177885123}},
          {"low", {-10.1447059497744705, 3.8485297488723526}},
          {"high", {11.362070663747407, 1.52298001459629842}},
      },
      {kValue, X(0), P(0), P(1), P(2), P(3)});

  // The cycle, from where it is switched on: it begins at `low`, a parameter.
  Motion cycle(HybridSystem(Thermostat()), {.initial = {18, 0}, .parameters = {0.2, 10, 18, 20}, .duration = 1});
  const HybridEvent& end = cycle.simulator.events()[1];
  const double period = end.time, mean = end.after[1] / period;
  const std::vector<Row> rows = {
      {"value", {18.99319806482843635, 0.8494951839769873645}},
      {"a", {0.0867910953893213001, -1.643309253218270156}},
      {"b", {-0.001735821907786426002, -0.05208333333333333333}},
      {"low", {0.5074490792903108891, -0.4340277777777777778}},
      {"high", {0.4938236428340352301, 0.4166666666666666667}},
  };
  EXPECT_NEAR(mean, rows[0].values[0], 1e-11);
  EXPECT_NEAR(period, rows[0].values[1], 1e-12);
  EXPECT_NEAR(cycle.simulator.events()[0].time, 0.3226926056878558584, 1e-13);
  EXPECT_NEAR(period - cycle.simulator.events()[0].time, 0.5268025782891315061, 1e-13);
  for (int p = 0; p < 4; ++p) {
    double by_period = cycle.Forward(1, -1, P(p)), by_integral = cycle.Forward(1, 1, P(p));
    if (p == 2) {
      by_period += cycle.Forward(1, -1, X(0));
      by_integral += cycle.Forward(1, 1, X(0));
    }
    ExpectClose((by_integral - mean * by_period) / period, rows[1 + p].values[0], kDerivative, rows[1 + p].name);
    ExpectClose(by_period, rows[1 + p].values[1], kDerivative, rows[1 + p].name);
  }
}

TEST(HybridReference, BoostConverter) {
  const std::vector<double> parameters = {0.5, 0.5, 10, 10, 3.5, 4.5};
  const HybridSystem system{BoostConverter()};
  Motion run(system, {.initial = {3.5, 18, 0}, .parameters = parameters, .duration = 0.9});
  EXPECT_EQ(run.simulator.final_mode(), BoostConverter::kOn);
  ASSERT_EQ(run.simulator.events().size(), 16u);
  EXPECT_NEAR(run.simulator.events()[15].time, 0.884084363412062809, 1e-12);
  run.ExpectFinal(
      {
          {"state", {3.818312731758743823, 18.59052992471162687, 16.42360974004356761}},
          {"i0", {1.17043236329260412, -0.101142668960869915, 0.164075789877576539}},
          {"v0", {0.946846462736689549, 0.470903501590257523, 0.747496075788862197}},
          {"L", {-35.459289028836734, 7.58150060882733524, -0.212954945097650715}},
          {"C", {-0.540710971163265993, -0.888909835931149561, -0.402779439296142446}},
          {"R", {0.169250926467468598, 0.234932384578875622, 0.129536026874769098}},
          {"Vin", {-0.127645656509836386, 0.352973782791899285, 0.157840785999711121}},
          {"low", {17.4735142033647244, -3.33712237493292163, 0.12420961177621228}},
          {"high", {-17.1560622257119898, 4.13743482706583756, 0.0847274689019279962}},
      },
      {kValue, X(0), X(1), P(0), P(1), P(2), P(3), P(4), P(5)});

  // The periodic orbit, from where it is switched on at i = low.
  double v = 19;
  HybridInput input{.initial = {3.5, v, 0}, .parameters = parameters, .duration = 0.12};
  for (int i = 0; i < 8; ++i) {
    input.initial[1] = v;
    Motion step(system, input);
    v -= (step.simulator.events()[1].after[1] - v) / (step.Forward(1, 1, X(1)) - 1);
  }
  input.initial[1] = v;
  Motion cycle(system, input);
  const std::vector<Row> rows = {
      {"value", {20.00199721387032009, 0.09996837040387615125, 20.09782222826927889}},
      {"L", {0.00382204490352397647, 0.199872724311724832, 0.195453210895077791}},
      {"C", {-0.00382204490352397647, 0.0000640164960274707581, -0.195453210895077791}},
      {"R", {0.999700870091048344, -0.00499101747492048913, 0.995344485732288973}},
      {"Vin", {1.00011664680563127, -0.00499941791586437892, 0.994892416005131137}},
      {"low", {1.24561637336221237, -0.106144061010870648, 1.16102410409241534}},
      {"high", {1.25359409756583647, 0.0936663094881535679, 1.35229193419878085}},
  };
  const HybridEvent& end = cycle.simulator.events()[1];
  const double period = end.time, mean = end.after[2] / period;
  EXPECT_NEAR(mean, rows[0].values[0], 1e-10 * mean);
  EXPECT_NEAR(period, rows[0].values[1], 1e-11 * period);
  EXPECT_NEAR(v, rows[0].values[2], 1e-11 * v);
  EXPECT_NEAR(cycle.simulator.events()[0].time, 0.05, 1e-13);
  EXPECT_NEAR(cycle.simulator.events()[0].before[1], 19.8978455558183338, 1e-10);
  const double eigenvalue = cycle.Forward(1, 1, X(1));
  EXPECT_NEAR(eigenvalue, 0.9607929548009939984, 1e-10);
  for (int p = 0; p < 6; ++p) {
    // The start moves with the parameter: i = low, and v by the implicit function theorem.
    const auto by = [&](int component, double of_v) {
      return cycle.Forward(1, component, P(p)) + (p == 4 ? cycle.Forward(1, component, X(0)) : 0.0) +
             of_v * cycle.Forward(1, component, X(1));
    };
    const double of_v = by(1, 0) / (1 - eigenvalue), of_period = by(-1, of_v);
    ExpectClose(of_v, rows[1 + p].values[2], 1e-9, rows[1 + p].name);
    ExpectClose(of_period, rows[1 + p].values[1], 1e-9, rows[1 + p].name);
    ExpectClose((by(2, of_v) - mean * of_period) / period, rows[1 + p].values[0], 1e-9, rows[1 + p].name);
  }
}

}  // namespace
}  // namespace saltus
