// Flows that jump or have a kink at declared switches, flows that jump without one, and guards of high frequency.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <numbers>
#include <random>
#include <string>
#include <vector>

#include "saltus/hybrid/hybrid_simulator.h"

namespace saltus {
namespace {

using testing::HasSubstr;

// x' = 1 below c, 3 above.
struct TwoRates {
  static constexpr int kNumControls = 0;
  static constexpr int kNumParameters = 1;
  static constexpr std::array kStateSizes = {1};
  static constexpr std::array kNumGuards = {0};
  static constexpr std::array kNumSwitches = {1};
  static constexpr std::array<const char*, 1> kSwitchNames = {"x - c"};

  template <typename T>
  void Flow(int, const T&, const T*, const T*, const T*, const bool* above, T* xdot) const {
    xdot[0] = T(above[0] ? 3.0 : 1.0);
  }
  template <typename T>
  T Switch(int, int, const T&, const T* x, const T* p) const {
    return x[0] - p[0];
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

TEST(Switches, AJumpOfTheFlowHasItsSaltation) {
  HybridSimulator simulator{HybridSystem(TwoRates())};
  ASSERT_TRUE(simulator.Rollout({.initial = {0.3}, .parameters = {1}, .duration = 2})) << simulator.FailureReason();
  EXPECT_NEAR(simulator.final_state()[0], 4.9, 1e-14);
  ASSERT_EQ(simulator.events().size(), 1u);
  EXPECT_TRUE(simulator.events()[0].is_switch);
  EXPECT_NEAR(simulator.events()[0].time, 0.7, 1e-15);
  EXPECT_EQ(simulator.ReasonNotDifferentiable(), "");
  const HybridGradient by = simulator.Adjoint(std::vector<double>{1});
  EXPECT_NEAR(by.initial[0], 3, 1e-14);
  EXPECT_NEAR(by.parameters[0], -2, 1e-14);
  EXPECT_NEAR(by.duration, 3, 1e-14);
  const HybridSensitivity forward = simulator.Sensitivity();
  EXPECT_NEAR(forward.final_state[0], 3, 1e-14);
  EXPECT_NEAR(forward.times[0][0], -1, 1e-14);
}

TEST(Switches, AMotionThatBeginsOnOneSaysSo) {
  HybridSimulator simulator{HybridSystem(TwoRates())};
  ASSERT_TRUE(simulator.Rollout({.initial = {1}, .parameters = {1}, .duration = 2}));
  EXPECT_THAT(simulator.ReasonNotDifferentiable(), HasSubstr("begins on switch 'x - c'"));
  EXPECT_NEAR(simulator.final_state()[0], 7, 1e-14);
}

// A ball that falls and bounces with drag c v |v|, in two modes of one state each size to show that pieces have names.
struct Dragged {
  static constexpr int kNumControls = 0;
  static constexpr int kNumParameters = 3;  // c, e, g
  static constexpr std::array kStateSizes = {2};
  static constexpr std::array kNumGuards = {1};
  static constexpr std::array kNumSwitches = {1};
  static constexpr std::array<const char*, 1> kModeNames = {"air"};
  static constexpr std::array<const char*, 1> kGuardNames = {"floor"};

  template <typename T>
  void Flow(int, const T&, const T* x, const T*, const T* p, const bool* above, T* xdot) const {
    xdot[0] = x[1];
    xdot[1] = -p[2] - (above[0] ? p[0] : -p[0]) * x[1] * x[1];
  }
  template <typename T>
  T Switch(int, int, const T&, const T* x, const T*) const {
    return x[1];
  }
  template <typename T>
  T Guard(int, int, const T&, const T* x, const T*) const {
    return x[0];
  }
  template <typename T>
  int Reset(int, int, const T&, const T* x, const T* p, T* x_plus) const {
    x_plus[0] = T(0.0);
    x_plus[1] = -p[1] * x[1];
    return 0;
  }
};

// A system with the kink in the flow itself, which no switch declares.
struct UndeclaredKink {
  static constexpr int kNumControls = 0;
  static constexpr int kNumParameters = 3;
  static constexpr std::array kStateSizes = {2};
  static constexpr std::array kNumGuards = {1};

  template <typename T>
  void Flow(int, const T&, const T* x, const T*, const T* p, T* xdot) const {
    using std::abs;
    xdot[0] = x[1];
    xdot[1] = -p[2] - p[0] * x[1] * abs(x[1]);
  }
  template <typename T>
  T Guard(int, int, const T&, const T* x, const T*) const {
    return x[0];
  }
  template <typename T>
  int Reset(int, int, const T&, const T* x, const T* p, T* x_plus) const {
    x_plus[0] = T(0.0);
    x_plus[1] = -p[1] * x[1];
    return 0;
  }
};

// Closed form by tan and tanh, 20 digits.
constexpr double kHeight = 1.2396694851585465, kSpeed = -1.2908332552467855, kSpeedByDrag = -88.956035440879939;
const HybridInput kDraggedBall = {.initial = {9, 3}, .parameters = {0.04, 0.72, 9.81}, .duration = 4};

TEST(Switches, AKinkOfTheFlowIsMetAtFullOrder) {
  HybridSimulator simulator{HybridSystem(Dragged())};
  ASSERT_TRUE(simulator.Rollout(kDraggedBall)) << simulator.FailureReason();
  EXPECT_LE(simulator.IntegrationError(), 1e-12);
  EXPECT_EQ(simulator.ReasonInaccurate(), "");
  EXPECT_EQ(simulator.ReasonNotDifferentiable(), "");
  EXPECT_LE(simulator.steps_per_interval(), 128);
  EXPECT_NEAR(simulator.final_state()[0], kHeight, 1e-11);
  EXPECT_NEAR(simulator.final_state()[1], kSpeed, 1e-11);
  EXPECT_NEAR(simulator.Adjoint(std::vector<double>{0, 1}).parameters[0], kSpeedByDrag, 1e-8);
  for (const HybridEvent& event : simulator.events()) {
    EXPECT_EQ(simulator.system().ModeName(event.mode), "air");
    EXPECT_EQ(simulator.system().GuardName(event.mode, event.guard), event.is_switch ? "switch 0" : "floor");
  }
}

TEST(Switches, AnUndeclaredKinkIsIntegratedToTheToleranceOrRemarked) {
  HybridSimulator simulator{HybridSystem(UndeclaredKink())};
  ASSERT_TRUE(simulator.Rollout(kDraggedBall)) << simulator.FailureReason();
  const double error =
      std::max(std::abs(simulator.final_state()[0] - kHeight) / 9, std::abs(simulator.final_state()[1] - kSpeed) / 13);
  EXPECT_TRUE(error < 1e-11 || simulator.ReasonInaccurate() != "") << error;
  EXPECT_LT(error, 20 * std::max(simulator.IntegrationError(), 1e-13));
}

TEST(Switches, GivenStepsThatAreTooFewAreRemarked) {
  HybridSimulator simulator(HybridSystem(UndeclaredKink()), {.steps_per_interval = 64});
  ASSERT_TRUE(simulator.Rollout(kDraggedBall));
  EXPECT_GT(std::abs(simulator.final_state()[1] - kSpeed), 1e-9);
  EXPECT_THAT(simulator.ReasonInaccurate(), HasSubstr("above the tolerance 1e-12"));
}

// v' = f - mu sign v, whose both sides point at v = 0 if |f| < mu.
struct Friction {
  static constexpr int kNumControls = 0;
  static constexpr int kNumParameters = 2;
  static constexpr std::array kStateSizes = {1};
  static constexpr std::array kNumGuards = {0};
  static constexpr std::array kNumSwitches = {1};

  template <typename T>
  void Flow(int, const T&, const T*, const T*, const T* p, const bool* above, T* xdot) const {
    xdot[0] = above[0] ? p[0] - p[1] : p[0] + p[1];
  }
  template <typename T>
  T Switch(int, int, const T&, const T* x, const T*) const {
    return x[0];
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

TEST(Switches, AMotionAlongASwitchEndsWithTheReason) {
  HybridSimulator simulator{HybridSystem(Friction())};
  EXPECT_FALSE(simulator.Rollout({.initial = {1}, .parameters = {0.2, 1}, .duration = 3}));
  EXPECT_THAT(simulator.FailureReason(), HasSubstr("slide along the switch"));
  EXPECT_THAT(simulator.FailureReason(), HasSubstr("t = 1.25"));
  EXPECT_THAT(simulator.FailureReason(), HasSubstr("mode of its own"));
  ASSERT_TRUE(simulator.Rollout({.initial = {1}, .parameters = {-1.2, 1}, .duration = 3})) << simulator.FailureReason();
  EXPECT_NEAR(simulator.final_state()[0], -0.2 * (3 - 1 / 2.2), 1e-14);
}

// A flow with an `if`.
struct WithIf {
  static constexpr int kNumControls = 0;
  static constexpr int kNumParameters = 0;
  static constexpr std::array kStateSizes = {2};
  static constexpr std::array kNumGuards = {0};

  template <typename T>
  void Flow(int, const T&, const T* x, const T*, const T*, T* xdot) const {
    xdot[0] = x[1];
    xdot[1] = T(-9.8);
    if (x[0] < T(0.5)) xdot[1] *= 2.0;
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

TEST(Switches, AnUndeclaredJumpOfTheFlowIsRefusedWithItsPlace) {
  HybridSimulator simulator{HybridSystem(WithIf())};
  EXPECT_FALSE(simulator.Rollout({.initial = {1, 0}, .duration = 1}));
  EXPECT_THAT(simulator.FailureReason(), HasSubstr("jumps at t = 0.319"));  // 1 - 4.9 t^2 = 0.5
  EXPECT_THAT(simulator.FailureReason(), HasSubstr("x[1] changes from -9.8 to -19.6"));
  EXPECT_THAT(simulator.FailureReason(), HasSubstr("kNumSwitches"));
}

// y' = 1 - y while sin(2 pi f t) < d, else -y.
struct Comparator {
  static constexpr int kNumControls = 0;
  static constexpr int kNumParameters = 1;
  static constexpr std::array kStateSizes = {1, 1};
  static constexpr std::array kNumGuards = {1, 1};
  double frequency;

  template <typename T>
  void Flow(int mode, const T&, const T* x, const T*, const T*, T* xdot) const {
    xdot[0] = T(mode == 0 ? 1.0 : 0.0) - x[0];
  }
  template <typename T>
  T Guard(int mode, int, const T& t, const T*, const T* p) const {
    using std::sin;
    const T carrier = sin(2 * std::numbers::pi * frequency * t);
    return mode == 0 ? p[0] - carrier : carrier - p[0];
  }
  template <typename T>
  int Reset(int mode, int, const T&, const T* x, const T*, T* x_plus) const {
    x_plus[0] = x[0];
    return 1 - mode;
  }
};

void ExpectAllSwitchings(double frequency, double duty) {
  const double w = 2 * std::numbers::pi * frequency, a = std::asin(duty);
  std::vector<double> times;
  for (int k = 0; k <= frequency; ++k) {
    for (const double phase : {a, std::numbers::pi - a}) {
      const double t = (phase + 2 * std::numbers::pi * k) / w;
      if (t < 1) times.push_back(t);
    }
  }
  times.push_back(1);
  double y = 0, t = 0, on = 1;
  for (const double next : times) {
    y = on + (y - on) * std::exp(t - next);
    t = next;
    on = 1 - on;
  }
  SCOPED_TRACE(std::to_string(frequency) + " Hz, " + std::to_string(duty));
  HybridSimulator simulator{HybridSystem(Comparator{frequency})};
  ASSERT_TRUE(simulator.Rollout({.initial = {0}, .parameters = {duty}, .duration = 1})) << simulator.FailureReason();
  EXPECT_EQ(simulator.events().size(), times.size() - 1);
  EXPECT_NEAR(simulator.final_state()[0], y, 1e-11);
  EXPECT_EQ(simulator.ReasonInaccurate(), "");
}

TEST(Switches, GuardsOfHighFrequencyAreNotMissed) {
  for (const double frequency : {1, 16, 50, 64, 80, 160, 400, 1000, 4096}) ExpectAllSwitchings(frequency, 0.3);
  std::mt19937 random(1);
  std::uniform_real_distribution<double> exponent(0, 3), duty(0.05, 0.8);
  for (int i = 0; i < 30; ++i) ExpectAllSwitchings(std::pow(10, exponent(random)), duty(random));
}

TEST(Switches, AGuardThatIsTooFastForTheGivenStepsIsNamed) {
  HybridSimulator simulator(HybridSystem(Comparator{64}), {.steps_per_interval = 16});
  ASSERT_TRUE(simulator.Rollout({.initial = {0}, .parameters = {0.3}, .duration = 1}));
  EXPECT_THAT(simulator.ReasonInaccurate(), HasSubstr("guard 'guard 0' changes faster than the steps resolve"));
}

}  // namespace
}  // namespace saltus
