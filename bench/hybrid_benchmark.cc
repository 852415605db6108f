// The costs of motions of hybrid systems and of their gradients: ratios of times of one run.
//
//   rollout_to_hand_written   a rollout of the SLIP hopper (7 events) beside the same method written for it alone
//   gradient_to_rollout       rollout and adjoint beside the rollout, of the simplest walker (4 states)
//   controls_320_to_20        a gradient of the two-mass hopper by 320 controls beside one by 20, with equal steps
//   steps_4_to_1              a rollout of a ball with four times the steps
//   events_4_to_1             one with four times the events on as many steps
#include <benchmark/benchmark.h>
#include <glog/logging.h>

#include <array>
#include <cmath>
#include <vector>

#include "hybrid/runge_kutta.h"
#include "problems/hybrid/bouncing_ball.h"
#include "problems/hybrid/simplest_walker.h"
#include "problems/hybrid/slip_hopper.h"
#include "problems/hybrid/two_mass_hopper.h"
#include "saltus/hybrid/hybrid_simulator.h"
#include "timing.h"

namespace saltus {
namespace {

// The hopper by hand: the same Runge-Kutta method, with the flow in its loop, and Newton's method for the events.
// Returns the number of events.
int RollOutHopper(double y, double vx, double vy, double duration, int steps, std::array<double, 5>* state) {
  constexpr double k = 100, l0 = 1, g = 10;
  const double theta = 10 * M_PI / 180, sine = std::sin(theta), cosine = std::cos(theta);
  int mode = SlipHopper::kDown, events = 0;
  std::array<double, 5>& x = *state;
  x = {0, y, vx, vy, 0};
  const auto flow = [&](const std::array<double, 5>& at, std::array<double, 5>* rate) {
    *rate = {at[2], at[3], 0, -g, 0};
    if (mode != SlipHopper::kStance) return;
    const double spring = k * (l0 / std::sqrt(at[0] * at[0] + at[1] * at[1]) - 1);
    *rate = {at[2], at[3], spring * at[0], spring * at[1] - g, 0};
  };
  const auto guard = [&](const std::array<double, 5>& at) {
    if (mode == SlipHopper::kDown) return at[1] - l0 * cosine;
    return mode == SlipHopper::kUp ? at[3] : l0 * l0 - at[0] * at[0] - at[1] * at[1];
  };
  const auto guard_rate = [&](const std::array<double, 5>& at) {
    if (mode == SlipHopper::kDown) return at[3];
    return mode == SlipHopper::kUp ? -g : -2 * (at[0] * at[2] + at[1] * at[3]);
  };
  const auto step = [&](double h) {
    std::array<std::array<double, 5>, RungeKutta::kStages> slopes;
    std::array<double, 5> stage = x;
    for (int i = 0; i <= RungeKutta::kStages; ++i) {
      const cooper_verner::Row& row = cooper_verner::kRows[i];
      std::array<double, 5> sum = {};
      for (int j = 0; j < row.count; ++j) {
        for (int c = 0; c < 5; ++c) sum[c] += row.terms[j].factor * slopes[row.terms[j].stage][c];
      }
      for (int c = 0; c < 5; ++c) stage[c] = x[c] + h * sum[c];
      if (i < RungeKutta::kStages) flow(stage, &slopes[i]);
    }
    return stage;
  };
  double t = 0;
  bool armed = true;
  for (int node = 1; node <= steps; ++node) {
    const double target = duration * node / steps;
    for (;;) {
      std::array<double, 5> next = step(target - t);
      const double value = guard(next);
      if (!armed || value > 0) {
        armed = armed || value > 0;
        x = next;
        t = target;
        break;
      }
      double s = target - t;
      for (int i = 0; i < 20; ++i) {
        const double change = guard(next) / guard_rate(next);
        s -= change;
        next = step(s);
        if (std::abs(change) < 1e-13) break;
      }
      x = next;
      t += s;
      ++events;
      armed = mode != SlipHopper::kDown;  // the guard of stance is at zero first
      if (mode == SlipHopper::kDown) {
        x = {-l0 * sine, l0 * cosine, x[2], x[3], x[0] + l0 * sine};
        mode = SlipHopper::kStance;
      } else if (mode == SlipHopper::kStance) {
        x = {x[0] + x[4], x[1], x[2], x[3], 0};
        mode = SlipHopper::kUp;
      } else {
        mode = SlipHopper::kDown;
      }
    }
  }
  return events;
}

void BesideHandWritten(benchmark::State& state) {
  constexpr int kSteps = 256;
  HybridSimulator simulator(HybridSystem(SlipHopper()), {.steps_per_interval = kSteps});
  const HybridInput input{.initial = {0, 1.18, 1.02, -0.1}, .parameters = {100, 10 * M_PI / 180}, .duration = 2.1};
  std::array<double, 5> by_hand;
  CHECK(simulator.Rollout(input)) << simulator.FailureReason();
  CHECK_EQ(RollOutHopper(1.18, 1.02, -0.1, 2.1, kSteps, &by_hand), 7);
  for (int i = 0; i < 5; ++i) CHECK_LT(std::abs(by_hand[i] - simulator.final_state()[i]), 1e-9);
  for (auto _ : state) {
    const auto [hand, library] =
        TimeInTurns([&] { benchmark::DoNotOptimize(RollOutHopper(1.18, 1.02, -0.1, 2.1, kSteps, &by_hand)); },
                    [&] { CHECK(simulator.Rollout(input)); });
    state.counters["rollout_to_hand_written"] = library / hand;
    state.counters["rollout_us"] = 1e6 * library;
  }
}
BENCHMARK(BesideHandWritten)->Iterations(1);

void GradientBesideRollout(benchmark::State& state) {
  HybridSimulator simulator(HybridSystem(SimplestWalker()), {.steps_per_interval = 256});
  const HybridInput input{.initial = {0.2, -0.2, 0.4, -0.0158}, .parameters = {0.009}, .duration = 9};
  const std::vector<double> cotangent = {1, 0.5, -0.3, 0.2};
  for (auto _ : state) {
    const auto [rollout, gradient] = TimeInTurns([&] { CHECK(simulator.Rollout(input)); },
                                                 [&] {
                                                   CHECK(simulator.Rollout(input));
                                                   benchmark::DoNotOptimize(simulator.Adjoint(cotangent));
                                                 });
    state.counters["gradient_to_rollout"] = gradient / rollout;
    state.counters["rollout_us"] = 1e6 * rollout;
  }
}
BENCHMARK(GradientBesideRollout)->Iterations(1);

void GradientByMoreControls(benchmark::State& state) {
  HybridSimulator few(HybridSystem(TwoMassHopper()), {.steps_per_interval = 16});
  HybridSimulator many(HybridSystem(TwoMassHopper()), {.steps_per_interval = 1});
  const std::vector<double> cotangent = {1, 0.5, -0.3, 0.2, 0.1};
  const auto evaluate = [&](HybridSimulator* simulator, int intervals) {
    CHECK(simulator->Rollout({.initial = {0.6, 0, 0.1, 0, 0.5}, .duration = 0.5, .num_intervals = intervals}));
    benchmark::DoNotOptimize(simulator->Adjoint(cotangent));
  };
  for (auto _ : state) {
    const auto [by_20, by_320] = TimeInTurns([&] { evaluate(&few, 20); }, [&] { evaluate(&many, 320); });
    state.counters["controls_320_to_20"] = by_320 / by_20;
  }
}
BENCHMARK(GradientByMoreControls)->Iterations(1);

void StepsAndEvents(benchmark::State& state) {
  const auto ball = [](double height) {
    return HybridInput{.initial = {height, 0}, .parameters = {9.81, 1.0}, .duration = 10};
  };
  HybridSimulator coarse(HybridSystem(BouncingBall()), {.steps_per_interval = 2000}),
      fine(HybridSystem(BouncingBall()), {.steps_per_interval = 8000});
  CHECK(coarse.Rollout(ball(0.8)));
  const auto events = static_cast<double>(coarse.events().size());
  CHECK(coarse.Rollout(ball(0.05)));
  CHECK_LT(std::abs(coarse.events().size() / events - 4), 0.3);
  for (auto _ : state) {
    const auto [one, more_steps, more_events] = TimeInTurns([&] { CHECK(coarse.Rollout(ball(0.8))); },
                                                            [&] { CHECK(fine.Rollout(ball(0.8))); },
                                                            [&] { CHECK(coarse.Rollout(ball(0.05))); });
    state.counters["steps_4_to_1"] = more_steps / one;
    state.counters["events_4_to_1"] = more_events / one;
  }
}
BENCHMARK(StepsAndEvents)->Iterations(1);

}  // namespace
}  // namespace saltus
