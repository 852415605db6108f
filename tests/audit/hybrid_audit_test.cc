// Audits of time-stepping schemes for hybrid systems, whose verdicts are known by construction.
#include "saltus/audit/hybrid_audit.h"

#include <ceres/autodiff_cost_function.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <limits>

#include "problems/hybrid_systems.h"

namespace saltus {
namespace {

using testing::HasSubstr;

constexpr double kFirstImpact = 0.55720308415835660801;  // closed form: (v0 + sqrt(v0^2 + 2 g y0)) / g

HybridProblem BallProblem() {
  HybridProblem problem{
      .system = HybridSystem(BouncingBall()),
      .guess = {.initial = {1.3, 0.4}, .parameters = {9.81, 0.8}, .duration = 2, .num_intervals = 4},
      .terms = {MakeTerminalCost(0, 1.0, 1.0, 2), MakeTerminalCost(1, 0.0, 1.0, 2), MakeEffortCost(0.1, 1)}};
  problem.guess.control = {0.3, -0.2, 0.5, 0.1};
  return problem;
}

// Exact flight, and the impact at its own time within the step.
struct LocatedBall : BouncingBall {
  template <typename T>
  int Step(int, const T&, const T* x, const T* u, const T* p, const T& h, T* next) const {
    using std::sqrt;
    const T a = u[0] - p[0];
    next[0] = x[0] + h * (x[1] + 0.5 * h * a);
    next[1] = x[1] + h * a;
    if (!(next[0] < 0.0)) return 0;
    const T s = (-x[1] - sqrt(x[1] * x[1] - 2.0 * a * x[0])) / a, rest = h - s;
    const T after = -p[1] * (x[1] + s * a);
    next[0] = rest * (after + 0.5 * rest * a);
    next[1] = after + rest * a;
    return 0;
  }
};

// Explicit Euler, with the impact where a straight line meets the guard: of first order, and its derivative too.
struct EulerWheel : RimlessWheel {
  template <typename T>
  int Step(int, const T& t, const T* x, const T* u, const T* p, const T& h, T* next) const {
    T rate[2], after[2];
    Flow(0, t, x, u, p, rate);
    for (int i = 0; i < 2; ++i) next[i] = x[i] + h * rate[i];
    if (!(Guard(0, 0, t, next, p) < 0.0)) return 0;
    const T s = Guard(0, 0, t, x, p) / rate[0];
    for (int i = 0; i < 2; ++i) next[i] = x[i] + s * rate[i];
    Reset(0, 0, t, next, p, after);
    Flow(0, t, after, u, p, rate);
    for (int i = 0; i < 2; ++i) next[i] = after[i] + (h - s) * rate[i];
    return 0;
  }
};

// Whose slope changes at the end of a step; both components are exact within it.
struct UnlocatedLine : SwitchedLine {
  template <typename T>
  int Step(int, const T&, const T* x, const T*, const T*, const T& h, T* next) const {
    const double slope = x[0] < -1e-9 ? 3 : 1;
    next[0] = x[0] + h * slope;
    next[1] = x[1] + h * (x[0] * x[0] + slope * h * (x[0] + slope * h / 3.0));
    return next[0] < -1e-9 ? 0 : 1;
  }
};

HybridAuditOptions Steps(int steps) {
  HybridAuditOptions options;
  options.steps = steps;
  return options;
}

TEST(HybridAudit, ExactStepsAreRight) {
  HybridSchemeOf<LocatedBall> scheme((LocatedBall()));
  const HybridAudit audit = AuditScheme(BallProblem(), &scheme, Steps(40));
  ASSERT_TRUE(audit.ok()) << audit.reason;
  EXPECT_EQ(audit.verdict, Verdict::kRight);
  EXPECT_EQ(audit.VerdictReason(), "");
  EXPECT_NEAR(audit.loss, audit.exact_loss, 1e-12);
  for (int k = 0; k < 4; ++k) EXPECT_NEAR(audit.gradient.control[k], audit.exact.control[k], 1e-11);
  for (int i = 0; i < 2; ++i) {
    EXPECT_NEAR(audit.gradient.initial[i], audit.exact.initial[i], 1e-10);
    EXPECT_NEAR(audit.gradient.parameters[i], audit.exact.parameters[i], 1e-9);
  }
}

TEST(HybridAudit, ImpactsAtTheEndOfAStepAreWrong) {
  HybridSchemeOf<BouncingBall> scheme((BouncingBall()), "semi_implicit");
  HybridAuditOptions options = Steps(40);
  options.width_sweep = true;
  HybridProblem problem = BallProblem();
  problem.guess.control = {};
  const HybridAudit audit = AuditScheme(problem, &scheme, options);
  EXPECT_TRUE(IsWrong(audit.verdict)) << VerdictToString(audit.verdict);
  ASSERT_EQ(audit.first_wrong, 0);
  ASSERT_EQ(audit.segments.size(), 2u);
  EXPECT_NEAR(audit.segments[0].time, kFirstImpact, 1e-12);
  EXPECT_EQ(audit.segments[0].step, 11);  // floor(0.5572 / 0.05)
  EXPECT_EQ(audit.segments[0].guard, "ground");
  EXPECT_TRUE(audit.segments[0].stays);
  EXPECT_LT(audit.order, 0.5);
  EXPECT_THAT(audit.VerdictReason(), HasSubstr("first wrong step is 11"));
  // Differences that are wider than a step give the exact derivative, whatever the scheme's own is.
  ASSERT_TRUE(audit.widths);
  const WidthSweep& by_height = audit.widths->sweeps[0];
  EXPECT_EQ(by_height.entry, "y");
  EXPECT_NEAR(by_height.narrow, by_height.gradient, 1e-2 * std::abs(by_height.gradient));
  EXPECT_NEAR(by_height.wide, audit.exact.initial[0], 0.1 * std::abs(audit.exact.initial[0]));
  EXPECT_EQ(by_height.finding, WidthFinding::kOnlyOfItsSteps);
}

TEST(HybridAudit, AFirstOrderSchemeIsConsistent) {
  HybridProblem problem = RimlessWheelProblem();
  problem.guess.initial = {-0.1, 0.5};
  problem.terms = {MakeTerminalCost(0, 0.0, 1.0, 2), MakeTerminalCost(1, 0.0, 1.0, 2)};
  HybridSchemeOf<EulerWheel> scheme((EulerWheel()));
  const HybridAudit audit = AuditScheme(problem, &scheme, Steps(60));
  ASSERT_TRUE(audit.ok()) << audit.reason;
  EXPECT_EQ(audit.verdict, Verdict::kConsistent);
  EXPECT_NEAR(audit.order, 1, 0.15);
  // The exact gradient, from the reference by 84 digits: q(T), u(T) times their derivatives.
  const double q = -0.23914503614007037852, u = 0.39059699118321483405;
  EXPECT_NEAR(audit.exact.initial[0], 2 * (q * 0.53871791106265228971 + u * -0.050942996534334235189), 1e-9);
  EXPECT_NEAR(audit.exact.parameters[2], 2 * (q * 5.1402610024554010808 + u * 1.2907093452549274645), 1e-8);
}

// Stewart, Anitescu 2010: without the location of the event dx(T)/dx0 is 1 for any step, in the place of 1/3, even
// where the event is at the end of a step, so that the loss is exact.
TEST(HybridAudit, StepsThatDoNotLocateTheEventAreWrong) {
  HybridSchemeOf<UnlocatedLine> scheme((UnlocatedLine()));
  for (const int steps : {60, 600}) {
    const HybridAudit audit = AuditScheme(SwitchedLineProblem(), &scheme, Steps(steps));
    ASSERT_TRUE(audit.ok()) << audit.reason;
    EXPECT_EQ(audit.verdict, Verdict::kWrong);
    EXPECT_NEAR(audit.loss, 134.0 / 81, 1e-12);
    EXPECT_NEAR(audit.gradient.initial[0], 22.0 / 9, 1e-12);
    EXPECT_NEAR(audit.exact.initial[0], 16.0 / 27, 1e-12);
  }
}

// Guards that depend on time are compared at their own time.
struct LateBall : JuggledBall {
  template <typename T>
  int Step(int, const T& t, const T* x, const T* u, const T* p, const T& h, T* next) const {
    next[1] = x[1] - h * p[2];
    next[0] = x[0] + h * next[1];
    if (Guard(0, 0, t + h, next, p) < 0.0) {
      T after[2];
      Reset(0, 0, t + h, next, p, after);
      if (next[1] < after[1]) std::copy_n(after, 2, next);
    }
    (void)u;
    return 0;
  }
};

TEST(HybridAudit, TimeDependentGuards) {
  HybridProblem problem = JuggledBallProblem();
  problem.guess.parameters = {0.025, 4 * M_PI, 9.81, 0.8};
  problem.guess.duration = 0.7;  // one impact, at 0.396
  HybridSchemeOf<LateBall> scheme((LateBall()));
  const HybridAudit audit = AuditScheme(problem, &scheme, Steps(70));
  EXPECT_TRUE(IsWrong(audit.verdict));
  ASSERT_EQ(audit.segments.size(), 1u);
  EXPECT_NEAR(audit.segments[0].time, 0.39632067914601644525, 1e-12);
  EXPECT_EQ(audit.first_wrong, 0);
}

// The loss is the same whether a cost is a value or a square, and whether it reads the state at the start too.
struct Travelled {
  template <typename T>
  bool operator()(const T* end, const T* start, T* residual) const {
    residual[0] = end[0] - start[0];
    return true;
  }
};

HybridProblem BallThatTravels() {
  HybridProblem problem = BallProblem();
  HybridTerm value = MakeTerminalCost(1, -5, 1, 2);
  value.role = HybridTerm::Role::kValue;
  HybridTerm travelled{.name = "travelled", .with_state = true, .with_initial = true};
  travelled.function = std::make_shared<ceres::AutoDiffCostFunction<Travelled, 1, 2, 2>>(new Travelled);
  problem.terms = {value, travelled};
  return problem;
}

TEST(HybridAudit, CostsThatAreValuesOrReadTheStateAtTheStart) {
  HybridSchemeOf<LocatedBall> exact((LocatedBall()));
  const HybridAudit right = AuditScheme(BallThatTravels(), &exact, Steps(40));
  EXPECT_EQ(right.verdict, Verdict::kRight) << right.VerdictReason();
  EXPECT_NEAR(right.loss, right.exact_loss, 1e-12);
  HybridSchemeOf<BouncingBall> late((BouncingBall()));
  const HybridAudit wrong = AuditScheme(BallThatTravels(), &late, Steps(40));
  EXPECT_TRUE(IsWrong(wrong.verdict));
  EXPECT_EQ(wrong.first_wrong, 0);
}

// Exact steps, with Jacobians that are not theirs.
class WrongJacobians final : public HybridScheme {
 public:
  std::string name() const override { return "wrong Jacobians"; }
  int Step(const SchemeStep& step, double* next, double* jacobian, std::string* error) override {
    const int mode = steps_.Step(step, next, jacobian, error);
    if (jacobian != nullptr) jacobian[1] *= 0.9;  // of the height by the velocity
    return mode;
  }

 private:
  HybridSchemeOf<LocatedBall> steps_{LocatedBall()};
};

TEST(HybridAudit, AGradientThatContradictsItsOwnStepsIsSaidToDoSo) {
  WrongJacobians scheme;
  const HybridAudit audit = AuditScheme(BallProblem(), &scheme, Steps(40));
  ASSERT_TRUE(audit.gradient_check);
  EXPECT_EQ(audit.gradient_check->agreement, Agreement::kDiffers);
  EXPECT_THAT(audit.VerdictReason(), HasSubstr("contradicts its own steps"));
  HybridSchemeOf<BouncingBall> late((BouncingBall()));  // is wrong, but the derivative of its steps
  EXPECT_EQ(AuditScheme(BallProblem(), &late, Steps(40)).gradient_check->agreement, Agreement::kAgrees);
}

// The logistic map, once a second: each event doubles a perturbation on average. Steps locate the events, and are
// exact.
struct LogisticMap {
  static constexpr int kNumControls = 0, kNumParameters = 0;
  static constexpr std::array kStateSizes = {2};  // the time since the last event, and y
  static constexpr std::array kNumGuards = {1};
  template <typename T>
  void Flow(int, const T&, const T* x, const T*, const T*, T* xdot) const {
    xdot[0] = T(1.0);
    xdot[1] = 0.03 * (0.5 - x[1]);
  }
  template <typename T>
  T Guard(int, int, const T&, const T* x, const T*) const {
    return 1.0 - x[0];
  }
  template <typename T>
  int Reset(int, int, const T&, const T* x, const T*, T* x_plus) const {
    x_plus[0] = T(0.0);
    x_plus[1] = 4.0 * x[1] * (1.0 - x[1]);
    return 0;
  }
  template <typename T>
  int Step(int, const T&, const T* x, const T*, const T*, const T& h, T* next) const {
    using std::exp;
    const auto fly = [&](const T& by) {
      next[0] += by;
      next[1] = 0.5 + (next[1] - 0.5) * exp(-0.03 * by);
    };
    std::copy_n(x, 2, next);
    if (!(x[0] + h > 1.0)) return fly(h), 0;
    const T rest = x[0] + h - 1.0;
    fly(1.0 - x[0]);
    Reset(0, 0, h, std::array<T, 2>{next[0], next[1]}.data(), x, next);
    fly(rest);
    return 0;
  }
};

TEST(HybridAudit, ErrorsThatAreRoundingOfTheExactGradientAreIllConditioned) {
  HybridProblem problem{.system = HybridSystem(LogisticMap()),
                        .guess = {.initial = {0.3, 0.2}, .duration = 6.5},
                        .terms = {MakeTerminalCost(1, 0.0, 1.0, 2)}};
  HybridSchemeOf<LogisticMap> scheme((LogisticMap()));
  EXPECT_EQ(AuditScheme(problem, &scheme, Steps(37)).verdict, Verdict::kRight);
  problem.guess.duration = 64.5;
  const HybridAudit audit = AuditScheme(problem, &scheme, Steps(237));
  EXPECT_EQ(audit.verdict, Verdict::kIllConditioned) << audit.reason;
  ASSERT_TRUE(audit.refinement && audit.refinement->conditioning);
  EXPECT_GT(audit.refinement->conditioning->condition, 1e9);
  EXPECT_THAT(audit.VerdictReason(), HasSubstr("of 16 digits are lost"));
}

class BrokenScheme final : public HybridScheme {
 public:
  enum class How { kMode, kNan, kReason };
  explicit BrokenScheme(How how) : how_(how) {}
  std::string name() const override { return "broken"; }
  int Step(const SchemeStep& step, double* next, double* jacobian, std::string* error) override {
    next[0] = how_ == How::kNan ? std::numeric_limits<double>::quiet_NaN() : step.x[0];
    next[1] = step.x[1];
    if (jacobian != nullptr) std::fill_n(jacobian, 2 * 5, 0.0);
    if (how_ == How::kReason) *error = "out of order";
    return how_ == How::kMode ? 7 : 0;
  }

 private:
  const How how_;
};

TEST(HybridAudit, WhatCannotBeAuditedHasAReason) {
  const auto reason_of = [](const HybridProblem& problem, BrokenScheme::How how = BrokenScheme::How::kReason) {
    BrokenScheme scheme(how);
    const HybridAudit audit = AuditScheme(problem, &scheme);
    EXPECT_EQ(audit.verdict, Verdict::kUnknown);
    return audit.reason;
  };
  HybridProblem problem = BallProblem();
  EXPECT_THAT(reason_of(problem), HasSubstr("out of order in step 0 of 100, in mode 'flight' at t = 0"));
  EXPECT_THAT(reason_of(problem, BrokenScheme::How::kMode), HasSubstr("found mode 7"));
  EXPECT_THAT(reason_of(problem, BrokenScheme::How::kNan), HasSubstr("not finite in step 0"));
  problem.terms.push_back({.name = "of events",
                           .at = HybridTerm::Timing::kEvent,
                           .mode = 0,
                           .event = "ground",
                           .with_state = true,
                           .function = problem.terms[0].function});
  EXPECT_THAT(reason_of(problem), HasSubstr("of events is a cost at events"));
  problem.terms = {};
  EXPECT_THAT(reason_of(problem), HasSubstr("no cost"));
  problem = BallProblem();
  problem.guess.initial = {-1, 0};
  EXPECT_THAT(reason_of(problem), HasSubstr("there is no exact motion: "));
  problem.guess.duration = -1;
  EXPECT_THAT(reason_of(problem), HasSubstr("duration"));
}

// A ball in a corner meets two guards at once; the outcome depends on their order.
struct Corner {
  static constexpr int kNumControls = 0, kNumParameters = 0;
  static constexpr std::array kStateSizes = {2};
  static constexpr std::array kNumGuards = {2};
  template <typename T>
  void Flow(int, const T&, const T*, const T*, const T*, T* xdot) const {
    xdot[0] = xdot[1] = T(-1.0);
  }
  template <typename T>
  T Guard(int, int guard, const T&, const T* x, const T*) const {
    return x[guard];
  }
  template <typename T>
  int Reset(int, int guard, const T&, const T* x, const T*, T* x_plus) const {
    x_plus[0] = x[0] + (guard == 0 ? 1.0 : 2.0) + 3.0 * guard * x[0];
    x_plus[1] = x[1] + (guard == 0 ? T(2.0 * x[0] + 1.0) : T(1.0));
    return 0;
  }
  template <typename T>
  int Step(int, const T&, const T* x, const T*, const T*, const T& h, T* next) const {
    next[0] = x[0] - h;
    next[1] = x[1] - h;
    return 0;
  }
};

TEST(HybridAudit, WithoutAnExactDerivativeThereIsNoVerdictOnTheScheme) {
  HybridProblem problem{.system = HybridSystem(Corner()),
                        .guess = {.initial = {0.5, 0.5}, .duration = 0.8},
                        .terms = {MakeTerminalCost(0, 0.0, 1.0, 2)}};
  HybridSchemeOf<Corner> scheme((Corner()));
  const HybridAudit audit = AuditScheme(problem, &scheme);
  EXPECT_FALSE(audit.ok());
  EXPECT_TRUE(audit.verdict == Verdict::kAmbiguous || audit.verdict == Verdict::kOneSided);
}

}  // namespace
}  // namespace saltus
