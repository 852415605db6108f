#pragma once

#include <array>
#include <cmath>

#include "saltus/hybrid/hybrid_problem.h"

namespace saltus {

// A rocking block, [theta omega]; p = [alpha p].
struct RockingBlock {
  bool linear = false;

  static constexpr int kNumControls = 0;
  static constexpr int kNumParameters = 2;
  enum Mode { kPositive, kNegative };
  static constexpr std::array kStateSizes = {2, 2};
  static constexpr std::array kNumGuards = {1, 1};
  static constexpr std::array<const char*, 2> kModeNames = {"pos", "neg"};
  static constexpr std::array<const char*, 2> kGuardNames = {"impact", "impact"};
  static constexpr std::array<const char*, 2> kStateNames = {"theta", "omega"};
  static constexpr std::array<const char*, 2> kParameterNames = {"alpha", "p"};

  template <typename T>
  void Flow(int mode, const T&, const T* x, const T*, const T* p, T* xdot) const {
    using std::sin;
    const T lever = mode == kPositive ? T(p[0] - x[0]) : T(p[0] + x[0]);
    const T fall = p[1] * p[1] * (linear ? lever : T(sin(lever)));
    xdot[0] = x[1];
    xdot[1] = mode == kPositive ? T(-fall) : fall;
  }
  template <typename T>
  T Guard(int mode, int, const T&, const T* x, const T*) const {
    return mode == kPositive ? x[0] : T(-x[0]);
  }
  template <typename T>
  int Reset(int mode, int, const T&, const T* x, const T* p, T* x_plus) const {
    using std::sin;
    const T s = sin(p[0]);
    x_plus[0] = T(0.0);
    x_plus[1] = (1.0 - 1.5 * s * s) * x[1];
    return 1 - mode;
  }

  template <typename Drawing>
  void Draw(int mode, double, const double* x, const double* p, Drawing* drawing) const {
    // A block of unit diagonal that turns about one corner or the other.
    const double half = std::sin(p[0]), height = 2 * std::cos(p[0]), c = std::cos(x[0]), s = std::sin(x[0]);
    const double pivot = mode == kPositive ? half : -half, left = -half - pivot, right = half - pivot;
    const auto edge = [&](double x0, double y0, double x1, double y1) {
      drawing->Line(pivot + c * x0 + s * y0, c * y0 - s * x0, pivot + c * x1 + s * y1, c * y1 - s * x1);
    };
    drawing->Line(-1, 0, 1, 0);
    edge(left, 0, right, 0);
    edge(right, 0, right, height);
    edge(right, height, left, height);
    edge(left, height, left, 0);
  }
};

// Housner 1963. From which angle a block is released that has the given angle and rate after six impacts: 0.2.
inline HybridProblem RockingBlockProblem() {
  HybridProblem problem{
      .system = HybridSystem(RockingBlock()),
      .guess = {.initial = {0.2005, 0}, .parameters = {0.25, 2}, .duration = 6.5},
      .terms = {MakeTerminalCost(0, 0.0408293336232718, 1.0, 2), MakeTerminalCost(1, -0.0287593129333273, 1.0, 2)}};
  problem.free.initial = {0};
  return problem;
}

}  // namespace saltus
