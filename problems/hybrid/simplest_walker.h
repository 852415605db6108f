#pragma once

#include <array>
#include <cmath>

#include "saltus/hybrid/hybrid_problem.h"

namespace saltus {

// The simplest walking model, [q1 u1 q2 u2]: stance angle from the slope's normal, its rate, the angle between the
// legs, its rate; p = [gamma]. Unit length, gravity and mass of the hip. In mode early the feet pass each other.
struct SimplestWalker {
  static constexpr int kNumControls = 0;
  static constexpr int kNumParameters = 1;
  enum Mode { kEarly, kLate };
  static constexpr std::array kStateSizes = {4, 4};
  static constexpr std::array kNumGuards = {1, 1};
  static constexpr std::array<const char*, 2> kModeNames = {"early", "late"};
  static constexpr std::array<const char*, 2> kGuardNames = {"mid-stance", "heel strike"};
  static constexpr std::array<const char*, 4> kStateNames = {"q1", "u1", "q2", "u2"};
  static constexpr std::array<const char*, 1> kParameterNames = {"gamma"};

  template <typename T>
  void Flow(int, const T&, const T* x, const T*, const T* p, T* xdot) const {
    using std::cos, std::sin;
    xdot[0] = x[1];
    xdot[1] = sin(x[0] - p[0]);
    xdot[2] = x[3];
    xdot[3] = xdot[1] + (x[1] * x[1] - cos(x[0] - p[0])) * sin(x[2]);
  }
  template <typename T>
  T Guard(int mode, int, const T&, const T* x, const T*) const {
    if (mode == kEarly) return x[0] + 0.1;
    return 2.0 * x[0] - x[2];
  }
  template <typename T>
  int Reset(int mode, int, const T&, const T* x, const T*, T* x_plus) const {
    using std::cos;
    if (mode == kEarly) {
      for (int i = 0; i < 4; ++i) x_plus[i] = x[i];
      return kLate;
    }
    const T c = cos(2.0 * x[0]);
    x_plus[0] = -x[0];
    x_plus[1] = c * x[1];
    x_plus[2] = -2.0 * x[0];
    x_plus[3] = c * (1.0 - c) * x[1];
    return kEarly;
  }

  template <typename Drawing>
  void Draw(int, double, const double* x, const double* p, Drawing* drawing) const {
    const double c = std::cos(p[0]), s = std::sin(p[0]), hip_x = -std::sin(x[0]), hip_y = std::cos(x[0]);
    const double foot_x = hip_x + std::sin(x[0] - x[2]), foot_y = hip_y - std::cos(x[0] - x[2]);
    drawing->Line(-1.5 * c, 1.5 * s, 1.5 * c, -1.5 * s);
    drawing->Line(0, 0, c * hip_x + s * hip_y, c * hip_y - s * hip_x);
    drawing->Line(c * hip_x + s * hip_y, c * hip_y - s * hip_x, c * foot_x + s * foot_y, c * foot_y - s * foot_x);
    drawing->Circle(c * hip_x + s * hip_y, c * hip_y - s * hip_x, 0.05);
  }
};

// Garcia, Chatterjee, Ruina, Coleman 1998. From which q1 and u1 the stance leg has the given angle and rate after two
// heel strikes: 0.2 and -0.2.
inline HybridProblem SimplestWalkerProblem() {
  HybridProblem problem{
      .system = HybridSystem(SimplestWalker()),
      .guess = {.initial = {0.201, -0.201, 0.4, -0.0158}, .parameters = {0.009}, .duration = 9},
      .terms = {MakeTerminalCost(0, 0.050751984168550957, 1.0, 4), MakeTerminalCost(1, -0.072055493900475561, 1.0, 4)}};
  problem.free.initial = {0, 1};
  return problem;
}

}  // namespace saltus
