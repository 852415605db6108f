// Random hybrid systems: derivatives by the adjoint, by forward sweeps and by differences.
#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <random>
#include <string>
#include <vector>

#include "saltus/hybrid/hybrid_simulator.h"

namespace saltus {
namespace {

// Linear flows x' = A x + b sin(t + p1) + B u + c p0 in two to four modes of two to six states; guards n.x + offset +
// 0.1 p0 - 0.1 sin(2 t); resets x+ = R x + r + 0.1 p1 into another mode.
struct RandomSystem {
  static constexpr int kMostStates = 6, kMostModes = 4, kMostGuards = 2;
  struct Mode {
    int size = 2, guards = 1;
    std::array<std::array<double, kMostStates>, kMostStates> A{};
    std::array<double, kMostStates> b{}, B{}, c{};
    struct Guard {
      int next = 0;
      double offset = 0;
      std::array<double, kMostStates> n{}, r{};
      std::array<std::array<double, kMostStates>, kMostStates> R{};
    };
    std::array<Guard, kMostGuards> to;
  };
  std::array<Mode, kMostModes> modes;

  template <typename T>
  void Flow(int mode, const T& t, const T* x, const T* u, const T* p, T* xdot) const {
    using std::sin;
    const Mode& m = modes[mode];
    const T wave = sin(t + p[1]);
    for (int i = 0; i < m.size; ++i) {
      xdot[i] = m.b[i] * wave + m.B[i] * u[0] + m.c[i] * p[0];
      for (int j = 0; j < m.size; ++j) xdot[i] += m.A[i][j] * x[j];
    }
  }
  template <typename T>
  T Guard(int mode, int guard, const T& t, const T* x, const T* p) const {
    using std::sin;
    T g = modes[mode].to[guard].offset + 0.1 * p[0] - 0.1 * sin(2.0 * t);
    for (int i = 0; i < modes[mode].size; ++i) g += modes[mode].to[guard].n[i] * x[i];
    return g;
  }
  template <typename T>
  int Reset(int mode, int guard, const T&, const T* x, const T* p, T* x_plus) const {
    const Mode::Guard& to = modes[mode].to[guard];
    for (int i = 0; i < modes[to.next].size; ++i) {
      x_plus[i] = to.r[i] + 0.1 * p[1];
      for (int j = 0; j < modes[mode].size; ++j) x_plus[i] += to.R[i][j] * x[j];
    }
    return to.next;
  }
};

struct OfFourModes : RandomSystem {
  static constexpr int kNumControls = 1;
  static constexpr int kNumParameters = 2;
  static constexpr std::array kStateSizes = {2, 6, 3, 4};
  static constexpr std::array kNumGuards = {2, 1, 1, 2};
};

OfFourModes Random(std::mt19937* random, int num_modes) {
  std::normal_distribution<double> normal;
  OfFourModes system;
  for (int m = 0; m < 4; ++m) {
    RandomSystem::Mode& mode = system.modes[m];
    mode.size = OfFourModes::kStateSizes[m];
    mode.guards = OfFourModes::kNumGuards[m];
    for (int i = 0; i < mode.size; ++i) {
      for (int j = 0; j < mode.size; ++j) mode.A[i][j] = 0.7 * normal(*random);
      mode.A[i][i] -= 0.5;
      mode.b[i] = normal(*random);
      mode.B[i] = normal(*random);
      mode.c[i] = 0.5 * normal(*random);
    }
    for (int guard = 0; guard < mode.guards; ++guard) {
      RandomSystem::Mode::Guard& to = mode.to[guard];
      to.next = (m + 1 + guard) % num_modes;
      to.offset = 0.2 + 0.3 * std::abs(normal(*random));
      for (int i = 0; i < mode.size; ++i) to.n[i] = normal(*random);
      for (int i = 0; i < OfFourModes::kStateSizes[to.next]; ++i) {
        to.r[i] = 0.3 * normal(*random);
        for (int j = 0; j < mode.size; ++j) to.R[i][j] = 0.4 * normal(*random);
      }
    }
  }
  return system;
}

// A weighted sum of the final state, of the states around the events and of their times.
struct Loss {
  HybridCotangent cotangent;
  double value = 0;
};

Loss LossOf(const HybridSimulator& simulator) {
  Loss loss;
  double weight = 1;
  const auto add = [&](std::span<const double> x, std::vector<double>* cotangent) {
    for (const double number : x) {
      weight = std::fmod(1.7 * weight + 0.3, 2) - 0.9;
      loss.value += weight * number;
      cotangent->push_back(weight);
    }
  };
  for (const HybridEvent& event : simulator.events()) {
    add(event.before, &loss.cotangent.before.emplace_back());
    add(event.after, &loss.cotangent.after.emplace_back());
    const double time[] = {event.time};
    add(time, &loss.cotangent.event_times);
  }
  for (int k = 0; k < 3; ++k) add(simulator.StateAt(k), &loss.cotangent.nodes.emplace_back());
  add(simulator.final_state(), &loss.cotangent.final_state);
  return loss;
}

TEST(RandomHybridSystems, DerivativesAgree) {
  std::mt19937 random(20);
  std::normal_distribution<double> normal;
  int compared = 0, with_events = 0, differences = 0;
  double worst = 0, worst_difference = 0;
  for (int trial = 0; trial < 250; ++trial) {
    SCOPED_TRACE("system " + std::to_string(trial));
    HybridInput input{.mode = 0, .parameters = {normal(random), normal(random)}, .duration = 3, .num_intervals = 3};
    const HybridSystem system(Random(&random, 2 + trial % 3));
    input.initial = {0.3 * normal(random), 0.3 * normal(random)};
    for (int k = 0; k < 3; ++k) input.control.push_back(normal(random));
    HybridSimulator simulator(system);
    if (!simulator.Rollout(input)) {
      EXPECT_NE(simulator.FailureReason(), "");
      continue;
    }
    if (simulator.ReasonNotDifferentiable() != "") continue;
    ++compared;
    with_events += !simulator.events().empty();
    const int final_size = static_cast<int>(simulator.final_state().size());
    const HybridSensitivity forward = simulator.Sensitivity();
    for (int row = 0; row < final_size; ++row) {
      std::vector<double> cotangent(final_size);
      cotangent[row] = 1;
      const HybridGradient gradient = simulator.Adjoint(cotangent);
      std::vector<double> all = gradient.initial;
      all.insert(all.end(), gradient.control.begin(), gradient.control.end());
      all.insert(all.end(), gradient.parameters.begin(), gradient.parameters.end());
      all.push_back(gradient.duration);
      double size = 0, difference = 0;
      for (int j = 0; j < forward.columns; ++j) {
        EXPECT_TRUE(std::isfinite(all[j]) && std::isfinite(forward.final_state[row * forward.columns + j]));
        size = std::max(size, std::abs(all[j]));
        difference = std::max(difference, std::abs(all[j] - forward.final_state[row * forward.columns + j]));
      }
      worst = std::max(worst, difference / size);
    }
    // Differences of fourth order, with the same steps.
    const Loss loss = LossOf(simulator);
    const HybridGradient gradient = simulator.Adjoint(loss.cotangent);
    const std::size_t events = simulator.events().size();
    const auto check = [&](double* number, double derivative) {
      const double at = *number;
      double least = INFINITY;  // near grazing, derivatives of higher order are large
      for (const double width : {1e-4, 1e-5}) {
        double values[4];
        const double places[] = {-2, -1, 1, 2};
        for (int i = 0; i < 4; ++i) {
          *number = at + places[i] * width;
          const bool same = simulator.Rollout(input) && simulator.events().size() == events;
          values[i] = same ? LossOf(simulator).value : NAN;
        }
        const double difference = (values[0] - 8 * values[1] + 8 * values[2] - values[3]) / (12 * width);
        const double error = std::abs(difference - derivative) / std::max(1.0, std::abs(derivative));
        if (error < least) least = error;
      }
      *number = at;
      if (!std::isfinite(least)) return;
      ++differences;
      worst_difference = std::max(worst_difference, least);
    };
    for (int i = 0; i < 2; ++i) check(&input.initial[i], gradient.initial[i]);
    for (int i = 0; i < 2; ++i) check(&input.parameters[i], gradient.parameters[i]);
    for (int i = 0; i < 3; ++i) check(&input.control[i], gradient.control[i]);
    check(&input.duration, gradient.duration);
  }
  EXPECT_GE(compared, 120);
  EXPECT_GE(with_events, 100);
  EXPECT_GE(differences, 6 * compared);  // of 8 each: others change the sequence of events
  EXPECT_LT(worst, 1e-12);
  EXPECT_LT(worst_difference, 1e-7);
}

}  // namespace
}  // namespace saltus
