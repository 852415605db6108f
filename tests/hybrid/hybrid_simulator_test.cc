// Which zeros of guards are events, and what is reported where a motion or its derivative does not exist.
#include "saltus/hybrid/hybrid_simulator.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <limits>
#include <vector>

#include "hybrid/runge_kutta.h"
#include "problems/hybrid_systems.h"

namespace saltus {
namespace {

using testing::HasSubstr;
using testing::IsEmpty;

HybridSimulator Ball(HybridOptions options = {}) { return HybridSimulator(HybridSystem(BouncingBall()), options); }

void ExpectNumbers(std::span<const double> found, const std::vector<double>& expected, double tolerance) {
  ASSERT_EQ(found.size(), expected.size());
  for (size_t i = 0; i < found.size(); ++i) EXPECT_NEAR(found[i], expected[i], tolerance) << "number " << i;
}

TEST(RungeKutta, HasOrderEight) {
  const HybridSystem system{RimlessWheel()};
  RungeKutta integrator(system.functions());
  const std::vector<double> p = {2.0 / 3, 2.0 / 3, 0.2};
  const auto after = [&](int steps) {
    std::vector<double> x = {-0.1, 0.5}, next(2);
    for (int i = 0; i < steps; ++i) {
      integrator.Step({{0, 0, x.data(), nullptr, p.data()}, 2.0 / steps}, next.data());
      x = next;
    }
    return x[0];
  };
  const double exact = after(64), coarse = after(2) - exact, fine = after(4) - exact;
  EXPECT_GT(std::abs(fine), 1e-13) << "rounding hides the order";
  EXPECT_NEAR(std::log2(std::abs(coarse / fine)), 8, 0.7);
}

// A ball under a ceiling at 1, which takes half of its speed; p = [].
struct Ceiling {
  static constexpr int kNumControls = 0;
  static constexpr int kNumParameters = 0;
  static constexpr std::array kStateSizes = {2};
  static constexpr std::array kNumGuards = {1};

  template <typename T>
  void Flow(int, const T&, const T* x, const T*, const T*, T* xdot) const {
    xdot[0] = x[1];
    xdot[1] = T(-8.0);
  }
  template <typename T>
  T Guard(int, int, const T&, const T* x, const T*) const {
    return 1.0 - x[0];
  }
  template <typename T>
  int Reset(int, int, const T&, const T* x, const T*, T* x_plus) const {
    x_plus[0] = x[0];
    x_plus[1] = -0.5 * x[1];
    return 0;
  }
};

TEST(HybridSimulator, GrazingIsReportedAndPassed) {
  // Whether the time of the grazing is a time of the grid or inside a step.
  for (int steps : {1, 3, 8, 16, 0}) {
    HybridSimulator simulator(HybridSystem(Ceiling()), {.steps_per_interval = steps});
    ASSERT_TRUE(simulator.Rollout({.initial = {0, 4}, .duration = 0.8}));
    EXPECT_THAT(simulator.events(), IsEmpty()) << steps;
    ASSERT_EQ(simulator.grazings().size(), 1u) << steps;
    EXPECT_NEAR(simulator.grazings()[0].time, 0.5, 1e-7);
    EXPECT_THAT(simulator.ReasonNotDifferentiable(), HasSubstr("grazes zero at t = 0.5"));
    ExpectNumbers(simulator.final_state(), {4 * 0.8 - 4 * 0.64, 4 - 8 * 0.8}, 1e-14);
  }
}

TEST(HybridSimulator, NearGrazing) {
  struct Case {
    double v0, y, v, by_y, by_v, impact;
  };
  for (const Case& c : std::vector<Case>{{3.9, 0.56, -2.5, 0.8, 1, 0},
                                         {3.99, 0.632, -2.41, 0.8, 1, 0},
                                         {4.0001,
                                          0.627202526847778294,
                                          -2.44232667203540716,
                                          -64.3328860091157161,
                                          -211.136011810892594,
                                          0.496476943997049403},
                                         {4.01,
                                          0.506153166155914033,
                                          -2.81452915094254717,
                                          -7.00000490750277748,
                                          -20.2529574941275176,
                                          0.465872570754787736},
                                         {4.1, 0.18, -3.65, -2.53333333333333333, -5.83333333333333333, 0.4}}) {
    for (int steps : {1, 8, 0}) {
      HybridSimulator simulator(HybridSystem(Ceiling()), {.steps_per_interval = steps});
      ASSERT_TRUE(simulator.Rollout({.initial = {0, c.v0}, .duration = 0.8}));
      ASSERT_EQ(simulator.events().size(), c.impact > 0 ? 1u : 0u) << c.v0 << " " << steps;
      if (c.impact > 0) {
        EXPECT_NEAR(simulator.events()[0].time, c.impact, 1e-12);
      }
      // An impact that nearly grazes amplifies rounding errors by the inverse of its speed.
      const double tolerance = c.v0 == 4.0001 ? 1e-9 : 1e-12;
      ExpectNumbers(simulator.final_state(), {c.y, c.v}, tolerance);
      EXPECT_NEAR(simulator.Adjoint(std::vector<double>{1, 0}).initial[1], c.by_y, tolerance * std::abs(c.by_y));
      EXPECT_NEAR(simulator.Adjoint(std::vector<double>{0, 1}).initial[1], c.by_v, tolerance * std::abs(c.by_v));
      EXPECT_EQ(simulator.ReasonNotDifferentiable(), "");
    }
  }
}

TEST(HybridSimulator, AccumulatingEventsAreReported) {
  HybridSimulator simulator = Ball();
  EXPECT_FALSE(simulator.Rollout({.initial = {1, 0}, .parameters = {9.8, 0.5}, .duration = 2}));
  ASSERT_TRUE(simulator.accumulation());
  EXPECT_NEAR(*simulator.accumulation(), 1.3552618543578768566, 1e-14);
  EXPECT_THAT(simulator.FailureReason(), HasSubstr("accumulate (Zeno behaviour) at about t = 1.3552618543578"));
  EXPECT_THAT(simulator.FailureReason(), HasSubstr("guard 'ground' in mode 'flight'"));
  ASSERT_GE(simulator.events().size(), 20u);
  EXPECT_NEAR(simulator.events()[0].time, 0.45175395145262562, 1e-14);
  EXPECT_NEAR(simulator.events()[1].time, 0.90350790290525124, 1e-14);
  EXPECT_NEAR(simulator.events()[2].time, 1.129384878631564, 1e-14);
  EXPECT_NEAR(simulator.events()[9].time, 1.353497190485015, 1e-14);
  EXPECT_NEAR(simulator.events()[19].time, 1.3552601310533135, 1e-14);
  EXPECT_NEAR(simulator.events()[9].before[1], -0.008646853, 1e-9);
  EXPECT_NEAR(simulator.events()[19].before[1], -0.0000084441924, 1e-13);
  // By y0, g and e.
  const double by[] = {0.67763092717893843, -0.069146012977442697, 3.614031611621005}, width = 1e-5;
  for (int i = 0; i < 3; ++i) {
    const auto at = [&](double change) {
      HybridInput input{.initial = {1, 0}, .parameters = {9.8, 0.5}, .duration = 2};
      (i == 0 ? input.initial[0] : input.parameters[i - 1]) += change;
      EXPECT_FALSE(simulator.Rollout(input));
      return simulator.accumulation().value_or(0);
    };
    EXPECT_NEAR((at(width) - at(-width)) / (2 * width), by[i], 1e-8);
  }
}

// A clock x = t whose guard has a zero of the order of its power at t = 0.5, behind which y grows.
struct FlatCrossing {
  static constexpr int kNumControls = 0, kNumParameters = 0;
  static constexpr std::array kStateSizes = {2, 2};
  static constexpr std::array kNumGuards = {1, 0};
  int power = 3;

  template <typename T>
  void Flow(int mode, const T&, const T*, const T*, const T*, T* xdot) const {
    xdot[0] = T(1.0);
    xdot[1] = T(mode == 0 ? 0.0 : 1.0);
  }
  template <typename T>
  T Guard(int, int, const T&, const T* x, const T*) const {
    T value(1.0);
    for (int i = 0; i < power; ++i) value *= T(0.5) - x[0];
    return value * (T(1.0) + x[0] * x[0]);
  }
  template <typename T>
  int Reset(int, int, const T&, const T* x, const T*, T* x_plus) const {
    x_plus[0] = x[0];
    x_plus[1] = x[1];
    return 1;
  }
};

// A guard that is flat where it falls through zero has an event there, also on a node of the steps; one that returns
// has none.
TEST(HybridSimulator, AGuardThatFallsThroughAFlatZeroHasAnEvent) {
  for (const int power : {2, 3, 4, 5}) {
    for (const int steps : {0, 1, 7, 8, 10, 100}) {
      SCOPED_TRACE(testing::Message() << "power " << power << ", " << steps << " steps");
      HybridSimulator simulator(HybridSystem(FlatCrossing{power}), {.steps_per_interval = steps});
      ASSERT_TRUE(simulator.Rollout({.initial = {0, 0}, .duration = 1})) << simulator.FailureReason();
      const bool crosses = power % 2 == 1;
      ASSERT_EQ(simulator.events().size(), crosses ? 1u : 0u);
      EXPECT_NEAR(simulator.final_state()[1], crosses ? 0.5 : 0.0, 1e-9);
      const std::string remark = simulator.ReasonNotDifferentiable();
      EXPECT_EQ(remark.find("returns") != std::string::npos, !crosses) << remark;
    }
  }
}

// A ball that moves to the right as it bounces, and on the ground with a quarter of that speed.
struct BallThatComesToRest {
  static constexpr int kNumControls = 0;
  static constexpr int kNumParameters = 2;  // gravity, restitution
  static constexpr std::array kStateSizes = {3, 3, 2};
  static constexpr std::array kNumGuards = {1, 0, 0};
  int mode_at_rest = 1;

  template <typename T>
  void Flow(int mode, const T&, const T* x, const T*, const T* p, T* xdot) const {
    xdot[0] = mode == 0 ? x[1] : T(0.0);
    xdot[1] = mode == 0 ? T(-p[0]) : T(0.0);
    if (mode < 2) xdot[2] = T(mode == 0 ? 1.0 : 0.25);
  }
  template <typename T>
  T Guard(int, int, const T&, const T* x, const T*) const {
    return x[0];
  }
  template <typename T>
  int Reset(int, int, const T&, const T* x, const T* p, T* x_plus) const {
    x_plus[0] = x[0];
    x_plus[1] = -p[1] * x[1];
    x_plus[2] = x[2];
    return 0;
  }
  int OnAccumulation(int /*mode*/, int /*guard*/) const { return mode_at_rest; }
};

TEST(HybridSimulator, AMotionGoesOnWhereEventsAccumulateIfTheSystemSaysHow) {
  const HybridInput input{.initial = {1, 0, 0}, .parameters = {9.8, 0.5}, .duration = 2};
  HybridSimulator simulator{HybridSystem(BallThatComesToRest())};
  ASSERT_TRUE(simulator.Rollout(input)) << simulator.FailureReason();
  constexpr double kAccumulated = 1.3552618543578768566;
  ASSERT_TRUE(simulator.accumulation());
  EXPECT_NEAR(*simulator.accumulation(), kAccumulated, 1e-14);
  EXPECT_EQ(simulator.final_mode(), 1);
  EXPECT_EQ(simulator.events().back().next_mode, 1);
  ExpectNumbers(simulator.final_state(), {0, 0, kAccumulated + 0.25 * (2 - kAccumulated)}, 1e-13);
  // The time of accumulation, by the initial height, gravity and restitution.
  const HybridGradient by = simulator.Adjoint(std::vector<double>{0, 0, 1});
  EXPECT_NEAR(by.initial[0], 0.75 * 0.67763092717893843, 1e-8);
  ExpectNumbers(by.parameters, {0.75 * -0.069146012977442697, 0.75 * 3.614031611621005}, 1e-7);

  // Long after bounces that fade slowly, without a trace of the speed at the last of them.
  for (const double restitution : {0.8, 0.95, 0.99}) {
    const double falls = std::sqrt(2 / 9.8), rest = falls * (1 + 2 * restitution / (1 - restitution));
    ASSERT_TRUE(simulator.Rollout({.initial = {1, 0, 0}, .parameters = {9.8, restitution}, .duration = 400}));
    ExpectNumbers(simulator.final_state(), {0, 0, rest + 0.25 * (400 - rest)}, 1e-10);
  }

  HybridSimulator other{HybridSystem(BallThatComesToRest{.mode_at_rest = 2})};
  EXPECT_FALSE(other.Rollout(input));
  EXPECT_THAT(other.FailureReason(), HasSubstr("names mode 2, expected one with states of the same size"));
}

// A mass between a spring and its free flight, with drag and a force that depends on time: [y v]; p = [spring, drag,
// frequency]. With a closed form of the flight, if it says so; its motion on the spring has none.
template <bool kClosed>
struct SprungMass {
  static constexpr int kNumControls = 1, kNumParameters = 3;
  static constexpr std::array kStateSizes = {2, 2};
  static constexpr std::array kNumGuards = {1, 1};
  double error = 0;  // of the closed form

  template <typename T>
  void Flow(int mode, const T& t, const T* x, const T* u, const T* p, T* xdot) const {
    using std::cos;
    xdot[0] = x[1];
    xdot[1] = mode == 0 ? T(u[0] + cos(p[2] * t) - p[1] * x[1]) : T(u[0] - p[0] * x[0] - 0.1 * x[0] * x[0] * x[0]);
  }
  // v' = u + cos(w t) - c v: the particular solution (u / c) + (c cos(w t) + w sin(w t)) / (c^2 + w^2), and a decay.
  template <typename T>
  bool Fly(int mode, const T& t, const T& s, const T* x, const T* u, const T* p, T* after) const requires kClosed {
    using std::cos, std::exp, std::sin;
    if (mode != 0) return false;
    const T &c = p[1], &w = p[2], size = c * c + w * w, then = t + s;
    const auto driven = [&](const T& at) { return T(u[0] / c + (c * cos(w * at) + w * sin(w * at)) / size); };
    const auto path = [&](const T& at) { return T(u[0] / c * at + (c * sin(w * at) / w - cos(w * at)) / size); };
    const T decays = x[1] - driven(t);
    after[0] = x[0] + path(then) - path(t) + decays * (1.0 - exp(-c * s)) / c;
    after[1] = driven(then) + decays * exp(-c * s) + error;
    return true;
  }
  template <typename T>
  T Guard(int mode, int, const T&, const T* x, const T*) const {
    return mode == 0 ? x[0] : T(-x[0]);
  }
  template <typename T>
  int Reset(int mode, int, const T&, const T* x, const T*, T* x_plus) const {
    std::copy_n(x, 2, x_plus);
    return 1 - mode;
  }
};

TEST(HybridSimulator, AClosedFormOfTheFlowTakesThePlaceOfTheIntegration) {
  HybridInput input{.initial = {0.4, 0.3},
                    .parameters = {9, 0.2, 1.7},
                    .duration = 5,
                    .num_intervals = 4,
                    .control = {-0.8, -1.1, -0.9, -1.3}};
  input.begin = 0.3;
  HybridSimulator closed{HybridSystem(SprungMass<true>())}, integrated{HybridSystem(SprungMass<false>())};
  ASSERT_TRUE(closed.Rollout(input)) << closed.FailureReason();
  ASSERT_TRUE(integrated.Rollout(input));
  ASSERT_EQ(closed.events().size(), 2u);
  ASSERT_EQ(closed.events().size(), integrated.events().size());
  for (std::size_t i = 0; i < closed.events().size(); ++i) {
    EXPECT_NEAR(closed.events()[i].time, integrated.events()[i].time, 1e-12);
  }
  for (int i = 0; i < 2; ++i) EXPECT_NEAR(closed.final_state()[i], integrated.final_state()[i], 1e-12);
  const HybridSensitivity a = closed.Sensitivity(), b = integrated.Sensitivity();
  for (std::size_t i = 0; i < b.final_state.size(); ++i) EXPECT_NEAR(a.final_state[i], b.final_state[i], 1e-9);
  const HybridGradient c = closed.Adjoint(std::vector<double>{0.3, -0.7});
  for (int i = 0; i < 2; ++i)
    EXPECT_NEAR(c.initial[i], 0.3 * a.final_state[i] - 0.7 * a.final_state[a.columns + i], 1e-12);
  for (int j = 0; j < 4; ++j) {
    EXPECT_NEAR(c.control[j], 0.3 * a.final_state[2 + j] - 0.7 * a.final_state[a.columns + 2 + j], 1e-12);
  }
  EXPECT_NEAR(c.duration, 0.3 * a.final_state[9] - 0.7 * a.final_state[a.columns + 9], 1e-12);

  // A flight is exact whatever the length of its steps.
  HybridSimulator coarse(HybridSystem(SprungMass<true>()), {.steps_per_interval = 1});
  input.initial = {20, 0.3};
  ASSERT_TRUE(coarse.Rollout(input));
  EXPECT_LT(coarse.IntegrationError(), 1e-14);
}

TEST(HybridSimulator, AClosedFormOfAnotherFlowIsRefused) {
  HybridSimulator simulator(HybridSystem(SprungMass<true>{.error = 1e-3}));
  EXPECT_FALSE(simulator.Rollout({.initial = {2, 0.3}, .parameters = {9, 0.2, 1.7}, .duration = 1}));
  EXPECT_THAT(simulator.FailureReason(), HasSubstr("Fly is no closed form of the flow of mode 'mode 0'"));
}

TEST(HybridSimulator, ManyEventsBeforeTheyAccumulateAreRegular) {
  HybridSimulator simulator = Ball();
  ASSERT_TRUE(simulator.Rollout({.initial = {1, 0}, .parameters = {9.8, 0.5}, .duration = 1.355261854}));
  EXPECT_EQ(simulator.events().size(), 32u);
  EXPECT_FALSE(simulator.accumulation());
  constexpr double kFirst = 0.45175395145262562;
  double before_end = 2 * kFirst;  // from impact k to their accumulation, 2^(2 - k) times the time of the first
  for (const HybridEvent& impact : simulator.events()) {
    EXPECT_NEAR(impact.time, 3 * kFirst - before_end, 1e-14);
    EXPECT_NEAR(impact.before[1], -9.8 * before_end / 2, 1e-14);
    before_end /= 2;
  }
  // A guard that rises by less than 1e-9 of its rate within a step counts as one that does not rise.
  EXPECT_FALSE(simulator.Rollout({.initial = {1, 0}, .parameters = {9.8, 0.5}, .duration = 1.3552618543566}));
  EXPECT_THAT(simulator.FailureReason(), HasSubstr("events without time passing (Zeno behaviour)"));
}

// A point in a corner or a wedge of two walls, without friction: [x y vx vy]. p = [].
struct Walls {
  std::array<double, 2> first = {1, 0}, second = {0, 1};  // normals

  static constexpr int kNumControls = 0;
  static constexpr int kNumParameters = 0;
  static constexpr std::array kStateSizes = {4};
  static constexpr std::array kNumGuards = {2};

  template <typename T>
  void Flow(int, const T&, const T* x, const T*, const T*, T* xdot) const {
    xdot[0] = x[2];
    xdot[1] = x[3];
    xdot[2] = xdot[3] = T(0.0);
  }
  template <typename T>
  T Guard(int, int guard, const T&, const T* x, const T*) const {
    const std::array<double, 2>& n = guard == 0 ? first : second;
    return n[0] * x[0] + n[1] * x[1];
  }
  template <typename T>
  int Reset(int, int guard, const T&, const T* x, const T*, T* x_plus) const {
    const std::array<double, 2>& n = guard == 0 ? first : second;
    const T speed = n[0] * x[2] + n[1] * x[3];
    for (int i = 0; i < 2; ++i) {
      x_plus[i] = x[i];
      x_plus[2 + i] = x[2 + i] - 1.8 * speed * n[i];
    }
    return 0;
  }
};

TEST(HybridSimulator, ImpactsAtOnceThatDoNotDependOnTheirOrder) {
  HybridSimulator simulator{HybridSystem(Walls())};
  ASSERT_TRUE(simulator.Rollout({.initial = {1, 1, -1, -1}, .duration = 2}));
  ASSERT_EQ(simulator.events().size(), 2u);
  EXPECT_TRUE(simulator.events()[1].immediate);
  ASSERT_EQ(simulator.ties().size(), 1u);
  EXPECT_FALSE(simulator.ties()[0].ambiguous);
  EXPECT_EQ(simulator.ReasonNotDifferentiable(), "");
  ExpectNumbers(simulator.final_state(), {0.8, 0.8, 0.8, 0.8}, 1e-14);
  ExpectNumbers(simulator.Adjoint(std::vector<double>{1, 0, 0, 0}).initial, {-0.8, 0, -1.6, 0}, 1e-13);
  ExpectNumbers(simulator.Adjoint(std::vector<double>{0, 0, 1, 0}).initial, {0, 0, -0.8, 0}, 1e-13);
}

TEST(HybridSimulator, ImpactsAtOnceWhoseOrderMatters) {
  HybridSimulator simulator{HybridSystem(Walls{.first = {0, 1}, .second = {std::sqrt(0.75), -0.5}})};
  const double c = std::cos(M_PI / 6), s = std::sin(M_PI / 6);
  ASSERT_TRUE(simulator.Rollout({.initial = {c, s, -c, -s}, .duration = 1.5}));
  ASSERT_EQ(simulator.ties().size(), 1u);
  const HybridTie& tie = simulator.ties()[0];
  EXPECT_NEAR(tie.time, 1, 1e-14);
  EXPECT_EQ(tie.guards, (std::vector{0, 1}));
  EXPECT_TRUE(tie.ambiguous);
  EXPECT_NEAR(tie.spread, 0.364 - 0.3505, 1e-13) << "between n1, n2, n1 and n2, n1, n2";
  EXPECT_THAT(simulator.ReasonNotDifferentiable(), HasSubstr("2 guards reach zero at t = 1, and the order"));
  ASSERT_EQ(simulator.events().size(), 3u);
  EXPECT_NEAR(simulator.events()[1].after[2], 0.614878036686951439, 1e-14);
  EXPECT_NEAR(simulator.events()[1].after[3], -0.455, 1e-14);
  EXPECT_NEAR(simulator.events()[2].after[3], 0.364, 1e-14);
  // The order n2, n1, n2.
  HybridSimulator other{HybridSystem(Walls{.first = {std::sqrt(0.75), -0.5}, .second = {0, 1}})};
  ASSERT_TRUE(other.Rollout({.initial = {c, s, -c, -s}, .duration = 1.5}));
  ASSERT_EQ(other.events().size(), 3u);
  EXPECT_NEAR(other.events()[1].after[2], -0.0866025403784438647, 1e-14);
  EXPECT_NEAR(other.events()[1].after[3], 0.76, 1e-14);
  EXPECT_NEAR(other.events()[2].after[2], 0.622672265321011387, 1e-14);
  EXPECT_NEAR(other.events()[2].after[3], 0.3505, 1e-14);
}

// Whose reset leads behind the guard of the next mode, by 1 - 0.5 x1 + margin.
struct Behind {
  double margin = 0;

  static constexpr int kNumControls = 0;
  static constexpr int kNumParameters = 0;
  static constexpr std::array kStateSizes = {2, 2, 2};
  static constexpr std::array kNumGuards = {1, 1, 0};

  template <typename T>
  void Flow(int mode, const T&, const T* x, const T*, const T*, T* xdot) const {
    xdot[0] = mode == 2 ? x[1] : T(1.0 + 0.3 * x[1]);
    xdot[1] = mode == 2 ? T(-x[0]) : T(-1.0);
  }
  template <typename T>
  T Guard(int, int, const T&, const T* x, const T*) const {
    return x[1];
  }
  template <typename T>
  int Reset(int mode, int, const T&, const T* x, const T*, T* x_plus) const {
    if (mode == 0) {
      x_plus[0] = x[0];
      x_plus[1] = 0.5 * x[0] - 1.0 + margin;
      return 1;
    }
    x_plus[0] = x[0] + 0.1;
    x_plus[1] = -2.0 * x[1];
    return 2;
  }
};

TEST(HybridSimulator, ResetBehindAGuardIsOneResetWithTheFirstGuard) {
  HybridSimulator simulator{HybridSystem(Behind())};
  ASSERT_TRUE(simulator.Rollout({.initial = {0, 1}, .duration = 2}));
  ASSERT_EQ(simulator.events().size(), 2u);
  EXPECT_TRUE(simulator.events()[1].immediate);
  EXPECT_NEAR(simulator.events()[1].time, 1, 1e-14);
  ExpectNumbers(simulator.events()[0].after, {1.15, -0.425}, 1e-14);
  ExpectNumbers(simulator.events()[1].after, {1.25, 0.85}, 1e-14);
  ExpectNumbers(simulator.final_state(), {1.39062821942188668, -0.592581771021951874}, 1e-12);
  ExpectNumbers(
      simulator.Adjoint(std::vector<double>{1, 0}).initial, {-0.301168678939756789, 0.201062488400268047}, 1e-12);
  ExpectNumbers(
      simulator.Adjoint(std::vector<double>{0, 1}).initial, {-1.38177329067603622, -0.405677058456960414}, 1e-12);
  EXPECT_EQ(simulator.ReasonNotDifferentiable(), "");
}

TEST(HybridSimulator, ResetOntoAGuardIsReported) {
  HybridSimulator simulator{HybridSystem(Behind{.margin = 0.425})};
  ASSERT_TRUE(simulator.Rollout({.initial = {0, 1}, .duration = 2}));
  EXPECT_EQ(simulator.events().size(), 2u);
  EXPECT_THAT(simulator.ReasonNotDifferentiable(), HasSubstr("leads onto guard 'guard 0'"));
}

// An interval that is shorter than rounding errors of the time has steps, too.
TEST(HybridSimulator, AnIntervalMayBeShorterThanRounding) {
  HybridSimulator with{HybridSystem(BouncingBall())}, without{HybridSystem(BouncingBall())};
  HybridInput input{.initial = {4, 0}, .parameters = {9.8, 0.7}, .duration = 1, .num_intervals = 2};
  input.lengths = {0.4, 0.6};
  ASSERT_TRUE(without.Rollout(input)) << without.FailureReason();
  input.num_intervals = 4;
  input.lengths = {0.4, 1e-18, 0.6, 1e-18};
  ASSERT_TRUE(with.Rollout(input)) << with.FailureReason();
  for (int i = 0; i < 2; ++i) {
    EXPECT_NEAR(with.StateAt(1)[i], without.StateAt(1)[i], 1e-12);
    EXPECT_NEAR(with.StateAt(2)[i], without.StateAt(1)[i], 1e-12);
    EXPECT_NEAR(with.StateAt(3)[i], without.final_state()[i], 1e-12);
    EXPECT_NEAR(with.final_state()[i], without.final_state()[i], 1e-12);
  }
}

TEST(HybridSimulator, EventAtTheFinalTimeCounts) {
  HybridSimulator simulator = Ball();
  ASSERT_TRUE(simulator.Rollout({.initial = {1, 0}, .parameters = {8, 0.5}, .duration = 0.5}));
  ASSERT_EQ(simulator.events().size(), 1u);
  ExpectNumbers(simulator.final_state(), {0, 2}, 1e-14);
  EXPECT_THAT(simulator.ReasonNotDifferentiable(), HasSubstr("event at the final time"));
  EXPECT_NEAR(simulator.Adjoint(std::vector<double>{1, 0}).initial[0], -0.5, 1e-13);
  EXPECT_NEAR(simulator.Adjoint(std::vector<double>{0, 1}).initial[0], 3, 1e-13);
  // Just before it.
  ASSERT_TRUE(simulator.Rollout({.initial = {1, 0}, .parameters = {8, 0.5}, .duration = 0.5 - 1e-9}));
  EXPECT_THAT(simulator.events(), IsEmpty());
  ExpectNumbers(simulator.final_state(), {0, -4}, 1e-8);
  EXPECT_NEAR(simulator.Adjoint(std::vector<double>{1, 0}).initial[0], 1, 1e-13);
  EXPECT_NEAR(simulator.Adjoint(std::vector<double>{0, 1}).initial[0], 0, 1e-13);
  // Whatever the step is, rounding does not decide.
  for (int steps = 1; steps < 100; ++steps) {
    HybridSimulator other = Ball({.steps_per_interval = steps});
    ASSERT_TRUE(other.Rollout({.initial = {1, 0}, .parameters = {8, 0.5}, .duration = 0.5}));
    EXPECT_EQ(other.events().size(), 1u) << steps;
  }
}

TEST(HybridSimulator, EventWhereTheControlJumpsIsReported) {
  HybridInput input{.initial = {1, 0}, .parameters = {8, 0.6}, .duration = 1, .num_intervals = 2, .control = {0, 0}};
  HybridSimulator simulator = Ball();
  ASSERT_TRUE(simulator.Rollout(input));
  EXPECT_EQ(simulator.ReasonNotDifferentiable(), "");
  input.control = {0, 1};
  ASSERT_TRUE(simulator.Rollout(input));
  EXPECT_THAT(simulator.ReasonNotDifferentiable(), HasSubstr("t = 0.5, where the control jumps"));
}

TEST(HybridSimulator, GuardBelowZeroAtTheStart) {
  const HybridInput input{.initial = {-0.1, 3}, .parameters = {9.8, 0.7}, .duration = 1};
  HybridSimulator simulator = Ball();
  EXPECT_FALSE(simulator.Rollout(input));
  EXPECT_EQ(simulator.FailureReason(), "guard 'ground' is below zero (-0.1) at the start, in mode 'flight' at t = 0");
  HybridSimulator waits = Ball({.wait_behind_guards = true});
  ASSERT_TRUE(waits.Rollout(input));
  ASSERT_EQ(waits.events().size(), 2u);
  EXPECT_NEAR(waits.events()[0].time, 0.5768673298249306, 1e-14);
  EXPECT_NEAR(waits.events()[1].time, 0.95591016300840487, 1e-14);
  ExpectNumbers(waits.final_state(), {0.04779676571953615, 0.86803651530168445}, 1e-13);
  HybridInput until_armed = input;
  until_armed.duration = 0.035377568134253074;
  ASSERT_TRUE(waits.Rollout(until_armed));
  ExpectNumbers(waits.final_state(), {0, 3 - 9.8 * until_armed.duration}, 1e-14);
}

TEST(HybridSimulator, GuardAtZeroAtTheStart) {
  HybridSimulator simulator = Ball();
  ASSERT_TRUE(simulator.Rollout({.initial = {0, -1}, .parameters = {9.8, 0.7}, .duration = 0.1}));
  ASSERT_EQ(simulator.events().size(), 1u) << "falling: an event at once";
  EXPECT_EQ(simulator.events()[0].time, 0);
  ExpectNumbers(simulator.events()[0].after, {0, 0.7}, 1e-15);
  // From y0 > 0 the ball falls for y0 / 1 m/s first: dv+/dy0 = e g, and the flight behind it is that much shorter.
  EXPECT_THAT(simulator.ReasonNotDifferentiable(), HasSubstr("event at the start"));
  EXPECT_NEAR(simulator.Adjoint(std::vector<double>{1, 0}).initial[0], 0.7 * 9.8 * 0.1 - 0.7 + 9.8 * 0.1, 1e-13);
  EXPECT_NEAR(simulator.Adjoint(std::vector<double>{0, 1}).initial[0], 0.7 * 9.8 + 9.8, 1e-12);
  ASSERT_TRUE(simulator.Rollout({.initial = {0, 1}, .parameters = {9.8, 0.7}, .duration = 0.1}));
  EXPECT_THAT(simulator.events(), IsEmpty()) << "rising";
}

// A ball that bounces many times within one step of the integration, were it not for its events.
TEST(HybridSimulator, SeveralEventsInOneStep) {
  HybridSimulator simulator = Ball({.steps_per_interval = 1});
  ASSERT_TRUE(simulator.Rollout({.initial = {1, 0}, .parameters = {9.8, 0.5}, .duration = 1.35}));
  EXPECT_EQ(simulator.events().size(), 8u);
  EXPECT_NEAR(simulator.events()[2].time, 1.129384878631564, 1e-14);
}

// A system with one of several errors of a user; p = [].
struct Wrong {
  enum What { kNothing, kUnset, kNotFinite, kGuard, kMode, kReset, kBlowUp, kNoTime } what = kNothing;

  static constexpr int kNumControls = 0;
  static constexpr int kNumParameters = 0;
  static constexpr std::array kStateSizes = {2};
  static constexpr std::array kNumGuards = {1};
  static constexpr std::array<const char*, 1> kModeNames = {"only"};
  static constexpr std::array<const char*, 2> kStateNames = {"a", "b"};

  template <typename T>
  void Flow(int, const T& t, const T* x, const T*, const T*, T* xdot) const {
    using std::log;
    xdot[0] = what == kBlowUp ? T(x[0] * x[0]) : T(-1.0);
    if (what == kUnset) return;
    xdot[1] = what == kNotFinite ? T(log(-1.0 - t)) : T(0.0);
  }
  template <typename T>
  T Guard(int, int, const T&, const T* x, const T*) const {
    if (what == kGuard) return T(std::numeric_limits<double>::quiet_NaN());
    return what == kBlowUp ? T(1.0) : x[0];
  }
  template <typename T>
  int Reset(int, int, const T&, const T* x, const T*, T* x_plus) const {
    x_plus[0] = what == kNoTime ? T(x[0] - 1.0) : T(1.0 + x[0]);
    if (what != kReset) x_plus[1] = x[1];
    return what == kMode ? 7 : 0;
  }
};

TEST(HybridSimulator, SaysWhatIsWrongWithTheFunctionsOfUsers) {
  const auto why = [](Wrong::What what) {
    HybridSimulator simulator{HybridSystem(Wrong{what})};
    EXPECT_FALSE(simulator.Rollout({.initial = {1, 0}, .duration = 1.5}));
    return simulator.FailureReason();
  };
  EXPECT_EQ(why(Wrong::kUnset), "the flow of mode 'only' at t = 0 gives no finite derivative of b");
  EXPECT_EQ(why(Wrong::kNotFinite), "the flow of mode 'only' at t = 0 gives no finite derivative of b");
  EXPECT_EQ(why(Wrong::kGuard), "guard 'guard 0' is not a finite number in mode 'only' at t = 0");
  EXPECT_EQ(why(Wrong::kMode), "the reset of guard 'guard 0' in mode 'only' at t = 1 leads to mode 7, expected 0 to 0");
  EXPECT_EQ(why(Wrong::kReset),
            "the reset of guard 'guard 0' in mode 'only' at t = 1 gives no finite b in mode 'only'");
  EXPECT_THAT(why(Wrong::kBlowUp), HasSubstr("gives no finite derivative of a, however short the steps are"));
  EXPECT_THAT(why(Wrong::kBlowUp), HasSubstr("give the mode a guard that falls through zero a little before"));
  EXPECT_THAT(why(Wrong::kBlowUp), HasSubstr("mode 'only' at t = 1.00000"));
  EXPECT_THAT(why(Wrong::kNoTime), HasSubstr("more than 100 events without time passing"));
  HybridSimulator right{HybridSystem(Wrong{})};
  EXPECT_TRUE(right.Rollout({.initial = {1, 0}, .duration = 1.5})) << right.FailureReason();
}

TEST(HybridSimulator, SaysWhatIsWrongWithAnInput) {
  const HybridSystem system{BouncingBall()};
  const HybridInput right{.initial = {1, 0}, .parameters = {9.8, 0.5}, .duration = 1};
  EXPECT_EQ(Validate(right, system), "");
  const auto with = [&](auto change) {
    HybridInput input = right;
    change(&input);
    return Validate(input, system);
  };
  EXPECT_EQ(with([](HybridInput* in) { in->mode = 1; }), "found mode 1, expected 0 to 0");
  EXPECT_EQ(with([](HybridInput* in) { in->initial = {1}; }), "found 1 numbers of the initial state, expected 2");
  EXPECT_EQ(with([](HybridInput* in) { in->parameters = {}; }), "found 0 numbers of the parameters, expected 2");
  EXPECT_EQ(with([](HybridInput* in) { in->control = {1, 2}; }), "found 2 numbers of the control, expected 1");
  EXPECT_EQ(with([](HybridInput* in) { in->duration = 0; }), "expected a finite duration above zero");
  EXPECT_EQ(with([](HybridInput* in) { in->initial[0] = NAN; }), "the initial state is not finite");
}

// A decay that is stiff: x' = -1e8 (x - cos t). p = [].
struct Stiff {
  static constexpr int kNumControls = 0;
  static constexpr int kNumParameters = 0;
  static constexpr std::array kStateSizes = {1};
  static constexpr std::array kNumGuards = {0};

  template <typename T>
  void Flow(int, const T& t, const T* x, const T*, const T*, T* xdot) const {
    using std::cos;
    xdot[0] = -1e8 * (x[0] - cos(t));
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

TEST(HybridSimulator, RefusesStiffSystems) {
  HybridSimulator simulator{HybridSystem(Stiff())};
  EXPECT_FALSE(simulator.Rollout({.initial = {1}, .duration = 1}));
  EXPECT_THAT(simulator.FailureReason(), HasSubstr("may be stiff"));
  EXPECT_THAT(simulator.FailureReason(), HasSubstr("mode 'mode 0' at t ="));
}

}  // namespace
}  // namespace saltus
