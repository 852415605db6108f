#pragma once

#include <array>

#include "saltus/hybrid/hybrid_problem.h"

namespace saltus {

// A car with a turbo, [q v]: v' = u, and 3 u above a speed.
struct TurboCar {
  static constexpr int kNumControls = 1;
  static constexpr int kNumParameters = 0;
  enum Mode { kNominal, kTurbo };
  static constexpr std::array kStateSizes = {2, 2};
  static constexpr std::array kNumGuards = {1, 1};
  static constexpr std::array<const char*, 2> kModeNames = {"nominal", "turbo"};
  static constexpr std::array<const char*, 2> kGuardNames = {"on", "off"};
  static constexpr std::array<const char*, 2> kStateNames = {"q", "v"};
  static constexpr std::array<const char*, 1> kControlNames = {"u"};
  double on = 10, off = 10;  // m/s

  template <typename T>
  void Flow(int mode, const T&, const T* x, const T* u, const T*, T* xdot) const {
    xdot[0] = x[1];
    xdot[1] = (mode == kTurbo ? 3.0 : 1.0) * u[0];
  }
  template <typename T>
  T Guard(int mode, int, const T&, const T* x, const T*) const {
    return mode == kNominal ? T(on - x[1]) : T(x[1] - off);
  }
  template <typename T>
  int Reset(int mode, int, const T&, const T* x, const T*, T* x_plus) const {
    x_plus[0] = x[0];
    x_plus[1] = x[1];
    return 1 - mode;
  }

  template <typename Drawing>
  void Draw(int, double, const double* x, const double*, Drawing* drawing) const {
    drawing->Line(-5, 0, 205, 0);
    drawing->Line(x[0] - 2, 1, x[0] + 2, 1);
  }
};

// From nosnoc's examples, with a fixed time: 200 m in 40/3 s, at rest at both ends, with the least effort.
inline HybridProblem TurboCarProblem() {
  HybridProblem problem{
      .system = HybridSystem(TurboCar()),
      .guess = {.initial = {0, 0}, .duration = 40.0 / 3, .num_intervals = 10},
      .terms = {MakeTerminalCost(0, 200.0, 1.0, 2), MakeTerminalCost(1, 0.0, 10.0, 2), MakeEffortCost(0.01, 1)}};
  problem.guess.control = {4, 4, 4, 1, 1, -1, -1, -4, -4, -4};
  problem.free.control = true;
  problem.free.control_min = {-5};
  problem.free.control_max = {5};
  return problem;
}

}  // namespace saltus
