#pragma once

#include <ceres/autodiff_cost_function.h>

#include <array>
#include <memory>

#include "saltus/hybrid/hybrid_problem.h"

namespace saltus {

// A body above a foot, with a spring whose rest length r the control moves. Flight [y1 v1 y2 v2 r], stance [y1 v1 r].
struct TwoMassHopper {
  double m1 = 1, m2 = 0.25, k = 250, g = 9.81;

  static constexpr int kNumControls = 1;
  static constexpr int kNumParameters = 0;
  enum Mode { kFlight, kStance };
  static constexpr std::array kStateSizes = {5, 3};
  static constexpr std::array kNumGuards = {1, 1};
  static constexpr std::array<const char*, 2> kModeNames = {"flight", "stance"};
  static constexpr std::array<const char*, 2> kGuardNames = {"landing", "lift-off"};
  static constexpr std::array<const char*, 8> kStateNames = {"y1", "v1", "y2", "v2", "r", "y1", "v1", "r"};
  static constexpr std::array<const char*, 1> kControlNames = {"u"};

  template <typename T>
  void Flow(int mode, const T&, const T* x, const T* u, const T*, T* xdot) const {
    xdot[0] = x[1];
    if (mode == kStance) {
      xdot[1] = k / m1 * (x[2] - x[0]) - g;
      xdot[2] = u[0];
      return;
    }
    const T force = k * (x[4] - x[0] + x[2]);
    xdot[1] = force / m1 - g;
    xdot[2] = x[3];
    xdot[3] = -force / m2 - g;
    xdot[4] = u[0];
  }
  template <typename T>
  T Guard(int mode, int, const T&, const T* x, const T*) const {
    if (mode == kFlight) return x[2];
    return m2 * g + k * (x[2] - x[0]);
  }
  template <typename T>
  int Reset(int mode, int, const T&, const T* x, const T*, T* x_plus) const {
    x_plus[0] = x[0];
    x_plus[1] = x[1];
    if (mode == kFlight) {
      x_plus[2] = x[4];
      return kStance;
    }
    x_plus[2] = x_plus[3] = T(0.0);
    x_plus[4] = x[2];
    return kFlight;
  }

  template <typename Drawing>
  void Draw(int mode, double, const double* x, const double*, Drawing* drawing) const {
    const double foot = mode == kFlight ? x[2] : 0;
    drawing->Line(-0.3, 0, 0.3, 0);
    drawing->Line(0, foot, 0, x[0]);
    drawing->Circle(0, x[0], 0.08);
    drawing->Circle(0, foot, 0.04);
  }
};

// The rate of the rest length for a hop of 0.6 m (height of the apex of the centre of mass), with an effort of weight 1
// and a weight of 20 on the miss. The least loss is 0.0184634928516979.
struct MissOfHop {
  template <typename T>
  bool operator()(const T* x, T* residual) const {
    const TwoMassHopper hopper;
    const double m = hopper.m1 + hopper.m2;
    const T height = (hopper.m1 * x[0] + hopper.m2 * x[2]) / m, rate = (hopper.m1 * x[1] + hopper.m2 * x[3]) / m;
    residual[0] = std::sqrt(20.0) * (height + rate * rate / (2 * hopper.g) - 0.6);
    return true;
  }
};

inline HybridProblem TwoMassHopperProblem() {
  HybridProblem problem{.system = HybridSystem(TwoMassHopper()),
                        .guess = {.initial = {0.6, 0, 0.1, 0, 0.5}, .duration = 0.5, .num_intervals = 20},
                        .terms = {MakeEffortCost(1.0, 1)}};
  HybridTerm hop{.name = "hop", .mode = TwoMassHopper::kFlight, .with_state = true};
  hop.function = std::make_shared<ceres::AutoDiffCostFunction<MissOfHop, 1, 5>>(new MissOfHop);
  problem.terms.push_back(hop);
  problem.free.control = true;
  return problem;
}

}  // namespace saltus
