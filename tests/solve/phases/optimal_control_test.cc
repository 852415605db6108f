// Optimal control problems of the textbooks, posed as hybrid systems without events: solved from plain guesses to the
// optima that IPOPT finds on the same grids (zero-order hold), or that closed forms give.
#include <ceres/autodiff_cost_function.h>
#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <memory>
#include <numbers>
#include <string>
#include <vector>

#include "saltus/hybrid/hybrid_problem.h"
#include "saltus/optimality/hybrid_certificate.h"
#include "saltus/solve/hybrid_solver.h"
#include "solve/phases/interior_point.h"

namespace saltus {
namespace {

using Timing = HybridTerm::Timing;
using Role = HybridTerm::Role;

// A system with one mode and without events.
template <typename Derivative, int kStates, int kControls>
struct Smooth {
  static constexpr int kNumControls = kControls, kNumParameters = 0;
  static constexpr std::array kStateSizes = {kStates};
  static constexpr std::array kNumGuards = {0};
  template <typename T>
  void Flow(int /*mode*/, const T& /*t*/, const T* x, const T* u, const T* /*p*/, T* xdot) const {
    Derivative()(x, u, xdot);
  }
  template <typename T>
  T Guard(int /*mode*/, int /*guard*/, const T& /*t*/, const T* /*x*/, const T* /*p*/) const {
    return T(1);
  }
  template <typename T>
  int Reset(int, int, const T& /*t*/, const T* /*x*/, const T* /*p*/, T* /*x_plus*/) const {
    return 0;
  }
};

struct DoubleIntegrator {
  template <typename T>
  void operator()(const T* x, const T* u, T* xdot) const {
    xdot[0] = x[1];
    xdot[1] = u[0];
  }
};
struct Brachistochrone {
  template <typename T>
  void operator()(const T* x, const T* u, T* xdot) const {
    using std::cos, std::sin;
    xdot[0] = x[2] * cos(u[0]);
    xdot[1] = x[2] * sin(u[0]);
    xdot[2] = 9.81 * sin(u[0]);
  }
};
struct VanDerPol {
  template <typename T>
  void operator()(const T* x, const T* u, T* xdot) const {
    xdot[0] = (1.0 - x[1] * x[1]) * x[0] - x[1] + u[0];
    xdot[1] = x[0];
    xdot[2] = x[0] * x[0] + x[1] * x[1] + u[0] * u[0];
  }
};
struct RobotArm {
  template <typename T>
  void operator()(const T* x, const T* u, T* xdot) const {
    using std::sin;
    const T a = 5.0 - x[0], inertia = (a * a * a + x[0] * x[0] * x[0]) / 3.0, s = sin(x[2]);
    for (int i = 0; i < 3; ++i) xdot[i] = x[3 + i];
    xdot[3] = u[0] / 5.0;
    xdot[4] = u[1] / (inertia * s * s);
    xdot[5] = u[2] / inertia;
  }
};
struct Rocket {
  template <typename T>
  void operator()(const T* x, const T* u, T* xdot) const {
    using std::exp;
    const T drag = 310.0 * x[1] * x[1] * exp(-500.0 * (x[0] - 1.0));
    xdot[0] = x[1];
    xdot[1] = (u[0] - drag) / x[2] - 1.0 / (x[0] * x[0]);
    xdot[2] = -2.0 * u[0];
  }
};

// A rotor on each side of a body, with positions, angle, velocities and rate of turning.
struct Quadrotor {
  template <typename T>
  void operator()(const T* x, const T* u, T* xdot) const {
    using std::cos, std::sin;
    for (int i = 0; i < 3; ++i) xdot[i] = x[3 + i];
    xdot[3] = -(u[0] + u[1]) * sin(x[2]);
    xdot[4] = (u[0] + u[1]) * cos(x[2]) - 9.81;
    xdot[5] = 10.0 * (u[0] - u[1]);
  }
};
struct Spring {
  template <typename T>
  void operator()(const T* x, const T* u, T* xdot) const {
    xdot[0] = x[1];
    xdot[1] = u[0] - x[0];
  }
};
struct Integrator {
  template <typename T>
  void operator()(const T* /*x*/, const T* u, T* xdot) const {
    xdot[0] = u[0];
  }
};

// A chain of height x[0] and slope u, with its weight times height and its length.
struct HangingChain {
  template <typename T>
  void operator()(const T* x, const T* u, T* xdot) const {
    using std::sqrt;
    xdot[0] = u[0];
    xdot[2] = sqrt(1.0 + u[0] * u[0]);
    xdot[1] = x[0] * xdot[2];
  }
};

// Rayleigh's oscillator, with the integral of u^2 + x^2.
struct Rayleigh {
  template <typename T>
  void operator()(const T* x, const T* u, T* xdot) const {
    xdot[0] = x[1];
    xdot[1] = -x[0] + x[1] * (1.4 - 0.14 * x[1] * x[1]) + 4.0 * u[0];
    xdot[2] = u[0] * u[0] + x[0] * x[0];
  }
};
// A treatment of infected cells: healthy cells, infected ones, virus, and the integral of what is to be large, of which
// the price of the treatment is a part or not. The virus grows a thousandfold.
template <bool kWithPrice>
struct Treatment {
  template <typename T>
  void operator()(const T* x, const T* u, T* xdot) const {
    const T infected = 2.4e-5 * x[2] * x[0];
    xdot[0] = 10.0 / (1.0 + x[2]) - 0.02 * x[0] + 0.03 * x[0] * (1.0 - (x[0] + x[1]) / 1500.0) - infected;
    xdot[1] = infected - 0.5 * x[1];
    xdot[2] = 600.0 * x[1] * (1.0 - u[0]) - 4.4 * x[2];
    xdot[3] = 1e-3 * x[0];
    if (kWithPrice) xdot[3] -= 0.05 * u[0] * u[0];
  }
};
// A spacecraft with a small thrust in the direction u from the tangent: radius, speeds along it and across, and mass.
// Units are those in which the first orbit has the radius kLength, and a period of 2 pi kTime.
constexpr double kMetres = 1.495978707e11, kSeconds = 5.0226757e6;
template <bool kInMetres>
struct Spacecraft {
  static constexpr double kLength = kInMetres ? kMetres : 1, kTime = kInMetres ? kSeconds : 1;
  static constexpr double kGravity = kLength * kLength * kLength / (kTime * kTime);
  template <typename T>
  void operator()(const T* x, const T* u, T* xdot) const {
    using std::cos, std::sin;
    const T push = 0.1405 * kLength / (kTime * kTime) / x[3];
    xdot[0] = x[1];
    xdot[1] = x[2] * x[2] / x[0] - kGravity / (x[0] * x[0]) + push * sin(u[0]);
    xdot[2] = -x[1] * x[2] / x[0] + push * cos(u[0]);
    xdot[3] = T(-0.0749 / kTime);
  }
};
// A body that is pushed along its axis by u[0] and turned by u[1]: positions, velocities and the angle of the axis.
struct Thruster {
  template <typename T>
  void operator()(const T* x, const T* u, T* xdot) const {
    using std::cos, std::sin;
    xdot[0] = x[2];
    xdot[1] = x[3];
    xdot[2] = u[0] * cos(x[4]);
    xdot[3] = u[0] * sin(x[4]);
    xdot[4] = u[1];
  }
};

// The rows sign[i] (x[component[i]] - value[i]).
template <int kRows>
struct Rows {
  std::array<int, kRows> component;
  std::array<double, kRows> sign, value;
  template <typename T>
  bool operator()(const T* x, T* r) const {
    for (int i = 0; i < kRows; ++i) r[i] = sign[i] * (x[component[i]] - value[i]);
    return true;
  }
};
template <int kRows, int kStates>
HybridTerm StateRows(Timing at, Role role, std::array<int, kRows> component, std::array<double, kRows> sign,
                     std::array<double, kRows> value) {
  return {.at = at,
          .role = role,
          .with_state = true,
          .function = std::make_shared<ceres::AutoDiffCostFunction<Rows<kRows>, kRows, kStates>>(
              new Rows<kRows>{component, sign, value})};
}

template <typename Derivative, int kStates, int kControls>
HybridProblem Problem(std::vector<double> initial, double duration, double control, int intervals) {
  HybridProblem problem{.system = HybridSystem(Smooth<Derivative, kStates, kControls>()),
                        .guess = {.initial = std::move(initial), .duration = duration, .num_intervals = intervals}};
  problem.guess.control.assign(static_cast<size_t>(intervals) * kControls, control);
  problem.free.control = true;
  return problem;
}

HybridProblem DoubleIntegratorProblem(int intervals) {
  HybridProblem problem = Problem<DoubleIntegrator, 2, 1>({1, 0}, 3, 0, intervals);
  problem.terms = {MakeDurationCost(1), StateRows<2, 2>(Timing::kEnd, Role::kEquality, {0, 1}, {1, 1}, {0, 0})};
  problem.free.duration = true;
  problem.free.duration_min = 0.5;
  problem.free.duration_max = 10;
  problem.free.control_min = {-1};
  problem.free.control_max = {1};
  return problem;
}

HybridProblem BrachistochroneProblem(int intervals) {
  HybridProblem problem = Problem<Brachistochrone, 3, 1>({0, 0, 0}, 1, 0.8, intervals);
  problem.terms = {MakeDurationCost(1), StateRows<2, 3>(Timing::kEnd, Role::kEquality, {0, 1}, {1, 1}, {2, 2})};
  problem.free.duration = true;
  problem.free.duration_min = 0.1;
  problem.free.duration_max = 10;
  return problem;
}

// The loss is the third state itself, which is no square.
HybridProblem VanDerPolProblem(int intervals, bool bounded) {
  HybridProblem problem = Problem<VanDerPol, 3, 1>({0, 1, 0}, 5, 0, intervals);
  problem.terms = {StateRows<1, 3>(Timing::kEnd, Role::kValue, {2}, {1}, {0})};
  if (bounded) {
    problem.free.control_min = {-0.3};
    problem.free.control_max = {1};
  }
  return problem;
}

HybridProblem BrysonDenhamProblem(int intervals) {
  HybridProblem problem = Problem<DoubleIntegrator, 2, 1>({0, 1}, 1, 0, intervals);
  problem.terms = {MakeEffortCost(0.5, 1),
                   StateRows<2, 2>(Timing::kEnd, Role::kEquality, {0, 1}, {1, 1}, {0, -1}),
                   StateRows<1, 2>(Timing::kEachInterval, Role::kInequality, {0}, {1}, {1.0 / 9})};
  return problem;
}

HybridProblem RobotArmProblem(int intervals) {
  constexpr double kPi = std::numbers::pi;
  HybridProblem problem = Problem<RobotArm, 6, 3>({4.5, 0, kPi / 4, 0, 0, 0}, 8, 0, intervals);
  problem.terms = {
      MakeDurationCost(1),
      StateRows<6, 6>(
          Timing::kEnd, Role::kEquality, {0, 1, 2, 3, 4, 5}, {1, 1, 1, 1, 1, 1}, {4.5, 2 * kPi / 3, kPi / 4, 0, 0, 0}),
      StateRows<4, 6>(Timing::kEachInterval, Role::kInequality, {0, 0, 2, 2}, {-1, 1, -1, 1}, {0, 5, 0, kPi})};
  problem.free.duration = true;
  problem.free.duration_min = 1;
  problem.free.duration_max = 30;
  problem.free.control_min = {-1, -1, -1};
  problem.free.control_max = {1, 1, 1};
  return problem;
}

// The loss is minus the height at the end.
HybridProblem RocketProblem(int intervals) {
  HybridProblem problem = Problem<Rocket, 3, 1>({1, 0, 1}, 0.2, 1, intervals);
  problem.terms = {StateRows<1, 3>(Timing::kEnd, Role::kValue, {0}, {-1}, {0}),
                   StateRows<1, 3>(Timing::kEnd, Role::kEquality, {2}, {1}, {0.6}),
                   StateRows<1, 3>(Timing::kEachInterval, Role::kInequality, {1}, {-1}, {0})};
  problem.free.duration = true;
  problem.free.duration_min = 0.01;
  problem.free.duration_max = 1;
  problem.free.control_min = {0};
  problem.free.control_max = {3.5};
  return problem;
}

void ExpectOptimum(const HybridProblem& problem, double optimum, double digits, const std::string& name,
                   std::string_view solver = "auto") {
  const SolveReport report =
      Solve(solver, problem, {.limits = {.iterations = 3000}, .sequences = {.limits = {.starts = 1}}});
  ASSERT_EQ(report.termination, Termination::kConverged) << name << ": " << report.reason;
  EXPECT_NEAR(report.solution.loss, optimum, digits) << name;
  EXPECT_LE(report.solution.violation, kFeasible) << name;
  ASSERT_TRUE(report.certificate) << name;
  EXPECT_TRUE(report.certificate->IsStationary()) << name << ": " << report.certificate->reason;
  EXPECT_FALSE(report.certificate->IsSaddle()) << name;
}

// Half of the last digit of the references.
TEST(OptimalControl, ReachesTheOptimaOfTextbooksFromPlainGuesses) {
  if (!HasInteriorPoint()) GTEST_SKIP() << "this build has no IPOPT";
  for (const int intervals : {20, 80}) {
    const bool coarse = intervals == 20;
    const std::string at = " at " + std::to_string(intervals) + " intervals";
    ExpectOptimum(DoubleIntegratorProblem(intervals), 2, 1e-8, "double integrator" + at);
    ExpectOptimum(BrachistochroneProblem(intervals), coarse ? 0.82446 : 0.824346, coarse ? 5e-6 : 5e-7, "chute" + at);
    ExpectOptimum(
        VanDerPolProblem(intervals, true), coarse ? 2.8815 : 2.86806, coarse ? 5e-5 : 5e-6, "oscillator" + at);
    ExpectOptimum(BrysonDenhamProblem(intervals), coarse ? 4.02026 : 4.00137, 5e-6, "Bryson and Denham" + at);
    ExpectOptimum(RobotArmProblem(intervals), coarse ? 9.14363 : 9.14135, 5e-6, "robot arm" + at);
    ExpectOptimum(RocketProblem(intervals), coarse ? -1.012829 : -1.012837, 5e-7, "rocket" + at);
  }
}

// Along the sequence of the guess ceres_phases misses the constraints.
TEST(OptimalControl, AModeSearchSolvesFromTheGuessWithSecondDerivativesToo) {
  if (!HasInteriorPoint()) GTEST_SKIP() << "this build has no IPOPT";
  EXPECT_NE(Solve("ceres_phases", BrachistochroneProblem(20), {}).termination, Termination::kConverged);
  ExpectOptimum(BrachistochroneProblem(20), 0.82446, 5e-6, "chute", "mode_search");
}

TEST(OptimalControl, FindsAValueThatIsNoSquareWithoutBounds) {
  if (!HasInteriorPoint()) GTEST_SKIP() << "this build has no IPOPT";
  const struct {
    int intervals;
    double optimum, digits;
  } cases[] = {{5, 3.11239, 5e-6}, {20, 2.8814, 5e-5}, {80, 2.8679, 5e-5}};
  for (const auto& [intervals, optimum, digits] : cases) {
    ExpectOptimum(VanDerPolProblem(intervals, false), optimum, digits, std::to_string(intervals) + " intervals");
    const SolveReport lbfgs = Solve("ceres_lbfgs", VanDerPolProblem(intervals, false), {});
    EXPECT_NEAR(lbfgs.solution.loss, optimum, digits);
  }
}

TEST(OptimalControl, LeastSquaresRefusesACostThatIsNoSquare) {
  const SolveReport report = Solve("ceres_lm", VanDerPolProblem(5, false), {});
  EXPECT_EQ(report.termination, Termination::kNotApplicable);
  EXPECT_NE(report.reason.find("no square"), std::string::npos) << report.reason;
}

// Both algorithms find the only optimum of a linear system with quadratic costs.
TEST(OptimalControl, BothAlgorithmsAgreeOnSquares) {
  if (!HasInteriorPoint()) GTEST_SKIP() << "this build has no IPOPT";
  HybridProblem problem = Problem<DoubleIntegrator, 2, 1>({1, 0}, 1, 0, 40);
  problem.terms = {MakeTerminalCost(0, 0, 100, 2), MakeTerminalCost(1, 0, 100, 2), MakeEffortCost(0.1, 1)};
  const SolveReport squares = Solve("ceres_phases", problem, {}), interior = Solve("ipopt", problem, {});
  ASSERT_EQ(squares.termination, Termination::kConverged) << squares.reason;
  ASSERT_EQ(interior.termination, Termination::kConverged) << interior.reason;
  EXPECT_NEAR(squares.solution.loss, interior.solution.loss, 1e-10);
  const SolveReport automatic = Solve("auto", problem, {});
  EXPECT_EQ(automatic.solver, "ceres_lm");
  EXPECT_NEAR(automatic.solution.loss, interior.solution.loss, 1e-10);
  ASSERT_TRUE(automatic.certificate);
  EXPECT_TRUE(automatic.certificate->IsStationary());
}

// The optimum of one solve is the guess of the next, which recognises it.
TEST(OptimalControl, RecogniseAGuessAtTheOptimum) {
  if (!HasInteriorPoint()) GTEST_SKIP() << "this build has no IPOPT";
  for (HybridProblem problem : {DoubleIntegratorProblem(20),
                                BrachistochroneProblem(20),
                                VanDerPolProblem(20, true),
                                BrysonDenhamProblem(20),
                                RobotArmProblem(20),
                                RocketProblem(20)}) {
    const SolveReport first = Solve("auto", problem, {.limits = {.iterations = 3000}});
    ASSERT_EQ(first.termination, Termination::kConverged) << first.reason;
    problem.guess = SolutionOf(problem, first);
    for (const char* solver : {"auto", "ipopt", "ceres_phases"}) {
      const SolveReport again = Solve(solver, problem, {});
      EXPECT_EQ(again.termination, Termination::kConverged) << solver << ": " << again.reason;
      EXPECT_LE(again.work.iterations, 5) << solver;
      EXPECT_NEAR(again.solution.loss, first.solution.loss, 1e-6 * std::abs(first.solution.loss)) << solver;
    }
  }
}

// Both rotors are at their bounds most of the time. The final state is so sensitive to them that controls which go back
// to bounds that were relaxed by 1e-10 miss it by 4e-8. The optimum was found by sequential quadratic programming
// (SciPy's SLSQP, from 11 of 12 random guesses), with steps of Runge and Kutta whose error is below 1e-6.
TEST(OptimalControl, MeetsSensitiveConstraintsWithControlsAtTheirBounds) {
  if (!HasInteriorPoint()) GTEST_SKIP() << "this build has no IPOPT";
  HybridProblem problem = Problem<Quadrotor, 6, 2>({0, 0, 0, 0, 0, 0}, 2, 4.905, 10);
  problem.terms = {
      MakeDurationCost(1),
      StateRows<6, 6>(Timing::kEnd, Role::kEquality, {0, 1, 2, 3, 4, 5}, {1, 1, 1, 1, 1, 1}, {3, 1, 0, 0, 0, 0})};
  problem.free.duration = true;
  problem.free.duration_min = 0.5;
  problem.free.duration_max = 6;
  problem.free.control_min = {0, 0};
  problem.free.control_max = {9, 9};
  ExpectOptimum(problem, 1.2433706, 1e-6, "quadrotor");
}

// From 5 s the least miss of the target is a local minimum near 6.7 s. The optimum was found by sequential quadratic
// programming (SciPy's SLSQP) on the same grid.
TEST(OptimalControl, TriesALongerDurationWhereConstraintsAreMissed) {
  if (!HasInteriorPoint()) GTEST_SKIP() << "this build has no IPOPT";
  HybridProblem problem = Problem<Spring, 2, 1>({5, 3}, 5, 0, 20);
  problem.terms = {MakeDurationCost(1), StateRows<2, 2>(Timing::kEnd, Role::kEquality, {0, 1}, {1, 1}, {0, 0})};
  problem.free.duration = true;
  problem.free.duration_min = 1;
  problem.free.duration_max = 40;
  problem.free.control_min = {-1};
  problem.free.control_max = {1};
  const SolveReport report = Solve("auto", problem, {.limits = {.iterations = 1000}});
  EXPECT_EQ(report.termination, Termination::kConverged) << report.reason;
  EXPECT_NEAR(report.solution.loss, 9.2079, 5e-5);
  EXPECT_NE(report.reason.find("ipopt from twice the duration"), std::string::npos) << report.reason;
}

// x - 2 / x = 0 at the end, which has a pole at 0.
struct Pole {
  template <typename T>
  bool operator()(const T* x, T* r) const {
    r[0] = x[0] - 2.0 / x[0];
    return true;
  }
};

// The motion of the guess goes from 1 to 1 - 1e-8. Less its largest value it is near the pole, where the constraint
// changes by 1e16. Divided by that, it would hold at any place.
TEST(OptimalControl, AConstraintWithAPoleIsMet) {
  HybridProblem problem = Problem<Integrator, 1, 1>({1}, 1, -1e-8, 4);
  problem.terms = {MakeEffortCost(1, 1),
                   {.at = Timing::kEnd,
                    .role = Role::kEquality,
                    .with_state = true,
                    .function = std::make_shared<ceres::AutoDiffCostFunction<Pole, 1, 1>>(new Pole)}};
  const double velocity = std::numbers::sqrt2 - 1;  // constant at the optimum
  ExpectOptimum(problem, velocity * velocity, 1e-9, "pole", "ceres_phases");
  if (HasInteriorPoint()) ExpectOptimum(problem, velocity * velocity, 1e-9, "pole", "ipopt");
}

// Its guess is 60 away from the optimum in units of the control in which a state doubles, as these are those of a
// motion that is not stable. L-BFGS needs no units.
TEST(OptimalControl, TriesUnitsOfTheVariables) {
  if (!HasInteriorPoint()) GTEST_SKIP() << "this build has no IPOPT";
  HybridProblem problem = Problem<Rayleigh, 3, 1>({-5, -5, 0}, 2.5, 0, 20);
  problem.terms = {StateRows<1, 3>(Timing::kEnd, Role::kValue, {2}, {1}, {0})};
  const SolveReport lbfgs = Solve("ceres_lbfgs", problem, {});
  ASSERT_EQ(lbfgs.termination, Termination::kConverged) << lbfgs.reason;
  ExpectOptimum(problem, lbfgs.solution.loss, 1e-6, "Rayleigh", "ipopt");
}

// A chain of length 4 that hangs between heights 1 and 3 at a distance of 1: the catenary a cosh((t - c) / a) + b. From
// a straight guess many intervals lead astray, and few ones do not.
TEST(OptimalControl, GoesOnFromFewIntervals) {
  HybridProblem problem = Problem<HangingChain, 3, 1>({1, 0, 0}, 1, 2, 160);
  problem.terms = {StateRows<1, 3>(Timing::kEnd, Role::kValue, {1}, {1}, {0}),
                   StateRows<2, 3>(Timing::kEnd, Role::kEquality, {0, 2}, {1, 1}, {3, 4})};
  double a = 0.2;  // by Newton's method: the square of 2 a sinh(1 / 2a) is that of the length less that of the rise
  for (int i = 0; i < 20; ++i) {
    const double s = 0.5 / a;
    a -= (2 * a * std::sinh(s) - std::sqrt(12.0)) / (2 * std::sinh(s) - 2 * s * std::cosh(s));
  }
  const double c = 0.5 - a * std::atanh(0.5), b = 1 - a * std::cosh(c / a);
  const auto moment = [](double s) { return s / 2 + std::sinh(2 * s) / 4; };
  const double optimum = a * a * (moment((1 - c) / a) - moment(-c / a)) + 4 * b;
  const SolveReport report = Solve("auto", problem, {});
  ASSERT_EQ(report.termination, Termination::kConverged) << report.reason;
  EXPECT_GT(report.solution.loss, optimum);
  EXPECT_LT(report.solution.loss, optimum + 2e-5);  // slopes are constant over each interval
}

// The end of the transfer is a circular orbit.
template <bool kInMetres>
struct Circular {
  using Craft = Spacecraft<kInMetres>;
  template <typename T>
  bool operator()(const T* x, T* r) const {
    using std::sqrt;
    r[0] = x[1];
    r[1] = x[2] - sqrt(Craft::kGravity / x[0]);
    return true;
  }
};
template <bool kInMetres>
double RadiusOfTransfer() {
  using Craft = Spacecraft<kInMetres>;
  HybridProblem problem =
      Problem<Craft, 4, 1>({Craft::kLength, 0, Craft::kLength / Craft::kTime, 1}, 3.32 * Craft::kTime, 0, 20);
  problem.terms = {
      StateRows<1, 4>(Timing::kEnd, Role::kValue, {0}, {-1}, {0}),
      {.at = Timing::kEnd,
       .role = Role::kEquality,
       .with_state = true,
       .function = std::make_shared<ceres::AutoDiffCostFunction<Circular<kInMetres>, 2, 4>>(new Circular<kInMetres>)}};
  const SolveReport report = Solve("auto", problem, {.limits = {.iterations = 1000}});
  EXPECT_EQ(report.termination, Termination::kConverged) << report.reason;
  return -report.solution.loss / Craft::kLength;
}

// Bryson and Ho, "Applied Optimal Control", section 2.5: the radius is 1.525 in continuous time.
TEST(OptimalControl, AnOrbitIsRaisedInAnyUnits) {
  if (!HasInteriorPoint()) GTEST_SKIP() << "this build has no IPOPT";
  const double radius = RadiusOfTransfer<false>();
  EXPECT_NEAR(radius, 1.525, 1e-3);
  EXPECT_NEAR(RadiusOfTransfer<true>(), radius, 1e-7);
}

// Along the motion of the guess the thruster points up, so that speeds across change by cos(pi / 2), which is rounding.
// Without a force there is no motion at all. The optimum is that from a guess with a force.
TEST(OptimalControl, StatesThatChangeByRoundingHaveSizes) {
  if (!HasInteriorPoint()) GTEST_SKIP() << "this build has no IPOPT";
  std::vector<double> losses;
  for (const double force : {0.5, 0.0}) {
    HybridProblem problem = Problem<Thruster, 5, 2>({0, 0, 0, 0, std::numbers::pi / 2}, 2, 0, 20);
    for (size_t k = 0; k < problem.guess.control.size(); k += 2) problem.guess.control[k] = force;
    problem.terms = {MakeEffortCost(1, 2),
                     StateRows<4, 5>(Timing::kEnd, Role::kEquality, {0, 1, 2, 3}, {1, 1, 1, 1}, {1, 0, 0, 0})};
    problem.free.control_min = {-100, -3};
    problem.free.control_max = {100, 3};
    const SolveReport report = Solve("auto", problem, {.limits = {.iterations = 2000}});
    ASSERT_EQ(report.termination, Termination::kConverged) << report.reason;
    EXPECT_LE(report.solution.violation, kFeasible);
    losses.push_back(report.solution.loss);
  }
  EXPECT_NEAR(losses[1], losses[0], 1e-7);
}

template <bool kWithPrice>
HybridProblem TreatmentProblem() {
  HybridProblem problem = Problem<Treatment<kWithPrice>, 4, 1>({800, 0.04, 1.5, 0}, 50, 0.3, 20);
  problem.terms = {StateRows<1, 4>(Timing::kEnd, Role::kValue, {3}, {-1}, {0})};
  if (!kWithPrice) problem.terms.push_back(MakeEffortCost(0.05, 1));
  problem.free.control_min = {0};
  problem.free.control_max = {1};
  return problem;
}

// States that grow lead phases far astray, where roll-outs never are.
TEST(OptimalControl, SolvesWhereStatesGrow) {
  if (!HasInteriorPoint()) GTEST_SKIP() << "this build has no IPOPT";
  constexpr double kBySequentialQuadraticProgramming = -42.7355022;  // of SciPy, with roll-outs of its own
  const SolveReport report = Solve("auto", TreatmentProblem<true>(), {});
  ASSERT_EQ(report.termination, Termination::kConverged) << report.reason;
  EXPECT_NEAR(report.solution.loss, kBySequentialQuadraticProgramming, 1e-6);
  HybridProblem problem = TreatmentProblem<false>();
  const SolveReport same = Solve("auto", problem, {});
  ASSERT_EQ(same.termination, Termination::kConverged) << same.reason;
  EXPECT_NEAR(same.solution.loss, report.solution.loss, 1e-7);
  constexpr double kMostVirus = 100;
  problem.terms.push_back(StateRows<1, 4>(Timing::kEnd, Role::kInequality, {2}, {1}, {kMostVirus}));
  const SolveReport less = Solve("auto", problem, {});
  ASSERT_EQ(less.termination, Termination::kConverged) << less.reason;
  EXPECT_LE(less.solution.violation, kFeasible);
  EXPECT_GT(less.solution.loss, report.solution.loss);
  ASSERT_TRUE(less.certificate);
  EXPECT_TRUE(less.certificate->IsStationary()) << less.certificate->reason;
}

// One evaluation of second derivatives takes long where intervals have many steps.
TEST(OptimalControl, StopsWhileDerivativesAreEvaluated) {
  if (!HasInteriorPoint()) GTEST_SKIP() << "this build has no IPOPT";
  int asked = 0;
  SolverOptions options;
  options.monitor.stop = [&asked] { return ++asked > 100; };
  const SolveReport report = Solve("ipopt", RobotArmProblem(80), options);
  EXPECT_EQ(report.termination, Termination::kInterrupted) << report.reason;
  EXPECT_LE(report.work.iterations, 1);
}

struct CartAndPole {
  template <typename T>
  void operator()(const T* x, const T* u, T* xdot) const {
    using std::cos, std::sin;
    const T s = sin(x[1]), c = cos(x[1]), below = 1.0 + 0.3 * s * s;
    xdot[0] = x[2];
    xdot[1] = x[3];
    xdot[2] = (u[0] + 0.3 * s * (0.5 * x[3] * x[3] + 9.81 * c)) / below;
    xdot[3] = -2.0 * (u[0] * c + 0.15 * x[3] * x[3] * s * c + 1.3 * 9.81 * s) / below;
  }
};

// The swing of the solution needs more steps of the integration than the guess, at which the first solver of `auto`
// would be taken for one that has found no optimum: its certificate is that of a motion with too few steps.
TEST(OptimalControl, AutomaticSolversHaveEnoughStepsEach) {
  if (!HasInteriorPoint()) GTEST_SKIP() << "this build has no IPOPT";
  HybridProblem problem{.system = HybridSystem(Smooth<CartAndPole, 4, 1>()),
                        .guess = {.initial = {0, 0, 0, 0}, .duration = 2, .num_intervals = 40},
                        .terms = {MakeEffortCost(1, 1), MakeDurationCost(1)}};
  problem.guess.control.assign(40, 0.1);
  const std::array target = {0.5, std::numbers::pi, 0.0, 0.0};
  for (int i = 0; i < 4; ++i) problem.terms.push_back(MakeTerminalCost(i, target[i], 100, 4));
  problem.free = {.control = true, .duration = true, .duration_min = 0.6, .duration_max = 6};
  const SolveReport report = Solve("auto", problem, {});
  ASSERT_EQ(report.termination, Termination::kConverged) << report.reason;
  EXPECT_EQ(report.solver, "ipopt") << report.reason;
  EXPECT_LT(report.work.iterations, 300);
  EXPECT_NEAR(report.solution.loss, Solve("ipopt", problem, {}).solution.loss, 1e-7);
  ASSERT_TRUE(report.certificate);
  EXPECT_TRUE(report.certificate->IsStationary()) << report.certificate->reason;
}

// x' = v, v' = x^3 + u: without control the motion from (2, 0) leaves every bound before the final time. States on the
// straight line to the target are near a motion, which exists.
struct Escaping {
  template <typename T>
  void operator()(const T* x, const T* u, T* xdot) const {
    xdot[0] = x[1];
    xdot[1] = x[0] * x[0] * x[0] + u[0];
  }
};

TEST(OptimalControl, BeginsFromStatesWhereTheControlOfTheGuessHasNoMotion) {
  if (!HasInteriorPoint()) GTEST_SKIP() << "this build has no IPOPT";
  HybridProblem problem = Problem<Escaping, 2, 1>({2, 0}, 3, 0, 60);
  problem.terms = {MakeEffortCost(1, 1), StateRows<2, 2>(Timing::kEnd, Role::kEquality, {0, 1}, {1, 1}, {0, 0})};
  EXPECT_NE(Solve("auto", problem, {.limits = {.iterations = 20}}).termination, Termination::kConverged);
  for (int i = 0; i <= 10; ++i) {
    problem.guess_states.push_back(2 - 0.2 * i);
    problem.guess_states.push_back(-2.0 / 3);
  }
  const SolveReport report = Solve("auto", problem, {});
  ASSERT_EQ(report.termination, Termination::kConverged) << report.reason;
  EXPECT_LE(report.solution.violation, kFeasible);
  EXPECT_NEAR(report.solution.loss, 43.527179629, 1e-5);  // by multiple shooting on the same grid with SLSQP of scipy
  problem.guess_states.pop_back();
  EXPECT_EQ(Solve("auto", problem, {}).termination, Termination::kNotApplicable);
}

}  // namespace
}  // namespace saltus
