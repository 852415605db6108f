#pragma once

#include <array>
#include <cmath>

#include "saltus/hybrid/hybrid_problem.h"

namespace saltus {

// A cart-pole between two walls, [x theta v omega]; u: force on the cart; p = [e].
struct CartPole {
  double M = 1, m = 0.3, l = 0.5, g = 9.81, w = 0.6;

  static constexpr int kNumControls = 1;
  static constexpr int kNumParameters = 1;
  static constexpr std::array kStateSizes = {4};
  static constexpr std::array kNumGuards = {2};
  static constexpr std::array<const char*, 1> kModeNames = {"free"};
  static constexpr std::array<const char*, 2> kGuardNames = {"right wall", "left wall"};
  static constexpr std::array<const char*, 4> kStateNames = {"x", "theta", "v", "omega"};
  static constexpr std::array<const char*, 1> kControlNames = {"u"};
  static constexpr std::array<const char*, 1> kParameterNames = {"e"};

  template <typename T>
  void Flow(int, const T&, const T* x, const T* u, const T*, T* xdot) const {
    using std::cos, std::sin;
    const T s = sin(x[1]), c = cos(x[1]);
    const T a = (u[0] + m * l * s * x[3] * x[3] - m * g * s * c) / (M + m * s * s);
    xdot[0] = x[2];
    xdot[1] = x[3];
    xdot[2] = a;
    xdot[3] = (g * s - c * a) / l;
  }
  template <typename T>
  T Guard(int, int guard, const T&, const T* x, const T*) const {
    return guard == 0 ? T(w - x[0]) : T(w + x[0]);
  }
  template <typename T>
  int Reset(int, int, const T&, const T* x, const T* p, T* x_plus) const {
    using std::cos;
    x_plus[0] = x[0];
    x_plus[1] = x[1];
    x_plus[2] = -p[0] * x[2];
    x_plus[3] = x[3] + (1.0 + p[0]) * x[2] * cos(x[1]) / l;
    return 0;
  }

  template <typename Drawing>
  void Draw(int, double, const double* x, const double*, Drawing* drawing) const {
    drawing->Line(-w, -0.1, -w, 0.7);
    drawing->Line(w, -0.1, w, 0.7);
    drawing->Line(x[0] - 0.1, 0, x[0] + 0.1, 0);
    drawing->Line(x[0], 0, x[0] - l * std::sin(x[1]), l * std::cos(x[1]));
    drawing->Circle(x[0] - l * std::sin(x[1]), l * std::cos(x[1]), 0.03);
  }
};

// The restitution with which a motion that meets the walls three times ends where it does with e = 0.8.
inline HybridProblem CartPoleWallsProblem() {
  HybridProblem problem{
      .system = HybridSystem(CartPole()),
      .guess = {.initial = {0.1, 0.4, 1.2, -0.3}, .parameters = {0.75}, .duration = 2, .num_intervals = 20},
      .terms = {MakeTerminalCost(0, -0.29906553238588283639, 1.0, 4),
                MakeTerminalCost(1, -0.19669431314799779745, 1.0, 4),
                MakeTerminalCost(2, -2.5487788682324296123, 1.0, 4),
                MakeTerminalCost(3, -3.0267410664953559377, 1.0, 4)}};
  problem.guess.control = {6, 5, 3, 1, -2, -4, -5, -5, -3, 0, 2, 4, 5, 5, 4, 2, 0, -1, -2, -2};
  problem.free.parameters = {0};
  problem.free.parameters_min = {0};
  problem.free.parameters_max = {1};
  return problem;
}

}  // namespace saltus
