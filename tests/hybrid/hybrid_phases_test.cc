// Solvers along sequences of events on hybrid systems whose optima are known, and their certificates.
#include <ceres/autodiff_cost_function.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <algorithm>
#include <array>
#include <cmath>
#include <memory>
#include <random>
#include <string>
#include <utility>
#include <vector>

#include "base/linear_algebra.h"
#include "problems/hybrid_systems.h"
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

// Events at the ends of intervals, where no control jumps, are no kinks whose multipliers could be chosen.
TEST(HybridCertificate, EventsWhereTheControlGoesOnLeaveNoChoice) {
  const double g = 9.8, fall = std::sqrt(2 / g);
  HybridProblem problem{.system = HybridSystem(BouncingBall()),
                        .guess = {.initial = {1, 0},
                                  .parameters = {g, 0.5},
                                  .duration = 1,
                                  .num_intervals = 3,
                                  .lengths = {fall, fall, 1 - 2 * fall}},
                        .terms = {MakeTerminalCost(1, 0.0, 1.0, 2)}};
  problem.free.parameters = {0};
  // v(T) = e^2 v_1 - g (T - t_2) with v_1 = g fall and t_2 = fall (1 + 2 e); fall = sqrt(2 / g).
  const double v = 0.25 * g * fall - g * (1 - 2 * fall), slope = 0.125 * fall - (1 - 2 * fall) - fall;
  EXPECT_NEAR(Solve("gd", problem, {.limits = {.iterations = 0}}).guess.loss, v * v, 1e-12);
  ASSERT_GT(std::abs(2 * v * slope), 1e-4);
  const Certificate certificate = Certify(problem, problem.guess);
  EXPECT_EQ(certificate.verdict, kNotStationary) << VerdictInWords(certificate);
  problem.free.parameters_min = {g};  // the loss falls with g, or it rises: one of the two bounds holds it
  problem.free.parameters_max = {2 * g};
  const Certificate above = Certify(problem, problem.guess);
  problem.free.parameters_min = {0.5 * g};
  problem.free.parameters_max = {g};
  const Certificate below = Certify(problem, problem.guess);
  EXPECT_EQ(v * slope > 0 ? above.verdict : below.verdict, kStationary);
  EXPECT_EQ(v * slope > 0 ? below.verdict : above.verdict, kNotStationary);
}

TEST(HybridPhases, ReachTheOptimumOfTheBallByOrderTwo) {
  double last = 0;
  for (const int n : {50, 100, 200}) {
    const SolveReport report = Solve("ceres_phases", ControlledBall(n), {});
    ASSERT_EQ(report.termination, Termination::kConverged) << report.reason;
    EXPECT_LE(report.work.iterations, 30) << n;
    const double gap = (report.solution.loss - kBallOptimum) * n * n;
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
  EXPECT_GT(report.solution.loss, kBallOptimum);
  int at_bounds = 0;
  for (const double u : report.solution.control) {
    EXPECT_GE(u, -11);
    EXPECT_LE(u, 5);
    at_bounds += u < -11 + 1e-6 || u > 5 - 1e-6;
  }
  EXPECT_GT(at_bounds, 2);
  ASSERT_TRUE(report.certificate);
  EXPECT_EQ(report.certificate->verdict, kStationary) << report.certificate->reason;
}

// The ball with a force per mass that is linear in time between events, and different ones before and after them, as
// the optimum in continuous time has: [y v z] with z = int u^2 dt; p = [g e a0 b0 a1 b1 a2 b2], u = a + b t.
struct BallWithLinearForces {
  static constexpr int kNumControls = 0;
  static constexpr int kNumParameters = 8;
  static constexpr std::array kStateSizes = {3, 3, 3};
  static constexpr std::array kNumGuards = {1, 1, 0};
  template <typename T>
  void Flow(int mode, const T& t, const T* x, const T*, const T* p, T* xdot) const {
    const T u = p[2 + 2 * mode] + p[3 + 2 * mode] * t;
    xdot[0] = x[1];
    xdot[1] = u - p[0];
    xdot[2] = u * u;
  }
  template <typename T>
  T Guard(int, int, const T&, const T* x, const T*) const {
    return x[0];
  }
  template <typename T>
  int Reset(int mode, int, const T&, const T* x, const T* p, T* x_plus) const {
    x_plus[0] = T(0.0);
    x_plus[1] = -p[1] * x[1];
    x_plus[2] = x[2];
    return mode + 1;
  }
};
// The integral of u^2 / 32 over an interval in a mode, exactly; of parameters, time and length.
struct EffortOfLinearForce {
  int mode;
  template <typename T>
  bool operator()(const T* p, const T* t, const T* h, T* residuals) const {
    using std::sqrt;
    const T root = sqrt(h[0] / 32.0), slope = p[3 + 2 * mode];
    residuals[0] = root * (p[2 + 2 * mode] + slope * (t[0] + 0.5 * h[0]));
    residuals[1] = root * slope * h[0] / std::sqrt(12.0);
    return true;
  }
};
HybridProblem BallInContinuousTime(const std::vector<double>& forces) {
  HybridProblem problem{.system = HybridSystem(BallWithLinearForces()),
                        .guess = {.initial = {4, 0, 0}, .parameters = {9.8, 0.7}, .duration = 1, .num_intervals = 30},
                        .terms = {MakeTerminalCost(0, 1.0, 100.0, 3), MakeTerminalCost(1, 0.0, 100.0, 3)}};
  problem.guess.parameters.insert(problem.guess.parameters.end(), forces.begin(), forces.end());
  for (int i = 2; i < static_cast<int>(problem.guess.parameters.size()); ++i) {
    const bool counts = forces[(i - 2) / 2 * 2] != 0;
    if (counts) problem.free.parameters.push_back(i);
  }
  for (int mode = 0; mode < 3; ++mode) {
    HybridTerm effort{.name = "effort",
                      .at = HybridTerm::Timing::kEachInterval,
                      .mode = mode,
                      .with_parameters = true,
                      .with_time = true,
                      .with_length = true};
    effort.function =
        std::make_shared<ceres::AutoDiffCostFunction<EffortOfLinearForce, 2, 8, 1, 1>>(new EffortOfLinearForce{mode});
    problem.terms.push_back(effort);
  }
  return problem;
}

TEST(HybridPhases, ReachTheOptimumOfTheBallInContinuousTime) {
  const HybridProblem problem = BallInContinuousTime({-12, 25, -10, -10, 0, 0});
  const SolveReport report = Solve("ceres_phases", problem, {});
  ASSERT_EQ(report.termination, Termination::kConverged) << report.reason;
  EXPECT_NEAR(report.solution.loss, kBallOptimum, 1e-12);
  // The reference: a change of the forces by 1e-6 m/s^2 changes the loss by rounding alone.
  constexpr double kImpact = 0.697936180950424916232723, kSpeed = 9.14598342235800406373598;
  constexpr double kStart = -13.261035960757762298, kBefore = 6.6523834449838246927;
  constexpr double kAfter = -9.5034049214054638468, kEnd = -13.258802112336916118;
  const std::vector<double>& p = report.solution.parameters;
  EXPECT_NEAR(p[2], kStart, 1e-6);
  EXPECT_NEAR(p[2] + p[3] * kImpact, kBefore, 1e-6);
  EXPECT_NEAR(p[4] + p[5] * kImpact, kAfter, 1e-6);
  EXPECT_NEAR(p[4] + p[5], kEnd, 1e-6);
  HybridSimulator simulator(problem.system, {.tolerance = 1e-14});
  HybridInput best = problem.guess;
  best.parameters = p;
  ASSERT_TRUE(simulator.Rollout(best));
  ASSERT_EQ(simulator.events().size(), 1u);
  EXPECT_NEAR(simulator.events()[0].time, kImpact, 1e-8);
  EXPECT_NEAR(simulator.events()[0].before[1], -kSpeed, 1e-8);
  EXPECT_NEAR(simulator.final_state()[0], 0.9961148553777191287357, 1e-9);
  EXPECT_NEAR(simulator.final_state()[1], 0.004143375660105286286961, 1e-9);

  // The motion under the forces of the reference, and its derivatives.
  const double slope = (kEnd - kAfter) / (1 - kImpact);
  best.parameters = {9.8, 0.7, kStart, (kBefore - kStart) / kImpact, kAfter - slope * kImpact, slope, 0, 0};
  ASSERT_TRUE(simulator.Rollout(best));
  ASSERT_EQ(simulator.events().size(), 1u);
  EXPECT_NEAR(simulator.events()[0].time, kImpact, 1e-13);
  EXPECT_NEAR(simulator.events()[0].before[1], -kSpeed, 1e-12);
  const double y = simulator.final_state()[0], v = simulator.final_state()[1], squares = simulator.final_state()[2];
  EXPECT_NEAR(y, 0.9961148553777191287357, 1e-12);
  EXPECT_NEAR(v, 0.004143375660105286286961, 1e-12);
  EXPECT_NEAR(squares / 32, 2.192662419243672985, 1e-11);
  EXPECT_NEAR(squares, 70.16519741579753551, 1e-10);  // dJ/deps
  EXPECT_NEAR(100 * ((y - 1) * (y - 1) + v * v), 0.003226191059679089073, 1e-12);
  EXPECT_NEAR((y - 1) * (y - 1) + v * v, 0.00003226191059679089073, 1e-14);  // dJ/dw
  EXPECT_NEAR(squares / 32 + 100 * ((y - 1) * (y - 1) + v * v), kBallOptimum, 1e-11);
  // Costates are derivatives of the loss to come by the state: at the end (by the target the opposite), at the start,
  // and of motions that begin just before and just after the impact.
  const std::vector<double> at_end = {200 * (y - 1), 200 * v, 1.0 / 32};
  EXPECT_NEAR(at_end[0], -0.77702892445617425286, 1e-10);
  EXPECT_NEAR(at_end[1], 0.82867513202105725739, 1e-10);
  const HybridGradient whole = simulator.Adjoint(at_end);
  EXPECT_NEAR(whole.initial[0], 1.7832414292722467846, 1e-10);
  EXPECT_NEAR(whole.initial[1], 0.82881474754736014361, 1e-10);
  EXPECT_NEAR(whole.parameters[0], -0.3590017776467813514, 1e-10);  // g
  EXPECT_NEAR(whole.parameters[1], 5.432373991695615179, 1e-10);    // e
  EXPECT_NEAR(whole.duration, -13.61785561198008402, 1e-10);
  for (int i = 2; i < 6; ++i) EXPECT_NEAR(whole.parameters[i], 0, 1e-10);
  best.begin = kImpact;
  best.duration = 1 - kImpact;
  best.initial = {0, -kSpeed, 0};
  ASSERT_TRUE(simulator.Rollout(best));
  const std::vector<double> before = simulator.Adjoint(at_end).initial;
  best.mode = 1;
  best.initial = {0, 0.7 * kSpeed, 0};
  ASSERT_TRUE(simulator.Rollout(best));
  const std::vector<double> after = simulator.Adjoint(at_end).initial;
  EXPECT_NEAR(before[0], 1.7832414292722467846, 1e-10);
  EXPECT_NEAR(before[1], -0.4157739653114890433, 1e-10);
  EXPECT_NEAR(after[0], -0.77702892445617425286, 1e-10);
  EXPECT_NEAR(after[1], 0.59396280758784149042, 1e-10);
  const auto hamiltonian = [&](const std::vector<double>& costate, double velocity, double u) {
    return u * u / 32 + costate[0] * velocity + costate[1] * (u - 9.8);
  };
  EXPECT_NEAR(hamiltonian(before, -kSpeed, kBefore), -13.617855611980084025, 1e-9);
  EXPECT_NEAR(hamiltonian(after, 0.7 * kSpeed, kAfter), -13.617855611980084025, 1e-9);
}

TEST(HybridPhases, ReachOtherOptimaOfTheBallInContinuousTime) {
  const HybridProblem none = BallInContinuousTime({12, 0, 0, 0, 0, 0});
  const SolveReport alone = Solve("ceres_phases", none, {});
  ASSERT_EQ(alone.termination, Termination::kConverged) << alone.reason;
  EXPECT_NEAR(alone.solution.loss, 6.356139587834746772, 1e-12);
  HybridInput best = none.guess;
  best.parameters = alone.solution.parameters;
  HybridSimulator simulator(none.system);
  ASSERT_TRUE(simulator.Rollout(best));
  EXPECT_EQ(simulator.events().size(), 0u);
  EXPECT_NEAR(simulator.final_state()[0], 1.0111918013155302, 1e-9);
  EXPECT_NEAR(simulator.final_state()[1], -0.008655695752842328, 1e-9);

  // With two bounces, the reference is the best of 60 starts.
  const HybridProblem two = BallInContinuousTime({-42, 144, -141, 153, 267, -309});
  const SolveReport twice = Solve("ceres_phases", two, {});
  ASSERT_EQ(twice.termination, Termination::kConverged) << twice.reason;
  EXPECT_NEAR(twice.solution.loss, 25.215, 5e-4);
  best.parameters = twice.solution.parameters;
  ASSERT_TRUE(simulator.Rollout(best));
  ASSERT_EQ(simulator.events().size(), 2u);
  // Far from it, too.
  const SolveReport far = Solve("ceres_phases", BallInContinuousTime({-30, 0.1, -61, 0.1, -30, 0.1}), {});
  ASSERT_EQ(far.termination, Termination::kConverged) << far.reason;
  EXPECT_NEAR(far.solution.loss, 25.215, 5e-4);
}

// A disc of radius 0.2 m that strikes another one, of the same mass: [x y vx vy] of both.
struct StrikingDisc {
  static constexpr int kNumControls = 2, kNumParameters = 0;
  static constexpr std::array kStateSizes = {8};
  static constexpr std::array kNumGuards = {1};
  template <typename T>
  void Flow(int, const T&, const T* x, const T* u, const T*, T* xdot) const {
    for (int i = 0; i < 8; ++i) xdot[i] = i % 4 < 2 ? x[i + 2] : i < 4 ? u[i - 2] : T(0.0);
  }
  template <typename T>
  T Guard(int, int, const T&, const T* x, const T*) const {
    using std::sqrt;
    const T dx = x[4] - x[0], dy = x[5] - x[1];
    return sqrt(dx * dx + dy * dy) - 0.4;
  }
  template <typename T>
  int Reset(int, int, const T&, const T* x, const T*, T* x_plus) const {
    const T nx = (x[4] - x[0]) / 0.4, ny = (x[5] - x[1]) / 0.4, closing = (x[2] - x[6]) * nx + (x[3] - x[7]) * ny;
    for (int i = 0; i < 8; ++i) {
      x_plus[i] = i % 4 < 2 ? x[i] : x[i] + (i < 4 ? -closing : closing) * (i % 2 == 0 ? nx : ny);
    }
    return 0;
  }
};

// The weights follow the costs that lie ahead: neither do costs outweigh a motion of many steps, nor do large weights
// make steps along the curved motions short. In continuous time the optimum is known.
TEST(HybridPhases, NeedFewIterationsWhateverTheGuess) {
  constexpr double kOptimum = 1.396542160123;
  constexpr int kIntervals = 120;
  for (const auto& [guess, most] : {std::pair(1.5, 65), std::pair(3.0, 25), std::pair(6.0, 45)}) {
    HybridProblem problem{
        .system = HybridSystem(StrikingDisc()),
        .guess = {.initial = {-2, -2, 0, 0, -1, -1, 0, 0}, .duration = 1, .num_intervals = kIntervals},
        .terms = {MakeTerminalCost(4, 0.0, 1.0, 8), MakeTerminalCost(5, 0.0, 1.0, 8), MakeEffortCost(0.1, 2)}};
    problem.guess.control.assign(2 * kIntervals, guess);
    problem.free.control = true;
    const SolveReport report = Solve("ceres_phases", problem, {});
    ASSERT_EQ(report.termination, Termination::kConverged) << guess << ": " << report.reason;
    EXPECT_LE(report.work.iterations, most) << guess;
    EXPECT_NEAR((report.solution.loss - kOptimum) * kIntervals * kIntervals, 0.163, 0.005) << guess;
  }
}

// Masses with springs that harden, of which a force pushes the first. In a second the last ones hardly move: by 1e-20.
struct LongChain {
  static constexpr int kMasses = 20;
  static constexpr int kNumControls = 1, kNumParameters = 0;
  static constexpr std::array kStateSizes = {2 * kMasses};
  static constexpr std::array kNumGuards = {0};
  template <typename T>
  void Flow(int, const T&, const T* x, const T* u, const T*, T* xdot) const {
    for (int i = 0; i < kMasses; ++i) {
      xdot[i] = x[kMasses + i];
      T force = (i == 0 ? u[0] : T(0.0)) - 0.1 * x[kMasses + i];
      for (const int j : {i - 1, i + 1}) {
        if (j < 0 || j >= kMasses) continue;
        const T d = x[j] - x[i];
        force += 2.0 * d + 0.1 * d * d * d;
      }
      xdot[kMasses + i] = force;
    }
  }
  template <typename T>
  T Guard(int, int, const T&, const T*, const T*) const {
    return T(0.0);
  }
  template <typename T>
  int Reset(int, int, const T&, const T*, const T*, T*) const {
    return 0;
  }
};

// Sizes of states that no cost notices are raised: relative to 1e-20 linear solvers lost their digits, and the solve
// ran out of its 400 iterations.
TEST(HybridPhases, StatesThatHardlyMoveTakeNoIterations) {
  constexpr int kIntervals = 5, kStates = 2 * LongChain::kMasses;
  HybridProblem problem{.system = HybridSystem(LongChain()),
                        .guess = {.initial = std::vector<double>(kStates), .duration = 1, .num_intervals = kIntervals},
                        .terms = {MakeEffortCost(1.0, 1)}};
  for (int i = 0; i < kStates; ++i) {
    problem.terms.push_back(MakeTerminalCost(i, i < LongChain::kMasses ? 1.0 : 0.0, 100.0, kStates));
  }
  problem.guess.control.assign(kIntervals, 0.1);
  problem.free.control = true;
  const SolveReport phases = Solve("ceres_phases", problem, {}), shooting = Solve("ceres_lm", problem, {});
  ASSERT_EQ(phases.termination, Termination::kConverged) << phases.reason;
  ASSERT_EQ(shooting.termination, Termination::kConverged) << shooting.reason;
  EXPECT_NEAR(phases.solution.loss, shooting.solution.loss, 1e-9 * shooting.solution.loss);
  EXPECT_LE(phases.work.iterations, 100);
}

// The best control of the ball with n1 equal intervals before and n2 after an impact at the time s, and its loss.
struct AtImpact {
  HybridInput input;
  double loss = 0, speed = 0;
};
// The square root of a positive definite matrix that is itself symmetric.
Eigen::Matrix2d RootOf(const Eigen::Matrix2d& symmetric) {
  const SymmetricEigen eigen = EigenOf(symmetric);
  const Eigen::Matrix2d vectors = eigen.vectors;
  return vectors * Eigen::Vector2d(eigen.values.cwiseSqrt()).asDiagonal() * vectors.transpose();
}

AtImpact BestAtImpact(const HybridProblem& problem, int n1, int n2, double s) {
  const double g = 9.8, e = 0.7, rest = 1 - s;
  // The controls of a phase add M u to position and velocity at its end, and the least |u|^2 for a given M u = d is
  // d^T (M M^T)^{-1} d. Unknown are the speed V before the impact and the d after it; minimized is |A z - b|^2.
  const auto added_by = [](int n, double length) {
    Eigen::Matrix2Xd M(2, n);
    for (int k = 0; k < n; ++k) M.col(k) << (length / n) * (length - (k + 0.5) * length / n), length / n;
    return M;
  };
  const Eigen::Matrix2Xd M1 = added_by(n1, s), M2 = added_by(n2, rest);
  const Eigen::Matrix2d inverse1 = PseudoInverse(MultiplyByTransposed(M1, M1));
  const Eigen::Matrix2d inverse2 = PseudoInverse(MultiplyByTransposed(M2, M2));
  const Eigen::Matrix2d part1 = RootOf(inverse1), part2 = RootOf(inverse2);
  Eigen::Matrix<double, 2, 3> before = Eigen::Matrix<double, 2, 3>::Zero(), after = before;
  before(1, 0) = -1;
  after.rightCols<2>().setIdentity();
  const Eigen::Vector2d added(-(4 - 0.5 * g * s * s), g * s);  // for V = 0
  const double root1 = std::sqrt(s / n1 / 32), root2 = std::sqrt(rest / n2 / 32);
  Eigen::Matrix<double, 6, 3> A;
  Eigen::Matrix<double, 6, 1> b;
  A << root1 * part1 * before, root2 * part2 * after, 10 * e * rest, 10, 0, 10 * e, 0, 10;
  b << -root1 * part1 * added, 0, 0, 10 * (1 + 0.5 * g * rest * rest), 10 * g * rest;
  const Eigen::Vector3d z = LeastSquaresSolution(A, b);
  AtImpact best{problem.guess, (A * z - b).squaredNorm(), z[0]};
  const Eigen::VectorXd u1 = M1.transpose() * (inverse1 * (added + before * z));
  const Eigen::VectorXd u2 = M2.transpose() * (inverse2 * (after * z));
  best.input.control.assign(u1.begin(), u1.end());
  best.input.control.insert(best.input.control.end(), u2.begin(), u2.end());
  best.input.lengths.assign(n1, s / n1);
  best.input.lengths.insert(best.input.lengths.end(), n2, rest / n2);
  return best;
}
AtImpact BestOnLine(const HybridProblem& problem, int line) {
  const int n = problem.guess.num_intervals;
  AtImpact best = BestAtImpact(problem, line, n - line, static_cast<double>(line) / n);
  best.input.lengths.clear();
  return best;
}

// Free impact time: of n1 equal intervals before and n2 after it. The solver shares its intervals out by the lengths of
// the phases.
TEST(HybridCertificate, HoldsAtTheOptimaOfTheBallOnIntervalsThatMove) {
  struct Row {
    int n1, n2;
    double loss, time, speed, y, v;
  };
  for (const Row& row : {Row{25,
                             25,
                             2.1970603041490900786,
                             0.6979672664436311,
                             9.147569927055713,
                             0.9961165206774811,
                             0.00414489250152653},
                         Row{50,
                             50,
                             2.1961813900503215692,
                             0.6979439479995817,
                             9.146379883345555,
                             0.9961152709408124,
                             0.004143754739522638},
                         Row{125,
                             125,
                             2.1959354486291754319,
                             0.6979374234847223,
                             9.146046848720716,
                             0.9961149218337232,
                             0.00414343630694966},
                         Row{35,
                             15,
                             2.1965264717008884201,
                             0.6979373952068263,
                             9.147126035228148,
                             0.9961136307797731,
                             0.004144411256654596}}) {
    HybridProblem problem = ControlledBall(row.n1 + row.n2);
    AtImpact best = BestAtImpact(problem, row.n1, row.n2, row.time);
    EXPECT_NEAR(best.loss, row.loss, 1e-12);
    EXPECT_NEAR(best.speed, row.speed, 1e-8);
    const Certificate certificate = Certify(problem, best.input);
    EXPECT_EQ(certificate.verdict, kStationary) << certificate.reason;
    EXPECT_NE(Certify(problem, BestAtImpact(problem, row.n1, row.n2, row.time + 1e-3).input).verdict, kStationary);
    if (row.n1 == 35) {
      for (int k = 0; k < 50; ++k) problem.guess.control.push_back(k < 35 ? 9.8 - 8 / 0.49 : 0);  // 4 m in 0.7 s
      const SolveReport report = Solve("ceres_phases", problem, {});
      ASSERT_EQ(report.termination, Termination::kConverged) << report.reason;
      EXPECT_NEAR(report.solution.loss, row.loss, 1e-10);
      best.input.control = report.solution.control;
      best.input.lengths = report.solution.durations;
    }
    HybridSimulator simulator(problem.system);
    ASSERT_TRUE(simulator.Rollout(best.input));
    ASSERT_EQ(simulator.events().size(), 1u);
    EXPECT_NEAR(simulator.events()[0].time, row.time, 1e-8);
    EXPECT_NEAR(simulator.events()[0].before[1], -row.speed, 1e-7);
    EXPECT_NEAR(simulator.final_state()[0], row.y, 1e-8);
    EXPECT_NEAR(simulator.final_state()[1], row.v, 1e-8);
  }
}

// On a fixed grid every local minimum of the ball has its impact at the end of an interval; reference values: the least
// losses, how many such lines there are, and at the least of all the speed, the controls on both sides and the slopes
// of the least loss by the time of the impact.
TEST(HybridCertificate, NamesTheKinksOfAFixedGrid) {
  struct Row {
    int n, minima;
    std::vector<std::pair<int, double>> lines;
    double speed, u_left, u_right, slope_left, slope_right;
  };
  for (const Row& row :
       {Row{50,
            2,
            {{35, 2.1976626506629637918}, {34, 2.2764510624727}},
            9.1512769644202929,
            6.2154741276484,
            -9.4286461313113,
            -6.39456,
            9.02711},
        Row{100,
            4,
            {{70, 2.1971835916003522223}, {69, 2.2122262662501}, {68, 2.2758162922396}, {67, 2.3833726276028}},
            9.1503663003540137,
            6.3542669939743,
            -9.3521468359329,
            -6.53011,
            8.95112},
        Row{250,
            11,
            {{174, 2.196898388973555967}, {175, 2.1970494960619}, {173, 2.2050260727339}, {176, 2.2058732430167}},
            9.1426979918159248,
            6.7420320172767,
            -9.7347540925955,
            -9.47593,
            7.53119},
        Row{500,
            23,
            {{349, 2.1958960908933075897}, {348, 2.196878980734}, {350, 2.1970303410202}, {347, 2.1999309030468}},
            9.1461127298306453,
            6.618995155246,
            -9.5089520714107,
            -8.08209,
            8.19095}}) {
    const HybridProblem problem = ControlledBall(row.n);
    for (const auto& [line, loss] : row.lines) EXPECT_NEAR(BestOnLine(problem, line).loss, loss, 1e-12) << line;
    int minima = 0;
    for (int line = (3 * row.n + 9) / 10; line <= 95 * row.n / 100; ++line) {
      const AtImpact best = BestOnLine(problem, line);
      const Certificate certificate = Certify(problem, best.input);
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
      EXPECT_TRUE(certificate.curvature);
      if (certificate.curvature) {
        EXPECT_EQ(certificate.curvature->kind, Curvature::Kind::kMinimum);
        EXPECT_NEAR(certificate.curvature->smallest, 1, 1e-6);
      }
      const auto known =
          std::find_if(row.lines.begin(), row.lines.end(), [&](const auto& of) { return of.first == line; });
      if (known == row.lines.end()) {
        EXPECT_GT(best.loss, row.lines.back().second) << line;
      }
      if (known != row.lines.begin()) continue;
      EXPECT_NEAR(best.speed, row.speed, 1e-11);
      EXPECT_NEAR(best.input.control[line - 1], row.u_left, 1e-10);
      EXPECT_NEAR(best.input.control[line], row.u_right, 1e-10);
      EXPECT_NEAR(*certificate.impacts[0].theta, row.slope_right / (row.slope_right - row.slope_left), 1e-5);
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
  for (double t = 0; t < impact - 1e-6; ++before) t += report.solution.durations[before];
  ASSERT_NEAR(LossOfPhases(report.solution.control, before, impact), report.solution.loss, 1e-9);
  const int n = 6;
  Eigen::MatrixXd hessian(n, n);  // in coordinates in which the effort is the sum of squares
  const auto at = [&](int i, double by_i, int j, double by_j) {
    std::vector<double> u = report.solution.control;
    u[i] += by_i;
    u[j] += by_j;
    return LossOfPhases(u, before, impact);
  };
  const double d = 1e-2;
  for (int i = 0; i < n; ++i) {
    for (int j = 0; j < n; ++j) {
      const double metric = std::sqrt(report.solution.durations[i] * report.solution.durations[j]) / 16;
      hessian(i, j) = (at(i, d, j, d) - at(i, d, j, -d) - at(i, -d, j, d) + at(i, -d, j, -d)) / (4 * d * d * metric);
    }
  }
  const double smallest = EigenOf(hessian).values[0];
  const Curvature& curvature = *report.certificate->curvature;
  EXPECT_EQ(curvature.kind, Curvature::Kind::kMinimum);
  EXPECT_NEAR(curvature.smallest, smallest, 1e-4 * std::abs(smallest));
  EXPECT_NE(smallest, 1);
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
    EXPECT_LT(report.solution.loss, 0.99);
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

// A ball without weight above a floor at 0.
HybridProblem PushedDown(double target, double weight) {
  HybridProblem problem{.system = HybridSystem(BouncingBall()),
                        .guess = {.initial = {1, 0}, .parameters = {0, 0.5}, .duration = 1, .num_intervals = 10},
                        .terms = {MakeTerminalCost(0, target, weight, 2), MakeEffortCost(1, 1)}};
  problem.guess.control.assign(10, -1.0);
  problem.free.control = true;
  return problem;
}

// The target is below the floor, which the ball reaches at the final time, with the least effort for this: later, the
// loss falls with x(T) until it is zero; earlier, the ball bounces and x(T) is above zero again. The loss without the
// event has the gradient nu grad x(T), nu = 2 weight (0 - target) - multiplier of the effort, on its side.
TEST(HybridCertificate, HoldsOnBothSidesOfAnEventAtTheFinalTime) {
  double squares = 0;
  for (int k = 0; k < 10; ++k) squares += std::pow(0.1 * (1 - (k + 0.5) * 0.1), 2);
  const double effort = 0.1 / squares;  // 0.1 sum u^2 for x(1) = 1 + sum_k 0.1 (1 - (k + 0.5) 0.1) u_k = 0
  const double target = -1, weight = 100;
  for (const char* solver : {"ceres_phases", "auto"}) {
    const HybridProblem problem = PushedDown(target, weight);
    const SolveReport report = Solve(solver, problem, {});
    ASSERT_EQ(report.termination, Termination::kConverged) << report.reason;
    EXPECT_NEAR(report.solution.loss, weight * target * target + effort, 1e-5);
    ASSERT_TRUE(report.certificate);
    EXPECT_EQ(report.certificate->verdict, kStationaryOnGrid) << report.certificate->reason;
    EXPECT_THAT(report.certificate->reason, HasSubstr("at the final time: a kink"));
  }
  // The control of the least effort is no optimum where a target above the floor is better.
  HybridProblem above = PushedDown(0.5, weight);
  for (int k = 0; k < 10; ++k) above.guess.control[k] = -0.1 * (1 - (k + 0.5) * 0.1) / squares;
  EXPECT_FALSE(Certify(above, above.guess).IsStationary());
}

// A ball without weight that just touches the floor at 0.45, within an interval. Stationary is a control
//
//   u_k = alpha a_k + beta b_k,   a_k = D x(1) / D u_k,   b_k = D x(0.45) / D u_k,   beta >= 0
//
// where alpha is 10 weight (target - x(1)), and 0.2 beta the multiplier of the touch; alpha and beta are those for
// which position and speed are zero at 0.45. A push up at the touch changes the loss by -2 weight (target - x(1)) 0.55
// times the speed that it adds: the loss falls with it if alpha > 0.
struct TouchingBall {
  HybridProblem problem;
  double alpha = 0, beta = 0;
};
TouchingBall BallThatTouches(double speed) {
  constexpr double kTouch = 0.45, kWeight = 100, kGap = 1e-9;
  std::array<double, 10> a{}, b{}, push{};
  double aa = 0, ab = 0, bb = 0, bd = 0;  // sums of a d, a b, b b and b d, with d the pushes
  for (int k = 0; k < 10; ++k) {
    const double begin = 0.1 * k;
    push[k] = std::clamp(kTouch - begin, 0.0, 0.1);
    a[k] = 0.1 * (0.95 - begin);
    b[k] = push[k] * (kTouch - begin - 0.5 * push[k]);
    ab += a[k] * b[k];
    bb += b[k] * b[k];
    aa += a[k] * push[k];
    bd += b[k] * push[k];
  }
  const double at_touch = kGap - 1 - speed * kTouch, determinant = ab * bd - bb * aa;
  TouchingBall ball{PushedDown(0, kWeight)};
  ball.alpha = (at_touch * bd + speed * bb) / determinant;
  ball.beta = (-ab * speed - aa * at_touch) / determinant;
  double end = 1 + speed;
  for (int k = 0; k < 10; ++k) {
    ball.problem.guess.control[k] = ball.alpha * a[k] + ball.beta * b[k];
    end += a[k] * ball.problem.guess.control[k];
  }
  ball.problem.guess.initial = {1, speed};
  ball.problem.terms = {MakeTerminalCost(0, end + ball.alpha * 0.1 / kWeight, kWeight, 2), MakeEffortCost(1, 1)};
  return ball;
}

TEST(HybridCertificate, HoldsOnBothSidesOfATouch) {
  const TouchingBall ball = BallThatTouches(-6.6);
  ASSERT_LT(ball.alpha, 0);
  ASSERT_GT(ball.beta, 0);
  const Certificate certificate = Certify(ball.problem, ball.problem.guess);
  EXPECT_EQ(certificate.verdict, kStationaryOnGrid) << VerdictInWords(certificate);
  EXPECT_THAT(certificate.reason, HasSubstr("just touches: a kink"));
  ASSERT_EQ(certificate.impacts.size(), 1u);
  EXPECT_NEAR(certificate.impacts[0].time, 0.45, 1e-6);
  EXPECT_NEAR(certificate.impacts[0].multiplier, 0.2 * ball.beta, 1e-4 * ball.beta);
}

TEST(HybridCertificate, DeniesATouchWhereAnEventLowersTheLoss) {
  const TouchingBall ball = BallThatTouches(-6);
  ASSERT_GT(ball.alpha, 0);
  ASSERT_GT(ball.beta, 0);
  const Certificate certificate = Certify(ball.problem, ball.problem.guess);
  EXPECT_EQ(certificate.verdict, kNotStationary) << VerdictInWords(certificate);
  EXPECT_THAT(certificate.reason, HasSubstr("just touches, and the loss falls with an event"));
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
  EXPECT_NEAR(report.solution.parameters[1], 0.988008392024876511903389, 1e-12);
  EXPECT_LT(report.solution.loss, 1e-18);
  ASSERT_TRUE(report.certificate);
  EXPECT_EQ(report.certificate->verdict, kGlobal);

  // From near the published answer the search finds the right one.
  problem.guess.parameters[1] = 0.866;
  SolverOptions options;
  options.limits.iterations = 40;
  const SolveReport searched = Solve("mode_search", problem, options);
  EXPECT_NEAR(searched.solution.parameters[1], 0.988008392024876511903389, 1e-9) << searched.reason;
  EXPECT_LT(searched.solution.loss, 1e-12);
}

TEST(HybridSolvers, BringTheTwoMassHopperFromAllStartsToOneOptimum) {
  HybridProblem problem = TwoMassHopperProblem();
  std::mt19937_64 random(1);
  std::uniform_real_distribution<double> rate(-0.5, 0.5);
  SolverOptions options;
  options.limits.iterations = 200;
  for (int start = 0; start < 14; ++start) {
    problem.guess.control.clear();
    for (int k = 0; k < problem.guess.num_intervals; ++k) problem.guess.control.push_back(rate(random));
    const SolveReport report = Solve("ceres_lm", problem, options);
    EXPECT_NEAR(report.solution.loss, 0.0184634928516979, 1e-12) << start << ": " << report.reason;
  }
}

// The state has five numbers in flight and three in stance, and motions begin in either.
TEST(HybridSolvers, TakeModesOfDifferentSizes) {
  const HybridProblem in_flight = TwoMassHopperProblem();
  HybridProblem in_stance = in_flight;
  in_stance.guess.mode = TwoMassHopper::kStance;
  in_stance.guess.initial = {0.38, 0.0, 0.5};
  in_stance.guess.duration = 0.3;
  for (const HybridProblem& given : {in_flight, in_stance}) {
    const SolveReport expected = Solve("ceres_lm", given, {.limits = {.iterations = 200}});
    for (const std::string solver : {"ceres_phases", "ipopt"}) {
      const SolveReport report = Solve(solver, given, {});
      if (report.termination == Termination::kNotApplicable) continue;  // a build without IPOPT
      ASSERT_EQ(report.termination, Termination::kConverged) << solver << ": " << report.reason;
      // The intervals end at the events, which changes the optimum a little.
      EXPECT_NEAR(report.solution.loss, expected.solution.loss, 1e-3 * expected.solution.loss) << solver;
      HybridProblem again = given;
      again.guess.control = report.solution.control;
      again.guess.lengths = report.solution.durations;
      again.guess.num_intervals = static_cast<int>(report.solution.durations.size());
      if (report.solution.durations.empty()) again.guess.num_intervals = given.guess.num_intervals;
      EXPECT_NEAR(Solve("gd", again, {.limits = {.iterations = 0}}).guess.loss,
                  report.solution.loss,
                  1e-8 * report.solution.loss)
          << solver;
    }
  }
}

// int x^2 dt over an interval in which x is linear in time with a known slope; of state and length.
struct SquareOfLine {
  double slope;
  template <typename T>
  bool operator()(const T* x, const T* h, T* residuals) const {
    using std::sqrt;
    const T root = sqrt(h[0]);
    residuals[0] = root * (x[0] + 0.5 * slope * h[0]);
    residuals[1] = root * h[0] * (slope / std::sqrt(12.0));
    return true;
  }
};

TEST(HybridPhases, FindTheStartOfTheSwitchedLine) {
  // The second derivative of the root of the integral is not in that of Gauss-Newton, which is a seventh of the right
  // one; steps are cut, and end where the loss no longer changes. By integrals over intervals it is
  // nearly right, and x0 is as exact as the loss can tell: 2e-8 changes it by 3e-16.
  HybridProblem by_intervals = SwitchedLineProblem();
  by_intervals.terms.pop_back();
  by_intervals.guess.num_intervals = 20;
  for (const int mode : {0, 1}) {
    HybridTerm square{.name = "integral of x^2",
                      .at = HybridTerm::Timing::kEachInterval,
                      .mode = mode,
                      .with_state = true,
                      .with_length = true};
    square.function =
        std::make_shared<ceres::AutoDiffCostFunction<SquareOfLine, 2, 2, 1>>(new SquareOfLine{mode == 0 ? 3.0 : 1.0});
    by_intervals.terms.push_back(square);
  }
  for (const bool root : {true, false}) {
    const SolveReport report = Solve("ceres_phases", root ? SwitchedLineProblem() : by_intervals, {});
    ASSERT_EQ(report.termination, Termination::kConverged) << report.reason;
    EXPECT_NEAR(report.solution.loss, 1.52377277537495711456099, 1e-12);
    EXPECT_NEAR(report.solution.initial_state[0], -1.42757223208276713401017, root ? 1e-6 : 2e-8);
    ASSERT_TRUE(report.certificate);
    // The integral over an interval is that of the mode in which it begins, which an event behind the node changes.
    EXPECT_EQ(report.certificate->verdict, root ? kStationary : kNotApplicable) << report.certificate->reason;
  }
}

// Minimum time with a terminal constraint, a bound on the state and bounds on the control.
TEST(HybridPhases, DriveTheTurboCarInMinimumTime) {
  const HybridProblem problem = TurboCarProblem();
  const SolveReport report = Solve("ceres_phases", problem, {});
  ASSERT_EQ(report.termination, Termination::kConverged) << report.reason;
  EXPECT_NEAR(report.solution.loss, 40.0 / 3, 1e-8);
  EXPECT_LT(report.solution.violation, 1e-8);
  ASSERT_TRUE(report.certificate);
  EXPECT_EQ(report.certificate->verdict, kStationary) << report.certificate->reason;
  ASSERT_EQ(report.certificate->impacts.size(), 2u);
  EXPECT_NEAR(report.certificate->impacts[0].time, 2, 1e-7);
  EXPECT_NEAR(report.certificate->impacts[1].time, 34.0 / 3, 1e-7);
}

// Other cars, whose control switches within phases. Each phase gets as many intervals as the guess spends there, with
// turbo 39 and 77: the optimum switches at the ends of some of them.
TEST(HybridPhases, DriveOtherCarsInMinimumTime) {
  struct Case {
    TurboCar car;
    double goal, limit, best, duration, thrust;  // the last two of the guess
    std::array<int, 3> intervals;                // of full thrust, none, full brake
    std::vector<double> events;
  };
  for (const Case& at : {Case{{}, 200, 25, 59.0 / 5, 12.5, 4.7, {15, 30, 15}, {2, 49.0 / 5}},
                         Case{{.on = 15, .off = 10}, 150, 25, 152.0 / 15, 10.6, 4.75, {55, 53, 45}, {3, 122.0 / 15}},
                         Case{{.on = 100}, 150, 15, 13, 13.5, 4.5, {3, 7, 3}, {}}}) {
    HybridProblem problem = TurboCarProblem(at.car, at.goal, at.limit);
    problem.guess.duration = at.duration;
    problem.guess.control.clear();
    for (int part = 0; part < 3; ++part) {
      problem.guess.control.insert(problem.guess.control.end(), at.intervals[part], (1 - part) * at.thrust);
    }
    problem.guess.num_intervals = static_cast<int>(problem.guess.control.size());
    const SolveReport report = Solve("ceres_phases", problem, {});
    ASSERT_EQ(report.termination, Termination::kConverged) << report.reason;
    EXPECT_NEAR(report.solution.loss, at.best, 1e-8);
    EXPECT_LT(report.solution.violation, 1e-8);
    ASSERT_TRUE(report.certificate);
    ASSERT_EQ(report.certificate->impacts.size(), at.events.size());
    for (size_t i = 0; i < at.events.size(); ++i) {
      EXPECT_NEAR(report.certificate->impacts[i].time, at.events[i], 1e-7);
    }
  }
}

// The best motion has one bounce; that without one is far dearer (6.356 in continuous time).
TEST(HybridModeSearch, FindsTheBounceAndProvesNothing) {
  HybridProblem problem = ControlledBall(40);
  problem.guess.control.assign(40, 12.0);  // never comes down
  const SolveReport alone = Solve("ceres_phases", problem, {});
  ASSERT_EQ(alone.termination, Termination::kConverged) << alone.reason;
  EXPECT_NEAR(alone.solution.loss, 6.356139587834746772, 0.05);
  SolverOptions options;
  options.sequences.limits.starts = 2;
  const SolveReport report = Solve("mode_search", problem, options);
  ASSERT_EQ(report.termination, Termination::kConverged) << report.reason;
  EXPECT_NEAR(report.solution.loss, kBallOptimum, 3.0 / (40 * 40));
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
  EXPECT_EQ(other.solution.loss, report.solution.loss) << "it does not depend on the number of threads";
  EXPECT_EQ(other.reason, report.reason);
  options.sequences.limits.work = 1;
  EXPECT_THAT(Solve("mode_search", problem, options).reason, HasSubstr("not complete: the limit of work"));
}

// From 4 m at rest to 4 m at rest: against the weight alone, without a bounce. Random starts lead there again and
// again, of which two rounds are enough; several threads simulate them at the same time.
TEST(HybridModeSearch, EndsWhereStartsLeadToTheSameOptimumAgain) {
  HybridProblem problem = ControlledBall(20);
  problem.terms[0] = MakeTerminalCost(0, 4.0, 100.0, 2);
  SolverOptions options;
  const SolveReport report = Solve("mode_search", problem, options);
  ASSERT_EQ(report.termination, Termination::kConverged) << report.reason;
  EXPECT_TRUE(report.optima.at(0).sequence.empty());
  ASSERT_TRUE(report.searched);
  const int random = options.sequences.limits.starts;
  EXPECT_GT(report.searched->starts, 1 + random) << "more starts look for a bounce that is better";
  EXPECT_LT(report.searched->starts, 1 + 7 * random) << "and end before the last round";
  options.threads = 4;
  const SolveReport other = Solve("mode_search", problem, options);
  EXPECT_EQ(other.solution.loss, report.solution.loss);
  EXPECT_EQ(other.searched->starts, report.searched->starts);
  EXPECT_EQ(other.reason, report.reason);
}

// Squares that are all zero need no other start and no neighbour.
TEST(HybridModeSearch, EndsAtALossOfZero) {
  HybridProblem problem = ControlledBall(20);
  problem.terms.pop_back();  // the effort
  const SolveReport report = Solve("mode_search", problem, {});
  ASSERT_EQ(report.termination, Termination::kConverged) << report.reason;
  EXPECT_LE(report.solution.loss, 1e-9);
  EXPECT_EQ(report.work.iterations, 1) << report.reason;
  EXPECT_THAT(report.reason, HasSubstr("with a loss of zero, which ends the search"));
  ASSERT_TRUE(report.certificate);
  EXPECT_NE(report.certificate->verdict, kNotStationary) << report.certificate->reason;
  ASSERT_TRUE(report.searched);
  EXPECT_TRUE(report.searched->complete);
  EXPECT_EQ(report.searched->starts, 1);

  // A cost that is no square may be negative: nothing ends the search early.
  problem.terms.push_back(MakeTerminalCost(1, 0.0, 0.0, 2));
  problem.terms.back().role = HybridTerm::Role::kValue;
  SolverOptions options;
  options.sequences.limits.starts = 1;
  const SolveReport other = Solve("mode_search", problem, options);
  EXPECT_GT(other.work.iterations, 1) << other.reason;
}

// A control that is not free and changes on its grid stays as it is while the event moves, here by more than an
// interval.
TEST(HybridPhases, KeepTheGridOfAGivenControl) {
  HybridProblem problem = ControlledBall(10);
  problem.free = {.initial = {0}, .parameters = {1}};
  problem.guess.control = {1, 1, 1, 1, 1, -3, 2, 2, 5, 2};
  const SolveReport shot = Solve("ceres_lm", problem, {}), report = Solve("ceres_phases", problem, {});
  EXPECT_EQ(report.termination, Termination::kConverged) << report.reason;
  EXPECT_NEAR(report.solution.loss, shot.solution.loss, 1e-9 * shot.solution.loss);
  EXPECT_NEAR(report.solution.parameters[1], shot.solution.parameters[1], 1e-6);
  EXPECT_NEAR(report.solution.initial_state[0], shot.solution.initial_state[0], 1e-6);
  EXPECT_EQ(report.solution.control, problem.guess.control);
  ASSERT_TRUE(report.certificate);
  EXPECT_EQ(report.certificate->verdict, kStationaryOnGrid) << report.certificate->reason;
}

// A point [x v] under a force below a ceiling at 1/9, at which it stays.
struct BelowACeiling {
  static constexpr int kNumControls = 1, kNumParameters = 0;
  static constexpr std::array kStateSizes = {2, 2}, kNumGuards = {1, 0};
  static constexpr std::array<const char*, 1> kGuardNames = {"ceiling"};
  template <typename T>
  void Flow(int mode, const T&, const T* x, const T* u, const T*, T* xdot) const {
    xdot[0] = mode == 0 ? x[1] : T(0);
    xdot[1] = mode == 0 ? u[0] : T(0);
  }
  template <typename T>
  T Guard(int, int, const T&, const T* x, const T*) const {
    return 1.0 / 9 - x[0];
  }
  template <typename T>
  int Reset(int, int, const T&, const T* x, const T*, T* x_plus) const {
    x_plus[0] = x[0];
    x_plus[1] = T(0);
    return 1;
  }
};

// Bryson and Denham on three intervals: both conditions at the end leave the forces (a, -6 - 2 a, a). The first top is
// -1 / 2 a, within the first interval, so that a = -9/2 and the loss is (2 a^2 + 9) / 6. With a = -4 the point is below
// the ceiling at the ends of intervals, and reaches it at one of them.
TEST(HybridPhases, KeepAGuardAboveZeroBetweenTheEndsOfSteps) {
  HybridProblem problem{.system = HybridSystem(BelowACeiling()),
                        .guess = {.initial = {0, 1}, .duration = 1, .num_intervals = 3, .control = {-6, 3, -6}}};
  problem.terms = {MakeEffortCost(0.5, 1), MakeTerminalCost(0, 0, 1, 2, 0), MakeTerminalCost(1, -1, 1, 2, 0)};
  problem.terms[1].role = problem.terms[2].role = HybridTerm::Role::kEquality;
  problem.free.control = true;
  problem.integration.steps_per_interval = 1;
  for (const char* solver : {"ceres_phases", "ipopt"}) {
    const SolveReport report = Solve(solver, problem, {});
    ASSERT_EQ(report.termination, Termination::kConverged) << solver << ": " << report.reason;
    EXPECT_NEAR(report.solution.loss, 8.25, 1e-6) << solver;  // the margin is 1e-8 of the size of the guard
    ASSERT_TRUE(report.certificate);
    EXPECT_THAT(report.certificate->reason, testing::HasSubstr("mode 0/ceiling stay at zero")) << solver;
  }
}

TEST(HybridPhases, SayWhatTheyCannotTake) {
  HybridProblem problem = ControlledBall(10);
  problem.free = {};
  EXPECT_THAT(Solve("mode_search", problem, {}).reason, HasSubstr("nothing to optimize"));
}

}  // namespace
}  // namespace saltus
