#pragma once

#include <array>
#include <cmath>

#include "saltus/hybrid/hybrid_problem.h"

namespace saltus {

// An oscillator that turns the other way outside a circle; p = [omega R].
struct SwitchedOscillator {
  static constexpr int kNumControls = 0;
  static constexpr int kNumParameters = 2;
  static constexpr std::array kStateSizes = {2, 2};
  static constexpr std::array kNumGuards = {1, 1};
  static constexpr std::array<const char*, 2> kModeNames = {"in", "out"};
  static constexpr std::array<const char*, 2> kGuardNames = {"out", "in"};
  static constexpr std::array<const char*, 2> kStateNames = {"x1", "x2"};
  static constexpr std::array<const char*, 2> kParameterNames = {"omega", "R"};

  template <typename T>
  void Flow(int mode, const T&, const T* x, const T*, const T* p, T* xdot) const {
    const T omega = mode == 0 ? p[0] : T(-p[0]);
    xdot[0] = x[0] - omega * x[1];
    xdot[1] = omega * x[0] + x[1];
  }
  template <typename T>
  T Guard(int mode, int, const T&, const T* x, const T* p) const {
    const T inside = p[1] * p[1] - x[0] * x[0] - x[1] * x[1];
    return mode == 0 ? inside : T(-inside);
  }
  template <typename T>
  int Reset(int mode, int, const T&, const T* x, const T*, T* x_plus) const {
    x_plus[0] = x[0];
    x_plus[1] = x[1];
    return 1 - mode;
  }

  template <typename Drawing>
  void Draw(int, double, const double* x, const double* p, Drawing* drawing) const {
    drawing->Circle(0, 0, p[1]);
    drawing->Circle(x[0], x[1], 0.03);
  }
};

// From nosnoc's examples. The radius with which the motion from (1/e, 0) has the given state at pi/2: 1.
inline HybridProblem SwitchedOscillatorProblem() {
  HybridProblem problem{
      .system = HybridSystem(SwitchedOscillator()),
      .guess = {.initial = {std::exp(-1.0), 0}, .parameters = {2 * M_PI, 1.02}, .duration = M_PI / 2},
      .terms = {MakeTerminalCost(0, -1.5974603774506981, 1.0, 2), MakeTerminalCost(1, 0.7614936206060115, 1.0, 2)}};
  problem.free.parameters = {1};
  return problem;
}

}  // namespace saltus
