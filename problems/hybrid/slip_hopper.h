#pragma once

#include <array>
#include <cmath>

#include "saltus/hybrid/hybrid_problem.h"

namespace saltus {

// The SLIP hopper. Flight [x y vx vy], stance [x - xf, y, vx, vy, xf]; p = [k theta].
struct SlipHopper {
  double m = 1, l0 = 1, g = 10;

  static constexpr int kNumControls = 0;
  static constexpr int kNumParameters = 2;
  enum Mode { kDown, kStance, kUp };
  static constexpr std::array kStateSizes = {4, 5, 4};
  static constexpr std::array kNumGuards = {1, 1, 1};
  static constexpr std::array<const char*, 3> kGuardNames = {"touch-down", "lift-off", "apex"};
  static constexpr std::array<const char*, 13> kStateNames = {
      "x", "y", "vx", "vy", "xr", "y", "vx", "vy", "xf", "x", "y", "vx", "vy"};
  static constexpr std::array<const char*, 2> kParameterNames = {"k", "theta"};
  static constexpr std::array<const char*, 3> kModeNames = {"down", "stance", "up"};

  template <typename T>
  void Flow(int mode, const T&, const T* x, const T*, const T* p, T* xdot) const {
    using std::sqrt;
    xdot[0] = x[2];
    xdot[1] = x[3];
    xdot[2] = T(0.0);
    xdot[3] = T(-g);
    if (mode != kStance) return;
    const T spring = p[0] / m * (l0 / sqrt(x[0] * x[0] + x[1] * x[1]) - 1.0);
    xdot[2] = spring * x[0];
    xdot[3] = spring * x[1] - g;
    xdot[4] = T(0.0);
  }
  template <typename T>
  T Guard(int mode, int, const T&, const T* x, const T* p) const {
    using std::cos;
    if (mode == kDown) return x[1] - l0 * cos(p[1]);
    if (mode == kStance) return l0 * l0 - x[0] * x[0] - x[1] * x[1];
    return x[3];
  }
  template <typename T>
  int Reset(int mode, int, const T&, const T* x, const T* p, T* x_plus) const {
    using std::cos, std::sin;
    for (int i = 0; i < 4; ++i) x_plus[i] = x[i];
    if (mode == kUp) return kDown;
    if (mode == kStance) {
      x_plus[0] = x[0] + x[4];
      return kUp;
    }
    x_plus[0] = -l0 * sin(p[1]);
    x_plus[1] = l0 * cos(p[1]);
    x_plus[4] = x[0] + l0 * sin(p[1]);
    return kStance;
  }

  template <typename Drawing>
  void Draw(int mode, double, const double* x, const double* p, Drawing* drawing) const {
    const double body_x = mode == kStance ? x[0] + x[4] : x[0];
    const double foot_x = mode == kStance ? x[4] : x[0] + l0 * std::sin(p[1]);
    const double foot_y = mode == kStance ? 0 : x[1] - l0 * std::cos(p[1]);
    drawing->Line(-1, 0, 4, 0);
    drawing->Line(body_x, x[1], foot_x, foot_y);
    drawing->Circle(body_x, x[1], 0.1);
  }
};

// Schwind 1998. The stiffness and the angle of the leg with which the third stance has the given state at 2.1 s: 100
// N/m and 10 degrees.
inline HybridProblem SlipHopperProblem() {
  HybridProblem problem{
      .system = HybridSystem(SlipHopper()),
      .guess = {.initial = {0, 1.18, 1.02, -0.1}, .parameters = {100.5, 10.05 * M_PI / 180}, .duration = 2.1},
      .terms = {MakeTerminalCost(0, 0.1434523421370905, 1.0, 5, SlipHopper::kStance),
                MakeTerminalCost(1, 0.8489130552112413, 1.0, 5, SlipHopper::kStance)}};
  problem.free.parameters = {0, 1};
  return problem;
}

}  // namespace saltus
