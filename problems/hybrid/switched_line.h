#pragma once

#include <ceres/autodiff_cost_function.h>

#include <array>
#include <cmath>
#include <memory>

#include "saltus/hybrid/hybrid_problem.h"

namespace saltus {

// Where x' changes from 3 to 1, [x z] with z = int x^2 dt.
struct SwitchedLine {
  static constexpr int kNumControls = 0;
  static constexpr int kNumParameters = 0;
  static constexpr std::array kStateSizes = {2, 2};
  static constexpr std::array kNumGuards = {1, 0};
  static constexpr std::array<const char*, 2> kModeNames = {"neg", "pos"};
  static constexpr std::array<const char*, 1> kGuardNames = {"zero"};
  static constexpr std::array<const char*, 2> kStateNames = {"x", "z"};

  template <typename T>
  void Flow(int mode, const T&, const T* x, const T*, const T*, T* xdot) const {
    xdot[0] = T(mode == 0 ? 3.0 : 1.0);
    xdot[1] = x[0] * x[0];
  }
  template <typename T>
  T Guard(int, int, const T&, const T* x, const T*) const {
    return -x[0];
  }
  template <typename T>
  int Reset(int, int, const T&, const T* x, const T*, T* x_plus) const {
    x_plus[0] = x[0];
    x_plus[1] = x[1];
    return 1;
  }
};

// int x^2 dt is the second component of the state; its root is the residual.
struct RootOfIntegral {
  template <typename T>
  bool operator()(const T* x, T* residual) const {
    using std::sqrt;
    residual[0] = sqrt(x[1]);
    return true;
  }
};

// Stewart, Anitescu 2010: the start x0 with the least int x^2 dt + (x(2) - 5/3)^2. The optimum is (9 - sqrt(417))/8,
// with a loss of 1.523772775374957.
inline HybridProblem SwitchedLineProblem() {
  HybridProblem problem{.system = HybridSystem(SwitchedLine()),
                        .guess = {.initial = {-1, 0}, .duration = 2},
                        .terms = {MakeTerminalCost(0, 5.0 / 3, 1.0, 2)}};
  HybridTerm integral{.name = "integral of x^2", .with_state = true};
  integral.function = std::make_shared<ceres::AutoDiffCostFunction<RootOfIntegral, 1, 2>>(new RootOfIntegral);
  problem.terms.push_back(integral);
  problem.free.initial = {0};
  return problem;
}

}  // namespace saltus
