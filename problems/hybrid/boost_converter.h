#pragma once

#include <array>

#include "saltus/hybrid/hybrid_problem.h"

namespace saltus {

// A boost converter with hysteretic current control, [i v z] with z = int v dt; p = [L C R Vin low high]; mH, mF, ms.
struct BoostConverter {
  static constexpr int kNumControls = 0;
  static constexpr int kNumParameters = 6;
  enum Mode { kOn, kOff };
  static constexpr std::array kStateSizes = {3, 3};
  static constexpr std::array kNumGuards = {1, 1};
  static constexpr std::array<const char*, 2> kModeNames = {"on", "off"};
  static constexpr std::array<const char*, 2> kGuardNames = {"high", "low"};
  static constexpr std::array<const char*, 3> kStateNames = {"i", "v", "z"};
  static constexpr std::array<const char*, 6> kParameterNames = {"L", "C", "R", "Vin", "low", "high"};

  template <typename T>
  void Flow(int mode, const T&, const T* x, const T*, const T* p, T* xdot) const {
    const bool on = mode == kOn;
    xdot[0] = (p[3] - (on ? T(0.0) : x[1])) / p[0];
    xdot[1] = ((on ? T(0.0) : x[0]) - x[1] / p[2]) / p[1];
    xdot[2] = x[1];
  }
  template <typename T>
  T Guard(int mode, int, const T&, const T* x, const T* p) const {
    return mode == kOn ? T(p[5] - x[0]) : T(x[0] - p[4]);
  }
  template <typename T>
  int Reset(int mode, int, const T&, const T* x, const T*, T* x_plus) const {
    for (int i = 0; i < 3; ++i) x_plus[i] = x[i];
    return 1 - mode;
  }
};

// The limits of the current with which the voltage and its integral have the given values at 0.9 ms: 3.5 A and 4.5 A.
inline HybridProblem BoostConverterProblem() {
  HybridProblem problem{
      .system = HybridSystem(BoostConverter()),
      .guess = {.initial = {3.5, 18, 0}, .parameters = {0.5, 0.5, 10, 10, 3.502, 4.498}, .duration = 0.9},
      .terms = {MakeTerminalCost(1, 18.59052992471162687, 1.0, 3), MakeTerminalCost(2, 16.42360974004356761, 1.0, 3)}};
  problem.free.parameters = {4, 5};
  return problem;
}

}  // namespace saltus
