#pragma once

#include <array>

#include "saltus/hybrid/hybrid_problem.h"

namespace saltus {

// A bouncing ball: height and velocity [y v], m and m/s; p = [g e]; f: force per mass.
struct BouncingBall {
  static constexpr int kNumControls = 1;
  static constexpr int kNumParameters = 2;
  static constexpr std::array kStateSizes = {2};
  static constexpr std::array kNumGuards = {1};
  static constexpr std::array<const char*, 1> kControlNames = {"f"};
  static constexpr std::array<const char*, 1> kModeNames = {"flight"};
  static constexpr std::array<const char*, 1> kGuardNames = {"ground"};
  static constexpr std::array<const char*, 2> kStateNames = {"y", "v"};
  static constexpr std::array<const char*, 2> kParameterNames = {"g", "e"};

  template <typename T>
  void Flow(int, const T&, const T* x, const T* u, const T* p, T* xdot) const {
    xdot[0] = x[1];
    xdot[1] = u[0] - p[0];
  }
  template <typename T>
  T Guard(int, int, const T&, const T* x, const T*) const {
    return x[0];
  }
  template <typename T>
  int Reset(int, int, const T&, const T* x, const T* p, T* x_plus) const {
    x_plus[0] = T(0.0);
    x_plus[1] = -p[1] * x[1];
    return 0;
  }

  // A common scheme, for --audit: semi-implicit Euler, and the reset at the end of the step that ends below the ground.
  // Its derivative does not depend on when in the step the ball met the ground.
  template <typename T>
  int Step(int, const T&, const T* x, const T* u, const T* p, const T& h, T* next) const {
    next[1] = x[1] + h * (u[0] - p[0]);
    next[0] = x[0] + h * next[1];
    if (next[0] < 0.0 && next[1] < 0.0) {
      next[0] = T(0.0);
      next[1] = -p[1] * next[1];
    }
    return 0;
  }

  template <typename Drawing>
  void Draw(int, double, const double* x, const double*, Drawing* drawing) const {
    drawing->Line(-1, 0, 1, 0);
    drawing->Circle(0, x[0], 0.02);
  }
};

// The example of the SciML sensitivity tutorials: the restitution with which the ball is at 20 m after 15 s. The
// published answer, 0.8666, is a local minimum with a loss of 0.3995; at 0.988008392024877 the loss is 0.
inline HybridProblem BouncingBallProblem() {
  HybridProblem problem{.system = HybridSystem(BouncingBall()),
                        .guess = {.initial = {50, 0}, .parameters = {9.8, 0.98}, .duration = 15},
                        .terms = {MakeTerminalCost(0, 20.0, 1.0, 2)}};
  problem.free.parameters = {1};
  problem.free.parameters_min = {0.75};
  problem.free.parameters_max = {1};
  return problem;
}

}  // namespace saltus
