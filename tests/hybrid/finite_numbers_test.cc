// Numbers that are not finite, and steps that do not suffice: no verdict, no convergence and no derivative from them.
#include <ceres/autodiff_cost_function.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <memory>
#include <string>
#include <vector>

#include "control/hybrid_shooting.h"
#include "saltus/feedback/filter.h"
#include "saltus/feedback/regulator.h"
#include "saltus/hybrid/compact_system.h"
#include "saltus/hybrid/hybrid_problem.h"
#include "saltus/optimality/hybrid_certificate.h"
#include "saltus/solve/hybrid_solver.h"
#include "solve/enough_steps.h"

namespace saltus {
namespace {

using testing::HasSubstr;

// Motions whose values are finite and whose derivatives are not; u = [f], p = [c], 0 each.
struct Kinked {
  enum Kind { kHypot, kRoot, kOfParameter, kOfControl, kOfTime, kReset, kGuard } kind = kHypot;

  static constexpr int kNumControls = 1;
  static constexpr int kNumParameters = 1;
  static constexpr std::array kStateSizes = {2};
  static constexpr std::array kNumGuards = {1};
  static constexpr std::array<const char*, 1> kModeNames = {"m"};
  static constexpr std::array<const char*, 1> kGuardNames = {"g"};
  static constexpr std::array<const char*, 2> kStateNames = {"y", "v"};
  static constexpr std::array<const char*, 1> kControlNames = {"f"};
  static constexpr std::array<const char*, 1> kParameterNames = {"c"};

  template <typename T>
  void Flow(int, const T& t, const T* x, const T* u, const T* p, T* xdot) const {
    using std::sqrt;
    xdot[0] = kind == kReset || kind == kGuard ? T(2.0) : x[1];
    xdot[1] = u[0];
    if (kind == kHypot) xdot[1] = -sqrt(x[0] * x[0] + x[1] * x[1]);
    if (kind == kRoot) xdot[1] = sqrt(x[0]);
    if (kind == kOfParameter) xdot[1] += sqrt(p[0]);
    if (kind == kOfControl) xdot[1] = sqrt(u[0]);
    if (kind == kOfTime) xdot[1] += sqrt(t);
  }
  template <typename T>
  T Guard(int, int, const T&, const T* x, const T* p) const {
    using std::sqrt;
    if (kind == kGuard) return 1.0 - x[0] + sqrt(p[0]);
    return kind == kReset ? T(1.0 - x[0]) : T(1.0);
  }
  template <typename T>
  int Reset(int, int, const T&, const T* x, const T* p, T* x_plus) const {
    using std::sqrt;
    x_plus[0] = 0.0 * x[0];
    x_plus[1] = kind == kReset ? T(sqrt(p[0])) : x[1];
    return 0;
  }
};

HybridProblem ProblemOf(Kinked::Kind kind) {
  HybridProblem problem{.system = HybridSystem(Kinked{kind}),
                        .guess = {.initial = {0, 0}, .parameters = {0}, .duration = 1, .num_intervals = 4}};
  problem.terms = {MakeTerminalCost(0, 1.0, 1.0, 2), MakeTerminalCost(1, 0.5, 1.0, 2)};
  problem.free = {.control = true, .initial = {0, 1}, .parameters = {0}};
  if (kind == Kinked::kOfTime) problem.integration.tolerance = 1e-7;  // whose errors fall slowly
  return problem;
}

// The solvers that begin at the guess; mode_search has other starts, which have derivatives.
constexpr const char* kSolvers[] = {"gd", "ceres_lbfgs", "ceres_lm", "ceres_phases"};

struct Case {
  Kinked::Kind kind;
  std::string message;
};
const Case kCases[] = {
    {Kinked::kHypot, "the flow in mode 'm' at t = 0 has no finite derivative of v by y"},
    {Kinked::kRoot, "the flow in mode 'm' at t = 0 has no finite derivative of v by y"},
    {Kinked::kOfParameter, "the flow in mode 'm' at t = 0 has no finite derivative of v by c"},
    {Kinked::kOfControl, "the flow in mode 'm' at t = 0 has no finite derivative of v by f"},
    {Kinked::kOfTime, "the flow in mode 'm' at t = 0 has no finite derivative of v by t"},
    {Kinked::kReset, "the reset of guard 'g' in mode 'm' at t = 0.5 has no finite derivative of v by c"},
    {Kinked::kGuard, "the guard 'g' in mode 'm' at t = 0.5 has no finite derivative by c"},
};

TEST(FiniteNumbers, EverySolverAndCertificateNamesTheDerivativeThatIsNone) {
  for (const auto& [kind, message] : kCases) {
    const HybridProblem problem = ProblemOf(kind);
    for (const char* solver : kSolvers) {
      SolverOptions options;
      options.limits.iterations = 10;
      const SolveReport report = Solve(solver, problem, options);
      EXPECT_EQ(report.termination, Termination::kFailed) << solver << ": " << report.reason;
      EXPECT_THAT(report.reason, HasSubstr(message)) << solver;
    }
    HybridInput input = problem.guess;
    input.control.assign(4, 0.0);
    const Certificate certificate = Certify(problem, input);
    EXPECT_EQ(certificate.verdict, Certificate::Verdict::kNotApplicable);
    EXPECT_THAT(certificate.reason, HasSubstr(message));
    HybridShooting shooting(problem);
    double loss = 0;
    std::vector<double> gradient(shooting.num_variables());
    EXPECT_TRUE(shooting.Evaluate(shooting.initial_guess(), &loss, nullptr)) << shooting.FailureReason();
    EXPECT_FALSE(shooting.Evaluate(shooting.initial_guess(), &loss, gradient.data()));
    EXPECT_THAT(shooting.FailureReason(), HasSubstr(message));
  }
}

TEST(FiniteNumbers, MotionsAndFiltersSayWhichDerivativeIsNone) {
  for (const auto& [kind, message] : kCases) {
    const HybridProblem problem = ProblemOf(kind);
    HybridSimulator simulator(problem.system, problem.integration);
    ASSERT_TRUE(simulator.Rollout(problem.guess)) << simulator.FailureReason();
    EXPECT_EQ(simulator.ReasonNotFinite(), "");
    simulator.Sensitivity();
    EXPECT_EQ(simulator.ReasonNotFinite(), message);
    EXPECT_THAT(simulator.ReasonNotDifferentiable(), HasSubstr(message));
    if (kind != Kinked::kHypot && kind != Kinked::kRoot) continue;
    Linearize(simulator, problem.guess);
    EXPECT_EQ(simulator.ReasonNotFinite(), message);
    SaltedKalmanFilter filter(problem.system, {0.0}, 0, 0, Eigen::Vector2d::Zero(), Eigen::Matrix2d::Identity());
    EXPECT_FALSE(filter.Predict(1));
    EXPECT_THAT(filter.FailureReason(), HasSubstr(message));
  }
}

// Drag c |v| v, whose Jets are not finite at rest and whose derivatives there are zero. x = [x y v_x v_y], p = [g c w],
// of which w is the speed of a wind along x. At y = 0 the ball loses c |v| v of its velocity.
struct Dragged {
  static constexpr Sizes kSizes{.states = 4, .controls = 1, .parameters = 3, .guards = 1};

  template <typename T>
  static std::array<T, 2> Drag(const At<T>& a) {
    using std::sqrt;
    const T v = a.x[2] - a.p[2], size = a.p[1] * sqrt(v * v + a.x[3] * a.x[3]);
    return {size * v, size * a.x[3]};
  }
  template <typename T>
  auto Flow(const At<T>& a) const {
    const auto drag = Drag(a);
    return Row<T>{a.x[2], a.x[3], a.u[0] - drag[0], a.p[0] - drag[1]};
  }
  template <typename T>
  T Guard(const At<T>& a) const {
    return a.x[1] + 1.0 + Drag(a)[0];
  }
  template <typename T>
  auto Reset(const At<T>& a) const {
    const auto drag = Drag(a);
    return Row<T>{a.x[0], a.x[1], a.x[2] - drag[0], a.x[3] - drag[1]};
  }
};

// With r = sqrt(g c), v_y = sqrt(g / c) tanh(r t), and v_x' = u - c |v_y| (v_x - w) where v_x is close to w.
TEST(FiniteNumbers, DragHasTheDerivativesOfItsLimitAtRest) {
  const double g = 9.81, c = 0.1, r = std::sqrt(g * c), squared = std::pow(std::cosh(r), -2);
  for (const double wind : {0.0, 3.0}) {
    HybridSimulator simulator{MakeHybridSystem(Dragged())};
    ASSERT_TRUE(
        simulator.Rollout({.initial = {0, 0, wind, 0}, .parameters = {g, c, wind}, .duration = 1, .control = {0}}))
        << simulator.FailureReason();
    const HybridSensitivity found = simulator.Sensitivity();
    EXPECT_EQ(simulator.ReasonNotDifferentiable(), "");
    Eigen::Matrix4d by_initial;
    const double swept = std::atan(std::sinh(r)) / r;
    by_initial << 1, 0, swept, 0, 0, 1, 0, std::tanh(r) / r, 0, 0, 1 / std::cosh(r), 0, 0, 0, 0, squared;
    const auto by = [&](int state, int input) { return found.final_state[state * found.columns + input]; };
    constexpr int kForce = 4, kGravity = 5, kDrag = 6, kWind = 7;
    for (int i = 0; i < 4; ++i) {
      for (int j = 0; j < 4; ++j) EXPECT_NEAR(by(i, j), by_initial(i, j), 1e-9) << i << j;
    }
    // The derivatives of v_y by g and c, and those of what the wind carries.
    EXPECT_NEAR(by(3, kGravity), 0.5 / std::sqrt(g * c) * std::tanh(r) + 0.5 * squared, 1e-9);
    EXPECT_NEAR(by(3, kDrag), 0.5 * g / c * (squared - std::tanh(r) / r), 1e-8);
    EXPECT_NEAR(by(2, kWind), 1 - 1 / std::cosh(r), 1e-9);
    EXPECT_NEAR(by(0, kWind), 1 - swept, 1e-9);
    // v_x = u sech(r t) times the integral of cosh(r s).
    EXPECT_NEAR(by(2, kForce), std::tanh(r) / r, 1e-9);
    const HybridGradient gradient = simulator.Adjoint(std::vector<double>{1, 2, 3, 4});
    const Eigen::RowVector4d weights(1, 2, 3, 4), by_state = weights * by_initial;
    for (int i = 0; i < 4; ++i) EXPECT_NEAR(gradient.initial[i], by_state[i], 1e-8);
    EXPECT_NEAR(gradient.parameters[2], 1 * (1 - swept) + 3 * (1 - 1 / std::cosh(r)), 1e-8);
  }
}

TEST(FiniteNumbers, EveryFunctionOfAStructHasTheDerivativesOfItsLimit) {
  const HybridSystem system = MakeHybridSystem(Dragged());
  const HybridFunctions& functions = system.functions();
  const std::array<double, 4> x = {0.5, -1, 2, 0}, along = {0, 1, 1, 1};
  const std::array<double, 3> p = {9.81, 0.1, 2};
  const double u = 0;
  const ModePoint at{.mode = 0, .t = 0, .x = x.data(), .u = &u, .p = p.data()};
  std::array<double, 9> gradient{};
  std::array<double, 4> after{};
  EXPECT_EQ(functions.GuardGradient(at, 0, gradient.data()), 0);
  for (int i = 0; i < 9; ++i) EXPECT_NEAR(gradient[i], i == 1 ? 1 : 0, 1e-12) << i;
  double rate = 0;
  functions.GuardRate(at, 0, along.data(), &rate);
  EXPECT_NEAR(rate, 1, 1e-12);
  std::array<double, 32> jacobian{};
  functions.ResetJacobian(at, 0, after.data(), jacobian.data());
  for (int i = 0; i < 4; ++i) {
    for (int j = 0; j < 8; ++j) EXPECT_NEAR(jacobian[8 * i + j], i == j ? 1 : 0, 1e-12) << i << j;
  }
}

// x'' = -w^2 x, p = [w].
struct Oscillator {
  static constexpr int kNumControls = 0;
  static constexpr int kNumParameters = 1;
  static constexpr std::array kStateSizes = {2};
  static constexpr std::array kNumGuards = {0};

  template <typename T>
  void Flow(int, const T&, const T* x, const T*, const T* p, T* xdot) const {
    xdot[0] = x[1];
    xdot[1] = -p[0] * p[0] * x[0];
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

TEST(EnoughSteps, AreTakenForEveryMotionThatAsksForAccuracy) {
  HybridSimulator simulator{HybridSystem(Oscillator())};
  for (const double w : {1.0, 60.0, 2.0, 300.0}) {
    ASSERT_TRUE(simulator.RolloutAccurately({.initial = {1, 0}, .parameters = {w}, .duration = 2}));
    EXPECT_NEAR(simulator.final_state()[0], std::cos(2 * w), 1e-9);
  }
}

// The price of w holds it near 60, where the loss has its minima; the guess has the steps of w = 3.
struct Price {
  template <typename T>
  bool operator()(const T* p, T* residual) const {
    residual[0] = 3.0 * (p[0] - 60.0);
    return true;
  }
};

TEST(EnoughSteps, AreTakenAtASolution) {
  HybridProblem problem{.system = HybridSystem(Oscillator()),
                        .guess = {.initial = {1, 0}, .parameters = {3}, .duration = 2}};
  HybridTerm price{.name = "price", .with_parameters = true};
  price.function = std::make_shared<ceres::AutoDiffCostFunction<Price, 1, 1>>(new Price);
  problem.terms = {price, MakeTerminalCost(0, 0.3, 1.0, 2)};
  problem.free = {.parameters = {0}};
  for (const char* solver : {"ceres_lm", "ceres_lbfgs", "ceres_phases"}) {
    SolverOptions options;
    options.limits.iterations = 200;
    const SolveReport report = Solve(solver, problem, options);
    const double w = report.solution.parameters[0];
    EXPECT_NEAR(report.solution.loss,
                9 * std::pow(w - 60, 2) + std::pow(std::cos(2 * w) - 0.3, 2),
                1e-9 * std::max(1.0, report.solution.loss))
        << solver;
    if (report.termination == Termination::kConverged) {
      EXPECT_NEAR(18 * (w - 60) - 4 * (std::cos(2 * w) - 0.3) * std::sin(2 * w), 0, 1e-5) << solver;
    }
    EXPECT_LT(report.solution.integration_error, 1e-10) << solver;
    EXPECT_LE(report.work.iterations, 200);
    EXPECT_EQ(report.history.losses.size(), report.work.iterations + 1u);
  }
}

// A solver whose first solution needs more steps, though nothing is won by it.
TEST(EnoughSteps, AreNotTakenAtASolutionOfNoUse) {
  HybridProblem problem{.system = HybridSystem(Oscillator()),
                        .guess = {.initial = {1, 0}, .parameters = {3}, .duration = 2}};
  problem.terms = {MakeTerminalCost(0, 0.3, 1.0, 2)};
  problem.free = {.parameters = {0}};
  for (const bool is_of_use : {false, true}) {
    int solves = 0;
    const auto solve = [&](const HybridProblem&, const SolverOptions&) {
      SolveReport report;
      report.termination = Termination::kNoProgress;
      report.history.losses = {1};
      report.guess.loss = report.solution.loss = 1;
      report.solution.parameters = {60};
      report.solution.integration_error = ++solves == 1 ? 1 : 0;
      return report;
    };
    SolveWithEnoughSteps(problem, {}, solve, [&](const SolveReport&) { return is_of_use; });
    EXPECT_EQ(solves, is_of_use ? 2 : 1);
  }
}

TEST(Options, ThatAreNoneAreRefused) {
  HybridProblem problem{.system = HybridSystem(Oscillator()),
                        .guess = {.initial = {1, 0}, .parameters = {3}, .duration = 2}};
  problem.terms = {MakeTerminalCost(0, 0.3, 1.0, 2)};
  problem.free = {.parameters = {0}};
  for (const double rate : {0.0, -1.0, double{NAN}, double{INFINITY}}) {
    SolverOptions options;
    options.descent.learning_rate = rate;
    const SolveReport report = Solve("gd", problem, options);
    EXPECT_EQ(report.termination, Termination::kNotApplicable);
    EXPECT_THAT(report.reason, HasSubstr("learning_rate: found "));
  }
  SolverOptions tiny;
  tiny.descent.learning_rate = 1e-300;
  EXPECT_EQ(Solve("gd", problem, tiny).termination, Termination::kNoProgress);
  for (const char* solver : kSolvers) {
    for (const int iterations : {0, 1, 2, 5}) {
      SolverOptions options;
      options.limits.iterations = iterations;
      const SolveReport report = Solve(solver, problem, options);
      EXPECT_LE(report.work.iterations, iterations) << solver;
      EXPECT_EQ(report.history.losses.size(), report.work.iterations + 1u) << solver;
    }
  }
}

// A ball of restitution 1/2 that falls from rest, u = [f, w], beside a state z with dz/dt = w.
struct BallAndIntegrator {
  static constexpr int kNumControls = 2, kNumParameters = 0;
  static constexpr std::array kStateSizes = {3}, kNumGuards = {1};

  template <typename T>
  void Flow(int, const T&, const T* x, const T* u, const T*, T* xdot) const {
    xdot[0] = x[1];
    xdot[1] = u[0] - 9.81;
    xdot[2] = u[1];
  }
  template <typename T>
  T Guard(int, int, const T&, const T* x, const T*) const {
    return x[0];
  }
  template <typename T>
  int Reset(int, int, const T&, const T* x, const T*, T* out) const {
    out[0] = x[0];
    out[1] = -0.5 * x[1];
    out[2] = x[2];
    return 0;
  }
};

// The multipliers of bounces that accumulate grow with their number, up to 1e9, and cancel. z(T) is 0, where its cost
// (z - 1)^2 has a slope, whatever the ball does.
TEST(ManyBounces, DoNotMakeAControlStationary) {
  const double fall = std::sqrt(2 / 9.81);
  for (const int bounces : {3, 28}) {
    double duration = fall;
    for (int i = 1; i < bounces; ++i) duration += fall * std::ldexp(1.0, 1 - i);
    duration += 0.5 * fall * std::ldexp(1.0, 1 - bounces);
    const HybridProblem problem{.system = HybridSystem(BallAndIntegrator()),
                                .guess = {.initial = {1, 0, 0}, .duration = duration, .num_intervals = 4},
                                .terms = {MakeTerminalCost(1, 3, 1, 3), MakeTerminalCost(2, 1, 1, 3)},
                                .free = {.control = true}};
    const Certificate certificate = Certify(problem, problem.guess);
    ASSERT_EQ(std::ssize(certificate.impacts), bounces);
    EXPECT_EQ(certificate.verdict, Certificate::Verdict::kNotStationary) << bounces;
    EXPECT_GT(certificate.stationarity, 0.1) << bounces;
  }
}

}  // namespace
}  // namespace saltus
