#pragma once

#include <array>
#include <cmath>

#include "saltus/hybrid/hybrid_problem.h"

namespace saltus {

// A ball on a paddle at A sin(omega t); p = [A omega g e].
struct JuggledBall {
  static constexpr int kNumControls = 0;
  static constexpr int kNumParameters = 4;
  static constexpr std::array kStateSizes = {2};
  static constexpr std::array kNumGuards = {1};
  static constexpr std::array<const char*, 1> kModeNames = {"flight"};
  static constexpr std::array<const char*, 1> kGuardNames = {"paddle"};
  static constexpr std::array<const char*, 2> kStateNames = {"y", "v"};
  static constexpr std::array<const char*, 4> kParameterNames = {"A", "omega", "g", "e"};

  template <typename T>
  void Flow(int, const T&, const T* x, const T*, const T* p, T* xdot) const {
    xdot[0] = x[1];
    xdot[1] = -p[2];
  }
  template <typename T>
  T Guard(int, int, const T& t, const T* x, const T* p) const {
    using std::sin;
    return x[0] - p[0] * sin(p[1] * t);
  }
  template <typename T>
  int Reset(int, int, const T& t, const T* x, const T* p, T* x_plus) const {
    using std::cos, std::sin;
    x_plus[0] = p[0] * sin(p[1] * t);
    x_plus[1] = -p[3] * x[1] + (1.0 + p[3]) * p[0] * p[1] * cos(p[1] * t);
    return 0;
  }

  template <typename Drawing>
  void Draw(int, double t, const double* x, const double* p, Drawing* drawing) const {
    const double paddle = p[0] * std::sin(p[1] * t);
    drawing->Line(-0.1, paddle, 0.1, paddle);
    drawing->Circle(0, x[0] + 0.01, 0.01);
  }
};

// The amplitude and the angular frequency of the paddle with which the ball has the given state after four impacts:
// 0.025 m and 4 pi.
inline HybridProblem JuggledBallProblem() {
  HybridProblem problem{
      .system = HybridSystem(JuggledBall()),
      .guess = {.initial = {0.35, 1}, .parameters = {0.0252, 12.57, 9.81, 0.8}, .duration = 1.7},
      .terms = {MakeTerminalCost(0, 0.0882723123904866, 1.0, 2), MakeTerminalCost(1, -0.0368598216866247, 1.0, 2)}};
  problem.free.parameters = {0, 1};
  return problem;
}

}  // namespace saltus
