// Losses of hybrid systems, their gradients, and solvers by single shooting on problems whose optima are known.
#include "saltus/hybrid/hybrid_problem.h"

#include <ceres/autodiff_cost_function.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <cstdint>
#include <limits>
#include <memory>
#include <numeric>
#include <utility>
#include <vector>

#include "control/hybrid_shooting.h"
#include "problems/hybrid_systems.h"
#include "saltus/solve/hybrid_solver.h"

namespace saltus {
namespace {

using testing::HasSubstr;

SolverOptions Iterations(int iterations) {
  SolverOptions options;
  options.limits.iterations = iterations;
  return options;
}

// A cost of state (2), parameters (2) and time.
struct OfEvents {
  template <typename T>
  bool operator()(const T* x, const T* p, const T* t, T* residuals) const {
    residuals[0] = 0.3 * x[1] + p[1] * t[0];
    residuals[1] = 0.2 + t[0] * t[0];
    return true;
  }
};

// A cost of state (2), control (1), parameters (2), time and length.
struct OfIntervals {
  template <typename T>
  bool operator()(const T* x, const T* u, const T* p, const T* t, const T* h, T* residual) const {
    residual[0] = h[0] * (x[0] * u[0] + 0.1 * p[0] - t[0] * x[1]);
    return true;
  }
};

HybridProblem BallWithAllKindsOfTerms() {
  HybridProblem problem{.system = HybridSystem(BouncingBall()),
                        .guess = {.initial = {1.3, 0.4},
                                  .parameters = {9.81, 0.8},
                                  .duration = 2,
                                  .num_intervals = 7,
                                  .control = {1, -2, 0.5, 3, -1, 2, 0.7}}};
  problem.terms = {MakeTerminalCost(0, 1.0, 3.0, 2),
                   MakeTerminalCost(1, -0.5, 0.7, 2, 0),
                   MakeEffortCost(0.1, 1),
                   MakeDurationCost(0.4)};
  HybridTerm events{.name = "events",
                    .at = HybridTerm::Timing::kEvent,
                    .mode = 0,
                    .event = "ground",
                    .with_state = true,
                    .with_parameters = true,
                    .with_time = true};
  events.function = std::make_shared<ceres::AutoDiffCostFunction<OfEvents, 2, 2, 2, 1>>(new OfEvents);
  problem.terms.push_back(events);
  events.before = true;
  problem.terms.push_back(events);
  HybridTerm intervals{.name = "intervals",
                       .at = HybridTerm::Timing::kEachInterval,
                       .with_state = true,
                       .with_control = true,
                       .with_parameters = true,
                       .with_time = true,
                       .with_length = true};
  intervals.function = std::make_shared<ceres::AutoDiffCostFunction<OfIntervals, 1, 2, 1, 2, 1, 1>>(new OfIntervals);
  problem.terms.push_back(intervals);
  problem.free = {.control = true, .initial = {1, 0}, .parameters = {1, 0}, .duration = true};
  return problem;
}

TEST(HybridShooting, GradientAgreesWithDifferences) {
  HybridShooting shooting(BallWithAllKindsOfTerms());
  ASSERT_EQ(shooting.num_variables(), 12);
  std::vector<double> z = shooting.initial_guess(), gradient(12);
  double loss = 0;
  ASSERT_TRUE(shooting.Evaluate(z, &loss, gradient.data())) << shooting.FailureReason();
  EXPECT_EQ(shooting.simulator().events().size(), 2u);
  for (int i = 0; i < 12; ++i) {
    const double width = 1e-3, at = z[i];
    double values[4];
    const double places[] = {-2, -1, 1, 2};
    for (int j = 0; j < 4; ++j) {
      z[i] = at + places[j] * width;
      ASSERT_TRUE(shooting.Evaluate(z, &values[j], nullptr));
    }
    z[i] = at;
    const double difference = (values[0] - 8 * values[1] + 8 * values[2] - values[3]) / (12 * width);
    EXPECT_NEAR(gradient[i], difference, 1e-8 * std::max(1.0, std::abs(difference))) << i;
  }
}

// Expects that the sum of the squares of the residuals is the loss, and 2 J' r its gradient.
void ExpectResidualsOfTheLoss(HybridShooting* given) {
  HybridShooting& shooting = *given;
  const int rows = shooting.num_residuals(), columns = shooting.num_variables();
  std::vector<double> residuals(rows), jacobian(rows * columns), gradient(columns);
  double loss = 0;
  ASSERT_TRUE(shooting.Evaluate(shooting.initial_guess(), &loss, gradient.data())) << shooting.FailureReason();
  ASSERT_TRUE(shooting.EvaluateResiduals(shooting.initial_guess(), residuals.data(), jacobian.data()));
  EXPECT_NEAR(std::inner_product(residuals.begin(), residuals.end(), residuals.begin(), 0.0), loss, 1e-12 * loss);
  for (int j = 0; j < columns; ++j) {
    double sum = 0;
    for (int i = 0; i < rows; ++i) sum += 2 * residuals[i] * jacobian[i * columns + j];
    EXPECT_NEAR(sum, gradient[j], 1e-11 * std::max(1.0, std::abs(sum))) << j;
  }
}

TEST(HybridShooting, ResidualsAgreeWithTheLoss) {
  HybridProblem problem = BallWithAllKindsOfTerms();
  for (HybridTerm& term : problem.terms) {
    if (term.at == HybridTerm::Timing::kEvent) term.occurrence = term.before ? 0 : 1;
  }
  HybridShooting shooting(problem);
  EXPECT_EQ(shooting.num_residuals(), 1 + 1 + 7 + 1 + 2 + 2 + 7);
  ExpectResidualsOfTheLoss(&shooting);
}

// Also where there are more events than rows for them.
TEST(HybridShooting, ResidualsOfCostsAtEachEventAgreeWithTheLoss) {
  HybridProblem problem = BallWithAllKindsOfTerms();
  HybridShooting few(problem);
  ExpectResidualsOfTheLoss(&few);
  EXPECT_EQ(few.simulator().events().size(), 2u);
  problem.guess.parameters[1] = 0.95;
  problem.guess.duration = 14;
  problem.guess.control.assign(7, 0.1);
  HybridShooting many(problem);
  ExpectResidualsOfTheLoss(&many);
  EXPECT_GT(many.simulator().events().size(), 17u);
  EXPECT_EQ(many.num_residuals(), few.num_residuals()) << "their number does not change with the motion";
}

// A ball that six forces push, which act at weights that the height changes.
struct PushedBall {
  static constexpr int kNumControls = 6, kNumParameters = 1;
  static constexpr std::array kStateSizes = {2};
  static constexpr std::array kNumGuards = {1};
  template <typename T>
  void Flow(int, const T& t, const T* x, const T* u, const T*, T* xdot) const {
    xdot[0] = x[1];
    xdot[1] = T(-9.81) - 0.1 * x[1] * t;
    for (int i = 0; i < 6; ++i) xdot[1] += u[i] * (1.0 + 0.1 * i * x[0]);
  }
  template <typename T>
  T Guard(int, int, const T&, const T* x, const T*) const {
    return x[0];
  }
  template <typename T>
  int Reset(int, int, const T&, const T* x, const T* p, T* x_plus) const {
    x_plus[0] = x[0];
    x_plus[1] = -p[0] * x[1];
    return 0;
  }
};
struct HeightTimesSpeed {
  template <typename T>
  bool operator()(const T* x, const T* h, T* residual) const {
    residual[0] = h[0] * x[0] * x[1];
    return true;
  }
};

// With six controls an interval has more variables than rows, whose derivatives are reverse sweeps.
TEST(HybridShooting, RowsAgreeWithDifferences) {
  constexpr int kIntervals = 5;
  HybridProblem problem{.system = HybridSystem(PushedBall()),
                        .guess = {.initial = {1.3, 0.4},
                                  .parameters = {0.8},
                                  .duration = 1.2,
                                  .num_intervals = kIntervals,
                                  .control = std::vector<double>(6 * kIntervals, 0.3)},
                        .terms = {MakeTerminalCost(0, 1.0, 3.0, 2), MakeEffortCost(0.1, 6)}};
  for (size_t i = 0; i < problem.guess.control.size(); ++i) problem.guess.control[i] += 0.1 * std::sin(1.0 + i);
  HybridTerm intervals{
      .name = "intervals", .at = HybridTerm::Timing::kEachInterval, .with_state = true, .with_length = true};
  intervals.function = std::make_shared<ceres::AutoDiffCostFunction<HeightTimesSpeed, 1, 2, 1>>(new HeightTimesSpeed);
  problem.terms.push_back(intervals);
  problem.free = {.control = true, .initial = {1, 0}, .parameters = {0}, .duration = true};
  HybridShooting shooting(problem);
  const int rows = shooting.num_residuals(), columns = shooting.num_variables();
  ASSERT_EQ(rows, 1 + 6 * kIntervals + kIntervals);
  std::vector<double> z = shooting.initial_guess(), residuals(rows), jacobian(rows * columns);
  ASSERT_TRUE(shooting.EvaluateResiduals(z, residuals.data(), jacobian.data())) << shooting.FailureReason();
  EXPECT_EQ(shooting.simulator().events().size(), 1u);
  for (int j = 0; j < columns; ++j) {
    constexpr double kWidth = 1e-3;
    const double at = z[j];
    std::vector<std::vector<double>> moved;
    for (const double place : {-2, -1, 1, 2}) {
      z[j] = at + place * kWidth;
      ASSERT_TRUE(shooting.EvaluateResiduals(z, moved.emplace_back(rows).data(), nullptr));
    }
    z[j] = at;
    for (int i = 0; i < rows; ++i) {
      const double difference = (moved[0][i] - 8 * moved[1][i] + 8 * moved[2][i] - moved[3][i]) / (12 * kWidth);
      EXPECT_NEAR(jacobian[i * columns + j], difference, 1e-8 * std::max(1.0, std::abs(difference))) << i << ' ' << j;
    }
  }
}

// Masses in a row with springs, of which a force pushes the first: the derivative of the flow has few entries.
struct Chain {
  static constexpr int kMasses = 12, kNumControls = 1, kNumParameters = 1;
  static constexpr std::array kStateSizes = {2 * kMasses};
  static constexpr std::array kNumGuards = {0};
  template <typename T>
  void Flow(int, const T&, const T* x, const T* u, const T* p, T* xdot) const {
    for (int i = 0; i < kMasses; ++i) {
      xdot[i] = x[kMasses + i];
      T force = i == 0 ? u[0] : T(0.0);
      for (const int other : {i - 1, i + 1}) {
        if (other < 0 || other == kMasses) continue;
        const T stretch = x[other] - x[i];
        force += p[0] * stretch + 0.1 * stretch * stretch * stretch;
      }
      xdot[kMasses + i] = force;
    }
  }
  template <typename T>
  T Guard(int, int, const T&, const T*, const T*) const {
    return T(1.0);
  }
  template <typename T>
  int Reset(int, int, const T&, const T*, const T*, T*) const {
    return 0;
  }
};

TEST(HybridShooting, RowsOfALargeSystemAgreeWithDifferences) {
  constexpr int kStates = 2 * Chain::kMasses, kIntervals = 3;
  HybridProblem problem{.system = HybridSystem(Chain()),
                        .guess = {.initial = std::vector<double>(kStates, 0.1),
                                  .parameters = {2.0},
                                  .duration = 3,
                                  .num_intervals = kIntervals,
                                  .control = {1, -0.5, 0.3}}};
  for (int i = 0; i < kStates; ++i) problem.terms.push_back(MakeTerminalCost(i, 0.0, 1.0, kStates));
  problem.free = {.control = true, .initial = {0, kStates - 1}, .parameters = {0}, .duration = true};
  HybridShooting shooting(problem);
  const int rows = shooting.num_residuals(), columns = shooting.num_variables();
  ASSERT_EQ(rows, kStates);
  std::vector<double> z = shooting.initial_guess(), residuals(rows), jacobian(rows * columns);
  ASSERT_TRUE(shooting.EvaluateResiduals(z, residuals.data(), jacobian.data())) << shooting.FailureReason();
  for (int j = 0; j < columns; ++j) {
    constexpr double kWidth = 1e-3;
    const double at = z[j];
    std::vector<std::vector<double>> moved;
    for (const double place : {-2, -1, 1, 2}) {
      z[j] = at + place * kWidth;
      ASSERT_TRUE(shooting.EvaluateResiduals(z, moved.emplace_back(rows).data(), nullptr));
    }
    z[j] = at;
    for (int i = 0; i < rows; ++i) {
      const double difference = (moved[0][i] - 8 * moved[1][i] + 8 * moved[2][i] - moved[3][i]) / (12 * kWidth);
      EXPECT_NEAR(jacobian[i * columns + j], difference, 1e-8 * std::max(1.0, std::abs(difference))) << i << ' ' << j;
    }
  }
}

// The example of the sensitivity tutorials whose published answer, 0.8666 with loss 0.3995, is a local minimum.
TEST(HybridSolvers, FindTheRestitutionOfTheTutorial) {
  HybridProblem problem{.system = HybridSystem(BouncingBall()),
                        .guess = {.initial = {50, 0}, .parameters = {9.8, 0.98}, .duration = 15},
                        .terms = {MakeTerminalCost(0, 20.0, 1.0, 2)}};
  problem.free.parameters = {1};
  problem.free.parameters_min = {0.75};
  problem.free.parameters_max = {1};
  const SolveReport report = Solve("ceres_lm", problem, Iterations(50));
  EXPECT_EQ(report.termination, Termination::kConverged) << report.reason;
  EXPECT_NEAR(report.solution.parameters[1], 0.988008392024876511903389, 1e-12);
  EXPECT_LT(report.solution.loss, 1e-18);
  EXPECT_LT(report.solution.integration_error, 1e-12);

  problem.guess.parameters[1] = 0.866;
  const SolveReport published = Solve("ceres_lm", problem, Iterations(200));
  EXPECT_NEAR(published.solution.parameters[1], 0.866554105436901, 1e-6);
  EXPECT_NEAR(published.solution.loss, 0.3995468507, 1e-9);
}

TEST(HybridSolvers, FindTheStartOfTheSwitchedLine) {
  const HybridProblem problem = SwitchedLineProblem();
  for (const char* solver : {"ceres_lbfgs", "ceres_lm", "gd"}) {
    SolverOptions options = Iterations(400);
    options.descent.learning_rate = 0.3;
    const SolveReport report = Solve(solver, problem, options);
    EXPECT_NEAR(report.solution.initial_state[0], -1.42757223208276713401017, 1e-8) << solver << ": " << report.reason;
    EXPECT_NEAR(report.solution.loss, 1.52377277537495711456099, 1e-12) << solver;
  }
}

// sqrt(20) (H - 0.6) with the height H of the hop, of a hopper in flight.
struct HopHeight {
  template <typename T>
  bool operator()(const T* x, T* residual) const {
    const TwoMassHopper hopper;
    const double m = hopper.m1 + hopper.m2;
    const T v = (hopper.m1 * x[1] + hopper.m2 * x[3]) / m;
    const T height = (hopper.m1 * x[0] + hopper.m2 * x[2]) / m + v * v / (2 * hopper.g);
    residual[0] = std::sqrt(20.0) * (height - 0.6);
    return true;
  }
};

TEST(HybridSolvers, FindTheHopOfTwoMasses) {
  HybridProblem problem{.system = HybridSystem(TwoMassHopper()),
                        .guess = {.initial = {0.6, 0, 0.1, 0, 0.5}, .duration = 0.5, .num_intervals = 20},
                        .terms = {MakeEffortCost(1.0, 1)}};
  HybridTerm hop{.name = "height", .mode = TwoMassHopper::kFlight, .with_state = true};
  hop.function = std::make_shared<ceres::AutoDiffCostFunction<HopHeight, 1, 5>>(new HopHeight);
  problem.terms.push_back(hop);
  problem.free.control = true;
  const std::vector<double> best = {0.1164174207551,
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
  for (const char* solver : {"ceres_lbfgs", "ceres_lm"}) {
    const SolveReport report = Solve(solver, problem, Iterations(200));
    EXPECT_EQ(report.termination, Termination::kConverged) << solver << ": " << report.reason;
    EXPECT_NEAR(report.solution.loss, 0.0184634928516979, 1e-12) << solver;
    ASSERT_EQ(report.solution.control.size(), best.size());
    for (size_t i = 0; i < best.size(); ++i) {
      EXPECT_NEAR(report.solution.control[i], best[i], 1e-8) << solver << " " << i;
    }
  }
}

// On a fixed grid every local minimum of the ball of hybrid iLQR has its impact where the control jumps.
TEST(HybridSolvers, NameTheKinkTheyStopAt) {
  HybridProblem problem{
      .system = HybridSystem(BouncingBall()),
      .guess = {.initial = {4, 0}, .parameters = {9.8, 0.7}, .duration = 1, .num_intervals = 50},
      .terms = {MakeTerminalCost(0, 1.0, 100.0, 2), MakeTerminalCost(1, 0.0, 100.0, 2), MakeEffortCost(1.0 / 32, 1)}};
  problem.free.control = true;
  const SolveReport report = Solve("ceres_lbfgs", problem, Iterations(1000));
  EXPECT_NE(report.termination, Termination::kConverged);
  EXPECT_GE(report.solution.loss, 2.1976626506629637918 - 1e-12) << "no motion on this grid is better";
  EXPECT_LT(report.solution.loss, 2.6);
  EXPECT_THAT(report.reason, HasSubstr("has an event at t = 0.7, where the control jumps"));
}

// Each solver is stopped at its first 20 questions and at 40 others, evenly spaced. The reported control must have the
// reported loss.
TEST(HybridSolvers, ReportAMotionAndItsLossWheneverTheyAreStopped) {
  HybridProblem problem = ControlledBallProblem();
  problem.guess.num_intervals = 20;
  problem.guess.control.assign(20, 0.0);
  for (const HybridSolverEntry& solver : HybridSolvers()) {
    int64_t asked = 0, most = std::numeric_limits<int64_t>::max();
    SolverOptions options = Iterations(50);
    options.threads = 1;
    options.monitor.stop = [&] { return ++asked > most; };
    Solve(solver.name, problem, options);
    const int64_t all = std::exchange(asked, 0);
    ASSERT_GT(all, 10) << solver.name;
    int interrupted = 0;
    for (int i = 0; i < 60; ++i) {
      most = i < 20 ? i : all * (i - 20) / 40;
      asked = 0;
      const SolveReport report = Solve(solver.name, problem, options);
      ASSERT_NE(report.termination, Termination::kFailed) << solver.name << most << report.reason;
      interrupted += report.termination == Termination::kInterrupted;
      if (report.history.losses.empty()) continue;
      HybridInput input = problem.guess;
      input.control = report.solution.control;
      input.lengths = report.solution.durations;
      HybridShooting::Outcome outcome;
      ASSERT_TRUE(HybridShooting(problem).Simulate(input, &outcome)) << solver.name << most;
      EXPECT_NEAR(outcome.loss, report.solution.loss, 1e-9 * report.guess.loss) << solver.name << " " << most;
    }
    EXPECT_GT(interrupted, 20) << solver.name;
  }
}

// Each of three controls is the rate of a state.
struct Rates {
  static constexpr int kNumControls = 3, kNumParameters = 0;
  static constexpr std::array kStateSizes = {3};
  static constexpr std::array kNumGuards = {0};
  template <typename T>
  void Flow(int, const T&, const T*, const T* u, const T*, T* xdot) const {
    std::copy_n(u, 3, xdot);
  }
  template <typename T>
  T Guard(int, int, const T&, const T* x, const T*) const {
    return x[0];
  }
  template <typename T>
  int Reset(int, int, const T&, const T* x, const T*, T* x_plus) const {
    std::copy_n(x, 3, x_plus);
    return 0;
  }
};

// By hand: with the effort w and the weight W of targets at distances c, the best control is constant, and the loss is
// W w c^2 / (w + W T). A free time of the price d each second is (W sqrt(w c^2 / d) - w) / W. The rows of three numbers
// do not fill blocks of eight variables.
TEST(HybridSolvers, CostsOfIntervalsOfThreeControls) {
  constexpr double kWeight = 2, kPrice = 0.3;
  constexpr std::array<double, 3> kTargets = {0.5, -1.0, 0.25};
  const double square = 0.25 + 1 + 0.0625;
  for (const int intervals : {1, 4, 7, 16}) {
    for (const bool free_time : {false, true}) {
      HybridProblem problem{.system = HybridSystem(Rates()),
                            .guess = {.initial = {0, 0, 0}, .duration = 0.8, .num_intervals = intervals},
                            .terms = {MakeEffortCost(0.1, 3)}};
      problem.guess.control.assign(3 * intervals, 0.2);
      for (int i = 0; i < 3; ++i) problem.terms.push_back(MakeTerminalCost(i, kTargets[i], kWeight, 3));
      HybridTerm once = MakeEffortCost(0.4, 3);  // in one interval alone
      once.interval = intervals - 1;
      problem.free.control = true;
      double time = 0.8, effort = 0.1;
      if (free_time) {
        problem.terms.push_back(MakeDurationCost(kPrice));
        problem.free.duration = true;
        time = (kWeight * std::sqrt(effort * square / kPrice) - effort) / kWeight;
      } else {
        problem.terms.push_back(once);  // a mean of efforts over time, as forces are in proportion to their inverse
        effort = intervals / ((intervals - 1) / effort + 1 / (effort + 0.4));
      }
      const double loss = kWeight * effort * square / (effort + kWeight * time) + (free_time ? kPrice * time : 0);
      const SolveReport report = Solve("ceres_lm", problem, {.limits = {.iterations = 300}});
      EXPECT_NEAR(report.solution.loss, loss, 1e-9) << intervals << free_time << report.reason;
    }
  }
}

// A ball that a force pushes: how fast it strikes the ground each time.
struct SpeedAtGround {
  template <typename T>
  bool operator()(const T* x, T* residual) const {
    residual[0] = 0.5 * (x[1] - 2.0);
    return true;
  }
};

// Levenberg-Marquardt has a row for each event, and ends where solvers that see the sum alone end. With intervals that
// move with the events the optimum is lower. No certificate denies any of them.
TEST(HybridSolvers, TakeCostsAtEachEvent) {
  HybridProblem problem{.system = HybridSystem(BouncingBall()),
                        .guess = {.initial = {1, 0},
                                  .parameters = {9.81, 0.8},
                                  .duration = 1.45,
                                  .num_intervals = 8,
                                  .control = std::vector<double>(8, 0.1)},
                        .terms = {MakeEffortCost(0.1, 1), MakeTerminalCost(1, 0.0, 0.1, 2)}};
  HybridTerm speed{.name = "speed", .at = HybridTerm::Timing::kEvent, .mode = 0, .event = "ground", .with_state = true};
  speed.function = std::make_shared<ceres::AutoDiffCostFunction<SpeedAtGround, 1, 2>>(new SpeedAtGround);
  problem.terms.push_back(speed);
  problem.free.control = true;
  const SolveReport least_squares = Solve("ceres_lm", problem, {}), gradient = Solve("ceres_lbfgs", problem, {});
  ASSERT_EQ(least_squares.termination, Termination::kConverged) << least_squares.reason;
  ASSERT_EQ(gradient.termination, Termination::kConverged) << gradient.reason;
  EXPECT_NEAR(least_squares.solution.loss, gradient.solution.loss, 1e-9 * gradient.solution.loss);
  EXPECT_LT(least_squares.solution.loss, 0.9 * least_squares.guess.loss);
  ASSERT_TRUE(least_squares.certificate);
  EXPECT_TRUE(least_squares.certificate->IsStationary()) << least_squares.certificate->reason;
  const SolveReport phases = Solve("ceres_phases", problem, {});
  ASSERT_EQ(phases.termination, Termination::kConverged) << phases.reason;
  EXPECT_LT(phases.solution.loss, least_squares.solution.loss);
  EXPECT_EQ(phases.certificate->verdict, Certificate::Verdict::kStationary) << phases.certificate->reason;
}

// A force that brings a mass back to where it began, by -1 of its speed, and not above a height: the optimum of Bryson
// and Denham in the form of squares, whose loss in continuous time is 4 / (9 L).
struct AboveHeight {
  template <typename T>
  bool operator()(const T* x, T* row) const {
    row[0] = x[0] - 1.0 / 9;
    return true;
  }
};
struct DoubleIntegrator {
  static constexpr int kNumControls = 1, kNumParameters = 1;
  static constexpr std::array kStateSizes = {2};
  static constexpr std::array kNumGuards = {0};
  template <typename T>
  void Flow(int, const T&, const T* x, const T* u, const T*, T* xdot) const {
    xdot[0] = x[1];
    xdot[1] = u[0];
  }
  template <typename T>
  T Guard(int, int, const T&, const T*, const T*) const {
    return T(1.0);
  }
  template <typename T>
  int Reset(int, int, const T&, const T*, const T*, T*) const {
    return 0;
  }
};

TEST(HybridSolvers, ShootingMeetsConstraints) {
  constexpr int kIntervals = 40;
  HybridProblem problem{
      .system = HybridSystem(DoubleIntegrator()),
      .guess = {.initial = {0, 1},
                .parameters = {0},
                .duration = 1,
                .num_intervals = kIntervals,
                .control = std::vector<double>(kIntervals, 0.0)},
      .terms = {MakeEffortCost(0.5, 1),
                MakeTerminalCost(0, 0.0, 1.0, 2),
                MakeTerminalCost(1, -1.0, 1.0, 2),
                {.name = "height",
                 .at = HybridTerm::Timing::kEachInterval,
                 .role = HybridTerm::Role::kInequality,
                 .with_state = true,
                 .function = std::make_shared<ceres::AutoDiffCostFunction<AboveHeight, 1, 2>>(new AboveHeight)}}};
  problem.terms[1].role = problem.terms[2].role = HybridTerm::Role::kEquality;
  problem.free.control = true;
  for (const double most : {1e3, 7.5}) {  // a bound on the control, too, that is active
    problem.free.control_min = {-most};
    problem.free.control_max = {most};
    const SolveReport shooting = Solve("ceres_lm", problem, {}), phases = Solve("ceres_phases", problem, {});
    ASSERT_EQ(shooting.termination, Termination::kConverged) << shooting.reason;
    ASSERT_EQ(phases.termination, Termination::kConverged) << phases.reason;
    EXPECT_GT(shooting.guess.violation, 0.5);
    EXPECT_LE(shooting.solution.violation, 1e-9);
    EXPECT_NEAR(shooting.solution.loss, phases.solution.loss, 1e-8 * phases.solution.loss);
    EXPECT_NEAR(shooting.solution.loss, 4, 0.2);
    ASSERT_TRUE(shooting.certificate);
    EXPECT_EQ(shooting.certificate->verdict, Certificate::Verdict::kStationary) << shooting.certificate->reason;
  }
}

TEST(HybridSolvers, SayWhatTheyCannotTake) {
  HybridProblem problem = BallWithAllKindsOfTerms();
  problem.terms[4].role = HybridTerm::Role::kEquality;
  EXPECT_THAT(Solve("ceres_lm", problem, {}).reason, HasSubstr("events is a constraint at each event"));
  problem.terms[4].role = HybridTerm::Role::kCost;
  EXPECT_THAT(Solve("newton", problem, {}).reason, HasSubstr("solver: found 'newton', expected a solver"));
  problem.free.parameters_min = {0.1, 9};
  EXPECT_THAT(Solve("ceres_lbfgs", problem, {}).reason, HasSubstr("bounds"));
  problem.terms[0].role = HybridTerm::Role::kEquality;
  EXPECT_THAT(Solve("gd", problem, {}).reason, HasSubstr("terminal cost of component 0 is a constraint"));
  EXPECT_EQ(Solve("gd", problem, {}).termination, Termination::kNotApplicable);
}

TEST(HybridShooting, AMotionWithoutTheEventOfATermHasNoLoss) {
  HybridProblem problem = BallWithAllKindsOfTerms();
  problem.terms[4].occurrence = 2;  // of two
  HybridShooting shooting(problem);
  double loss = 0;
  EXPECT_FALSE(shooting.Evaluate(shooting.initial_guess(), &loss, nullptr));
  EXPECT_THAT(shooting.FailureReason(),
              HasSubstr("events: found 2 events 'ground' in the motion, expected at least 3"));
}

TEST(HybridProblem, SaysWhatIsWrong) {
  const HybridProblem right = BallWithAllKindsOfTerms();
  EXPECT_EQ(Validate(right), "");
  const auto with = [&](auto change) {
    HybridProblem problem = right;
    change(&problem);
    return Validate(problem);
  };
  EXPECT_EQ(with([](HybridProblem* p) { p->terms[0].function = nullptr; }),
            "terminal cost of component 0: found no function");
  EXPECT_EQ(with([](HybridProblem* p) { p->terms[1].with_time = true; }),
            "terminal cost of component 1: found a function of blocks of sizes 2, expected 2 1");
  EXPECT_EQ(with([](HybridProblem* p) { p->terms[4].event = "wall"; }),
            "events: found the event 'wall', expected some of ground");
  EXPECT_EQ(with([](HybridProblem* p) { p->free.initial = {2}; }),
            "found number 2 of the initial state, expected 0 to 1");
  EXPECT_EQ(with([](HybridProblem* p) { p->free.control_min = {1, 2}; }), "found 2 bounds of the control, expected 1");
}

}  // namespace
}  // namespace saltus
