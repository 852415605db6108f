#pragma once

#include <array>

#include "saltus/hybrid/hybrid_problem.h"

namespace saltus {

// A thermostat, [y z] with z = int y dt; p = [a b low high].
struct Thermostat {
  static constexpr int kNumControls = 0;
  static constexpr int kNumParameters = 4;
  enum Mode { kOn, kOff };
  static constexpr std::array kStateSizes = {2, 2};
  static constexpr std::array kNumGuards = {1, 1};
  static constexpr std::array<const char*, 2> kModeNames = {"on", "off"};
  static constexpr std::array<const char*, 2> kGuardNames = {"high", "low"};
  static constexpr std::array<const char*, 2> kStateNames = {"y", "z"};
  static constexpr std::array<const char*, 4> kParameterNames = {"a", "b", "low", "high"};

  template <typename T>
  void Flow(int mode, const T&, const T* x, const T*, const T* p, T* xdot) const {
    xdot[0] = (mode == kOn ? p[1] : T(0.0)) - p[0] * x[0];
    xdot[1] = x[0];
  }
  template <typename T>
  T Guard(int mode, int, const T&, const T* x, const T* p) const {
    return mode == kOn ? T(p[3] - x[0]) : T(x[0] - p[2]);
  }
  template <typename T>
  int Reset(int mode, int, const T&, const T* x, const T*, T* x_plus) const {
    x_plus[0] = x[0];
    x_plus[1] = x[1];
    return 1 - mode;
  }
};

// From nosnoc's examples. The lower limit with which the integral of the temperature has the given value after 6 s: 18.
inline HybridProblem ThermostatProblem() {
  HybridProblem problem{.system = HybridSystem(Thermostat()),
                        .guess = {.initial = {15, 0}, .parameters = {0.2, 10, 18.05, 20}, .duration = 6},
                        .terms = {MakeTerminalCost(1, 112.9562745453364504, 1.0, 2)}};
  problem.free.parameters = {2};
  return problem;
}

}  // namespace saltus
