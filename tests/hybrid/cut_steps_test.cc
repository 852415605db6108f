// Steps that events cut: the error of a stretch between events that is shorter than all steps of the integration.
#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <random>

#include "saltus/hybrid/hybrid_simulator.h"

namespace saltus {
namespace {

// Waits until t = s, grows as y' = r y (1 - y) until y = c, and falls as y' = -1.
struct Growth {
  static constexpr int kNumControls = 0;
  static constexpr int kNumParameters = 3;  // s, r, c
  static constexpr std::array kStateSizes = {1, 1, 1};
  static constexpr std::array kNumGuards = {1, 1, 0};

  template <typename T>
  void Flow(int mode, const T&, const T* x, const T*, const T* p, T* xdot) const {
    xdot[0] = mode == 0 ? T(0.0) : mode == 1 ? p[1] * x[0] * (1.0 - x[0]) : T(-1.0);
  }
  template <typename T>
  T Guard(int mode, int, const T& t, const T* x, const T* p) const {
    return mode == 0 ? p[0] - t : p[2] - x[0];
  }
  template <typename T>
  int Reset(int mode, int, const T&, const T* x, const T*, T* next) const {
    next[0] = x[0];
    return mode + 1;
  }
};

struct GrowthByHand {
  double begin, rate, end;
  double from = 0.1;

  double Length() const { return (std::log(end / (1 - end)) - std::log(from / (1 - from))) / rate; }
  double Final(double duration) const { return end - (duration - begin - Length()); }
};

// The stretch of growth lies within half of a step of the fewest, so that twice as many steps take it as one step, too.
TEST(CutSteps, AShortStretchBetweenTwoEventsCountsInTheError) {
  std::mt19937 random(3);
  std::uniform_real_distribution<double> uniform(0, 1);
  for (int i = 0; i < 40; ++i) {
    const double begin = (std::floor(30 * uniform(random)) + 0.1 * uniform(random)) / 32;
    const double length = (0.1 + 0.75 * uniform(random)) / 32;
    GrowthByHand exact{begin, 1, 0.15 + 0.8 * uniform(random)};
    exact.rate = exact.Length() / length;
    HybridSimulator simulator{HybridSystem(Growth())};
    ASSERT_TRUE(
        simulator.Rollout({.initial = {exact.from}, .parameters = {begin, exact.rate, exact.end}, .duration = 1}))
        << simulator.FailureReason();
    ASSERT_EQ(simulator.events().size(), 2u);
    EXPECT_NEAR(simulator.events()[1].time, begin + length, 1.2e-12) << i;
    EXPECT_NEAR(simulator.final_state()[0], exact.Final(1), 1.2e-12) << i;
    EXPECT_LE(simulator.IntegrationError(), 1e-12) << i;
    EXPECT_EQ(simulator.ReasonInaccurate(), "") << i;
  }
}

// With given steps the error that is reported is about that of the motion: 7e-8 to 2e-6, and the same for 24 and 32
// steps, which are longer than the stretch.
TEST(CutSteps, TheErrorOfGivenStepsIsReported) {
  for (const double end : {0.3, 0.4, 0.6}) {
    for (const int steps : {24, 32, 48}) {
      const GrowthByHand exact{0.505, 100 * std::log(9 * end / (1 - end)) / std::log(6.0), end};
      HybridSimulator simulator{HybridSystem(Growth()), {.steps_per_interval = steps}};
      const HybridInput input{.initial = {exact.from}, .parameters = {exact.begin, exact.rate, end}, .duration = 1};
      ASSERT_TRUE(simulator.Rollout(input)) << simulator.FailureReason();
      const double error = std::abs(simulator.events()[1].time - exact.begin - exact.Length());
      ASSERT_GT(error, 1e-8);
      EXPECT_GT(simulator.IntegrationError(), error);
      EXPECT_LT(simulator.IntegrationError(), 5 * error);
      EXPECT_NE(simulator.ReasonInaccurate(), "");
    }
  }
}

// The last mode lasts for a part of a step, from an event to the end.
TEST(CutSteps, AStretchToTheEndCountsInTheError) {
  const GrowthByHand exact{0.98, 150, 0.999};
  HybridSimulator simulator{HybridSystem(Growth())};
  ASSERT_TRUE(simulator.Rollout({.initial = {exact.from}, .parameters = {0.98, 150, 0.999}, .duration = 1}));
  ASSERT_EQ(simulator.events().size(), 1u);
  const double grown = 1 / (1 + 9 * std::exp(-150 * 0.02));
  EXPECT_NEAR(simulator.final_state()[0], grown, 1e-12);
}

// x' = exp(-((t - c) / w)^2) / w.
struct Pulse {
  static constexpr int kNumControls = 1;
  static constexpr int kNumParameters = 2;  // c, w
  static constexpr std::array kStateSizes = {1};
  static constexpr std::array kNumGuards = {0};

  template <typename T>
  void Flow(int, const T& t, const T*, const T* u, const T* p, T* xdot) const {
    using std::exp;
    const T z = (t - p[0]) / p[1];
    xdot[0] = u[0] + exp(-z * z) / p[1];
  }
  template <typename T>
  T Guard(int, int, const T&, const T*, const T*) const {
    return T(1.0);
  }
  template <typename T>
  int Reset(int, int, const T&, const T* x, const T*, T* next) const {
    next[0] = x[0];
    return 0;
  }
};

// Steps see a pulse of a width of 1e-6 of the duration between two times, near it, at which the user divides intervals.
TEST(CutSteps, TimesThatDivideAnIntervalShowAPulse) {
  const HybridInput input{.initial = {0},
                          .parameters = {7.3, 1e-5},
                          .duration = 10,
                          .num_intervals = 3,
                          .control = {1, -2, 3},
                          .lengths = {1, 3, 1}};
  HybridSimulator simulator{HybridSystem(Pulse()), {.divisions = {0.729992, 0.730008}}};
  ASSERT_TRUE(simulator.Rollout(input)) << simulator.FailureReason();
  EXPECT_NEAR(simulator.final_state()[0], 2 - 12 + 6 + std::sqrt(M_PI), 1e-10);
  EXPECT_LT(simulator.num_steps(), 20000);
  EXPECT_EQ(simulator.ModeAt(2), 0);
  EXPECT_NEAR(simulator.StateAt(2)[0], 2 - 12 + std::sqrt(M_PI), 1e-10);
  const HybridGradient gradient = simulator.Adjoint(std::array{1.0});
  EXPECT_NEAR(gradient.control[0], 2, 1e-12);
  EXPECT_NEAR(gradient.control[1], 6, 1e-12);
  EXPECT_NEAR(gradient.control[2], 2, 1e-12);
}

}  // namespace
}  // namespace saltus
