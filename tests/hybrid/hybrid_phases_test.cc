// Solvers along sequences of events on hybrid systems whose optima are known, and their certificates.
#include <ceres/autodiff_cost_function.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <algorithm>
#include <array>
#include <cmath>
#include <memory>
#include <string>
#include <vector>

#include "hybrid/reference_systems.h"
#include "saltus/hybrid/hybrid_problem.h"
#include "saltus/optimality/hybrid_certificate.h"
#include "saltus/solve/hybrid_solver.h"

namespace saltus {
namespace {

using testing::HasSubstr;
using enum Certificate::Verdict;

// The ball of hybrid iLQR (Kong, Payne, Council, Johnson 2021) in continuous time.
constexpr double kBallOptimum = 2.19588861030335207389072;

HybridProblem ControlledBall(int intervals) {
  HybridProblem problem{
      .system = HybridSystem(BouncingBall()),
      .guess = {.initial = {4, 0}, .parameters = {9.8, 0.7}, .duration = 1, .num_intervals = intervals},
      .terms = {MakeTerminalCost(0, 1.0, 100.0, 2), MakeTerminalCost(1, 0.0, 100.0, 2), MakeEffortCost(1.0 / 32, 1)}};
  problem.free.control = true;
  return problem;
}

TEST(HybridPhases, ReachTheOptimumOfTheBallByOrderTwo) {
  double last = 0;
  for (const int n : {50, 100, 200}) {
    const SolveReport report = Solve("ceres_phases", ControlledBall(n), {});
    ASSERT_EQ(report.termination, Termination::kConverged) << report.reason;
    EXPECT_LE(report.iterations, 30) << n;
    const double gap = (report.final_loss - kBallOptimum) * n * n;
    EXPECT_GT(gap, 1.5) << n;
    EXPECT_LT(gap, 2.0) << n;
    if (n > 50) {
      EXPECT_NEAR(gap, last, 0.05 * gap) << n;
    }
    last = gap;
    ASSERT_TRUE(report.certificate);
    EXPECT_EQ(report.certificate->verdict, kStationary) << report.certificate->reason;
    ASSERT_EQ(report.certificate->impacts.size(), 1u);
    const ImpactCertificate& impact = report.certificate->impacts[0];
    EXPECT_EQ(impact.a + "/" + impact.b, "flight/ground");
    EXPECT_NEAR(impact.time, 0.697936180950424916232723, 0.03 / (n * n));
    EXPECT_NEAR(impact.speed, 9.14598342235800406373598, 5.0 / (n * n));
    // The reset leaves no position, so that nu is the costate of the position before the impact.
    EXPECT_NEAR(impact.multiplier, 1.7832414292722467846, 5.0 / (n * n));
  }
}

TEST(HybridPhases, KeepBoundsOfTheControl) {
  HybridProblem problem = ControlledBall(50);
  problem.free.control_min = {-11};
  problem.free.control_max = {5};
  const SolveReport report = Solve("ceres_phases", problem, {});
  ASSERT_EQ(report.termination, Termination::kConverged) << report.reason;
  EXPECT_GT(report.final_loss, kBallOptimum);
  int at_bounds = 0;
  for (const double u : report.control) {
    EXPECT_GE(u, -11);
    EXPECT_LE(u, 5);
    at_bounds += u < -11 + 1e-6 || u > 5 - 1e-6;
  }
  EXPECT_GT(at_bounds, 2);
  ASSERT_TRUE(report.certificate);
  EXPECT_EQ(report.certificate->verdict, kStationary) << report.certificate->reason;
}

// The best control of the ball on a fixed grid whose impact is at the end of interval `line`, and its loss.
struct OnLine {
  HybridInput input;
  double loss = 0;
};
OnLine BestOnLine(const HybridProblem& problem, int line) {
  const int n = problem.guess.num_intervals;
  const double h = 1.0 / n, g = 9.8, e = 0.7, weight = 100, effort = 1.0 / 32;
  // Unknown are the controls and the speed V before the impact; minimized is |A z - b|^2 with C z = d.
  Eigen::MatrixXd A = Eigen::MatrixXd::Zero(n + 2, n + 1), C = Eigen::MatrixXd::Zero(2, n + 1);
  Eigen::VectorXd b = Eigen::VectorXd::Zero(n + 2), d(2);
  const double s = line * h, rest = 1 - s;
  for (int k = 0; k < n; ++k) {
    A(k, k) = std::sqrt(effort * h);
    const double left =
        (k < line ? s : 1.0) - (k + 0.5) * h;  // from the middle of the interval to the end of its phase
    if (k < line) {
      C(0, k) = h * left;
      C(1, k) = h;
    } else {
      A(n, k) = std::sqrt(weight) * h * left;
      A(n + 1, k) = std::sqrt(weight) * h;
    }
  }
  C(1, n) = 1;
  d << -(4 - 0.5 * g * s * s), g * s;
  A(n, n) = std::sqrt(weight) * e * rest;
  A(n + 1, n) = std::sqrt(weight) * e;
  b[n] = std::sqrt(weight) * (1 + 0.5 * g * rest * rest);
  b[n + 1] = std::sqrt(weight) * g * rest;
  Eigen::MatrixXd kkt = Eigen::MatrixXd::Zero(n + 3, n + 3);
  kkt.topLeftCorner(n + 1, n + 1) = A.transpose() * A;
  kkt.topRightCorner(n + 1, 2) = C.transpose();
  kkt.bottomLeftCorner(2, n + 1) = C;
  Eigen::VectorXd right(n + 3);
  right << A.transpose() * b, d;
  const Eigen::VectorXd z = kkt.fullPivLu().solve(right).head(n + 1);
  OnLine best{problem.guess, (A * z - b).squaredNorm()};
  best.input.control.assign(z.data(), z.data() + n);
  return best;
}

// On a fixed grid every local minimum of the ball has its impact at the end of an interval; reference values: the least
// losses and how many such lines there are.
TEST(HybridCertificate, NamesTheKinksOfAFixedGrid) {
  struct Row {
    int n, minima;
    std::vector<std::pair<int, double>> lines;
  };
  for (const Row& row :
       {Row{50, 2, {{35, 2.1976626506629637918}, {34, 2.2764510624727}}},
        Row{100,
            4,
            {{70, 2.1971835916003522223}, {69, 2.2122262662501}, {68, 2.2758162922396}, {67, 2.3833726276028}}}}) {
    const HybridProblem problem = ControlledBall(row.n);
    for (const auto& [line, loss] : row.lines) EXPECT_NEAR(BestOnLine(problem, line).loss, loss, 1e-12) << line;
    int minima = 0;
    for (int line = 3 * row.n / 5; line <= 4 * row.n / 5; ++line) {
      const Certificate certificate = Certify(problem, BestOnLine(problem, line).input);
      EXPECT_NE(certificate.verdict, kStationary) << line;
      if (certificate.verdict != kStationaryOnGrid) continue;
      ++minima;
      ASSERT_EQ(certificate.impacts.size(), 1u);
      EXPECT_TRUE(certificate.impacts[0].on_node);
      ASSERT_TRUE(certificate.impacts[0].theta);
      EXPECT_GE(*certificate.impacts[0].theta, 0);
      EXPECT_LE(*certificate.impacts[0].theta, 1);
      // With the impact held on its line the loss is a linear least-squares problem, and some controls only cost
      // effort.
      ASSERT_TRUE(certificate.curvature);
      EXPECT_EQ(certificate.curvature->kind, Curvature::Kind::kMinimum);
      EXPECT_NEAR(certificate.curvature->smallest, 1, 1e-6);
      EXPECT_TRUE(std::any_of(row.lines.begin(), row.lines.end(), [&](const auto& known) {
        return known.first == line;
      })) << line;
    }
    EXPECT_EQ(minima, row.minima) << row.n;
  }
}

// The loss of the ball by its control alone: the intervals of the first phase, `before` of them, move with the impact.
double LossOfPhases(const std::vector<double>& u, int before, double around) {
  const int after = static_cast<int>(u.size()) - before;
  double effort = 0;
  const auto fly = [&](int first, int count, double h, double* y, double* v) {
    effort = 0;
    for (int i = first; i < first + count; ++i) {
      *y += *v * h + 0.5 * (u[i] - 9.8) * h * h;
      *v += (u[i] - 9.8) * h;
      effort += u[i] * u[i] * h / 32;
    }
  };
  double low = around - 0.05, high = around + 0.05, y = 0, v = 0;
  for (int i = 0; i < 60; ++i) {
    const double s = 0.5 * (low + high);
    y = 4;
    v = 0;
    fly(0, before, s / before, &y, &v);
    (y > 0 ? low : high) = s;
  }
  double loss = effort;
  y = 0;
  v *= -0.7;
  fly(before, after, (1 - low) / after, &y, &v);
  return loss + effort + 100 * ((y - 1) * (y - 1) + v * v);
}

TEST(HybridCertificate, CurvatureOfTheBallAgreesWithDifferencesOfTheLoss) {
  const SolveReport report = Solve("ceres_phases", ControlledBall(6), {});
  ASSERT_EQ(report.termination, Termination::kConverged) << report.reason;
  ASSERT_TRUE(report.certificate && report.certificate->curvature);
  const double impact = report.certificate->impacts[0].time;
  int before = 0;
  for (double t = 0; t < impact - 1e-6; ++before) t += report.durations[before];
  ASSERT_NEAR(LossOfPhases(report.control, before, impact), report.final_loss, 1e-9);
  const int n = 6;
  Eigen::MatrixXd hessian(n, n), metric = Eigen::MatrixXd::Zero(n, n);
  const auto at = [&](int i, double by_i, int j, double by_j) {
    std::vector<double> u = report.control;
    u[i] += by_i;
    u[j] += by_j;
    return LossOfPhases(u, before, impact);
  };
  const double d = 1e-2;
  for (int i = 0; i < n; ++i) {
    metric(i, i) = report.durations[i] / 16;
    for (int j = 0; j < n; ++j) {
      hessian(i, j) = (at(i, d, j, d) - at(i, d, j, -d) - at(i, -d, j, d) + at(i, -d, j, -d)) / (4 * d * d);
    }
  }
  const Eigen::GeneralizedSelfAdjointEigenSolver<Eigen::MatrixXd> eigen(hessian, metric);
  const Curvature& curvature = *report.certificate->curvature;
  EXPECT_EQ(curvature.kind, Curvature::Kind::kMinimum);
  EXPECT_NEAR(curvature.smallest, eigen.eigenvalues()[0], 1e-4 * std::abs(eigen.eigenvalues()[0]));
  EXPECT_NE(eigen.eigenvalues()[0], 1);
}

// x' = 1 + u up to x = 0, and x' = u from there, from x = -1; the loss is (x(2)^2 - 1)^2 + weight int u^2 dt. Without a
// control x(2) = 0, which is stationary: along a control that is constant after the event the loss gains weight - 2
// times the square of its integral.
struct TwoSlopes {
  static constexpr int kNumControls = 1;
  static constexpr int kNumParameters = 0;
  static constexpr std::array kStateSizes = {1, 1};
  static constexpr std::array kNumGuards = {1, 0};
  template <typename T>
  void Flow(int mode, const T&, const T*, const T* u, const T*, T* xdot) const {
    xdot[0] = u[0] + (mode == 0 ? 1.0 : 0.0);
  }
  template <typename T>
  T Guard(int, int, const T&, const T* x, const T*) const {
    return -x[0];
  }
  template <typename T>
  int Reset(int, int, const T&, const T* x, const T*, T* x_plus) const {
    x_plus[0] = x[0];
    return 1;
  }
};
struct AwayFromZero {
  template <typename T>
  bool operator()(const T* x, T* residual) const {
    residual[0] = x[0] * x[0] - 1.0;
    return true;
  }
};
HybridProblem TwoWells(double weight) {
  HybridProblem problem{.system = HybridSystem(TwoSlopes()),
                        .guess = {.initial = {-1}, .duration = 2, .num_intervals = 10},
                        .terms = {MakeEffortCost(weight, 1)}};
  HybridTerm wells{.name = "wells", .mode = 1, .with_state = true};
  wells.function = std::make_shared<ceres::AutoDiffCostFunction<AwayFromZero, 1, 1>>(new AwayFromZero);
  problem.terms.push_back(wells);
  problem.free.control = true;
  return problem;
}

TEST(HybridCertificate, FindsSaddlesAndMinima) {
  for (const double weight : {1.0, 3.0}) {
    const HybridProblem problem = TwoWells(weight);
    const Certificate certificate = Certify(problem, problem.guess);
    EXPECT_EQ(certificate.verdict, kStationary) << certificate.reason;
    ASSERT_TRUE(certificate.curvature);
    EXPECT_NEAR(certificate.curvature->smallest, std::min(1.0, 1 - 2 / weight), 1e-8);
    EXPECT_EQ(certificate.IsSaddle(), weight < 2);
    if (!certificate.IsSaddle()) continue;
    EXPECT_THAT(certificate.reason, HasSubstr("a saddle"));
    // Zero before the event at t = 1, constant after it.
    ASSERT_EQ(certificate.curvature->direction.size(), 10u);
    for (int i = 0; i < 10; ++i) EXPECT_NEAR(certificate.curvature->direction[i], i < 5 ? 0 : 1, 1e-7) << i;
    // The solver leaves it: with x(2) = z the loss is (z^2 - 1)^2 + z^2, at least 3/4.
    const SolveReport report = Solve("ceres_phases", problem, {});
    ASSERT_EQ(report.termination, Termination::kConverged) << report.reason;
    EXPECT_LT(report.final_loss, 0.99);
    ASSERT_TRUE(report.certificate);
    EXPECT_FALSE(report.certificate->IsSaddle());
  }
}

TEST(HybridCertificate, FindsThatAControlIsNotOptimal) {
  const HybridProblem problem = ControlledBall(50);
  const Certificate certificate = Certify(problem, problem.guess);
  EXPECT_EQ(certificate.verdict, kNotStationary);
  EXPECT_GT(certificate.stationarity, 0.1);
}

TEST(HybridCertificate, AppliesOnlyToEventsThatCrossZero) {
  HybridProblem problem = ControlledBall(50);
  problem.guess.initial = {-0.1, 3};
  EXPECT_THAT(Certify(problem, problem.guess).reason, HasSubstr("below zero"));
}

// The example of the sensitivity tutorials: the published answer has the loss 0.3995, the right one 0.
TEST(HybridPhases, FindTheRestitutionOfTheTutorial) {
  HybridProblem problem{.system = HybridSystem(BouncingBall()),
                        .guess = {.initial = {50, 0}, .parameters = {9.8, 0.95}, .duration = 15},
                        .terms = {MakeTerminalCost(0, 20.0, 1.0, 2)}};
  problem.free.parameters = {1};
  problem.free.parameters_min = {0.75};
  problem.free.parameters_max = {1};
  const SolveReport report = Solve("ceres_phases", problem, {});
  ASSERT_EQ(report.termination, Termination::kConverged) << report.reason;
  EXPECT_NEAR(report.parameters[1], 0.988008392024876511903389, 1e-12);
  EXPECT_LT(report.final_loss, 1e-18);
  ASSERT_TRUE(report.certificate);
  EXPECT_EQ(report.certificate->verdict, kGlobal);

  // From near the published answer the search finds the right one.
  problem.guess.parameters[1] = 0.866;
  SolverOptions options;
  options.iterations = 40;
  const SolveReport searched = Solve("mode_search", problem, options);
  EXPECT_NEAR(searched.parameters[1], 0.988008392024876511903389, 1e-9) << searched.reason;
  EXPECT_LT(searched.final_loss, 1e-12);
}

// int x^2 dt is the second component of the state; its root is the residual.
struct RootOfIntegral {
  template <typename T>
  bool operator()(const T* x, T* residual) const {
    using std::sqrt;
    residual[0] = sqrt(x[1]);
    return true;
  }
};

TEST(HybridPhases, FindTheStartOfTheSwitchedLine) {
  HybridProblem problem{.system = HybridSystem(SwitchedLine()),
                        .guess = {.initial = {-1, 0}, .duration = 2},
                        .terms = {MakeTerminalCost(0, 5.0 / 3, 1.0, 2)}};
  HybridTerm integral{.name = "integral", .with_state = true};
  integral.function = std::make_shared<ceres::AutoDiffCostFunction<RootOfIntegral, 1, 2>>(new RootOfIntegral);
  problem.terms.push_back(integral);
  problem.free.initial = {0};
  const SolveReport report = Solve("ceres_phases", problem, {});
  ASSERT_EQ(report.termination, Termination::kConverged) << report.reason;
  EXPECT_NEAR(report.final_loss, 1.52377277537495711456099, 1e-12);
  EXPECT_NEAR(report.initial_state[0], -1.42757223208276713401017, 1e-6);  // where the loss is flat
  ASSERT_TRUE(report.certificate);
  EXPECT_EQ(report.certificate->verdict, kStationary) << report.certificate->reason;
}

// Minimum time with a terminal constraint, a bound on the state and bounds on the control.
TEST(HybridPhases, DriveTheTurboCarInMinimumTime) {
  const HybridProblem problem = TurboCarProblem();
  const SolveReport report = Solve("ceres_phases", problem, {});
  ASSERT_EQ(report.termination, Termination::kConverged) << report.reason;
  EXPECT_NEAR(report.final_loss, 40.0 / 3, 1e-8);
  EXPECT_LT(report.final_violation, 1e-8);
  ASSERT_TRUE(report.certificate);
  EXPECT_EQ(report.certificate->verdict, kStationary) << report.certificate->reason;
  ASSERT_EQ(report.certificate->impacts.size(), 2u);
  EXPECT_NEAR(report.certificate->impacts[0].time, 2, 1e-7);
  EXPECT_NEAR(report.certificate->impacts[1].time, 34.0 / 3, 1e-7);
}

// The best motion has one bounce; that without one is far dearer (6.356 in continuous time).
TEST(HybridModeSearch, FindsTheBounceAndProvesNothing) {
  HybridProblem problem = ControlledBall(40);
  problem.guess.control.assign(40, 12.0);  // never comes down
  const SolveReport alone = Solve("ceres_phases", problem, {});
  ASSERT_EQ(alone.termination, Termination::kConverged) << alone.reason;
  EXPECT_NEAR(alone.final_loss, 6.356139587834746772, 0.05);
  SolverOptions options;
  options.search_options.starts = 2;
  const SolveReport report = Solve("mode_search", problem, options);
  ASSERT_EQ(report.termination, Termination::kConverged) << report.reason;
  EXPECT_NEAR(report.final_loss, kBallOptimum, 3.0 / (40 * 40));
  EXPECT_THAT(report.reason, HasSubstr("along flight/ground"));
  ASSERT_GE(report.optima.size(), 2u);
  EXPECT_EQ(report.optima[0].sequence.size(), 1u);
  EXPECT_LE(report.optima[0].loss, report.optima[1].loss);
  ASSERT_TRUE(report.searched);
  EXPECT_TRUE(report.searched->complete) << report.reason;
  ASSERT_TRUE(report.certificate);
  EXPECT_EQ(report.certificate->scope, Certificate::Scope::kBestOfSearched);

  options.threads = 2;
  const SolveReport other = Solve("mode_search", problem, options);
  EXPECT_EQ(other.final_loss, report.final_loss) << "it does not depend on the number of threads";
  EXPECT_EQ(other.reason, report.reason);
  options.search_options.work = 1;
  EXPECT_THAT(Solve("mode_search", problem, options).reason, HasSubstr("not complete: the limit of work"));
}

TEST(HybridPhases, SayWhatTheyCannotTake) {
  HybridProblem problem = ControlledBall(10);
  problem.free = {.parameters = {1}};
  problem.guess.control = {1, 1, 1, 1, 1, 2, 2, 2, 2, 2};
  EXPECT_THAT(Solve("ceres_phases", problem, {}).reason, HasSubstr("a control that changes on a given grid"));
  problem.free = {};
  EXPECT_THAT(Solve("mode_search", problem, {}).reason, HasSubstr("nothing to optimize"));
}

}  // namespace
}  // namespace saltus
