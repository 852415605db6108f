#pragma once

#include <array>
#include <cmath>

#include "saltus/hybrid/hybrid_problem.h"

namespace saltus {

// A rimless wheel on a slope: angle of the stance spoke from the slope's normal, and its rate [q u]; p = [lambda^2 mu
// gamma].
struct RimlessWheel {
  int spokes = 6;

  static constexpr int kNumControls = 0;
  static constexpr int kNumParameters = 3;
  static constexpr std::array kStateSizes = {2};
  static constexpr std::array kNumGuards = {1};
  static constexpr std::array<const char*, 1> kModeNames = {"stance"};
  static constexpr std::array<const char*, 1> kGuardNames = {"heel strike"};
  static constexpr std::array<const char*, 2> kStateNames = {"q", "u"};
  static constexpr std::array<const char*, 3> kParameterNames = {"lambda2", "mu", "gamma"};

  template <typename T>
  void Flow(int, const T&, const T* x, const T*, const T* p, T* xdot) const {
    using std::sin;
    xdot[0] = x[1];
    xdot[1] = p[0] * sin(x[0] + p[2]);
  }
  template <typename T>
  T Guard(int, int, const T&, const T* x, const T*) const {
    return M_PI / spokes - x[0];
  }
  template <typename T>
  int Reset(int, int, const T&, const T* x, const T* p, T* x_plus) const {
    x_plus[0] = -x[0];
    x_plus[1] = p[1] * x[1];
    return 0;
  }

  template <typename Drawing>
  void Draw(int, double, const double* x, const double* p, Drawing* drawing) const {
    // In the frame of the slope, which falls by gamma to the right.
    const double c = std::cos(p[2]), s = std::sin(p[2]), hub_x = std::sin(x[0]), hub_y = std::cos(x[0]);
    drawing->Line(-2 * c, 2 * s, 2 * c, -2 * s);
    for (int k = 0; k < spokes; ++k) {
      const double angle = x[0] + 2 * M_PI * k / spokes;
      const double tip_x = hub_x - std::sin(angle), tip_y = hub_y - std::cos(angle);
      drawing->Line(c * hub_x + s * hub_y, c * hub_y - s * hub_x, c * tip_x + s * tip_y, c * tip_y - s * tip_x);
    }
  }
};

// McGeer 1990; Coleman 1998. From which angle and rate the wheel has the given ones after three impacts: -0.1 and 0.5.
inline HybridProblem RimlessWheelProblem() {
  HybridProblem problem{
      .system = HybridSystem(RimlessWheel()),
      .guess = {.initial = {-0.12, 0.52}, .parameters = {2.0 / 3, 2.0 / 3, 0.2}, .duration = 6},
      .terms = {MakeTerminalCost(0, -0.2391450361400704, 1.0, 2), MakeTerminalCost(1, 0.3905969912118348, 1.0, 2)}};
  problem.free.initial = {0, 1};
  return problem;
}

}  // namespace saltus
