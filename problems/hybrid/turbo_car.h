#pragma once

#include <ceres/autodiff_cost_function.h>

#include <array>
#include <memory>

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

struct LargestSpeed {
  double limit;  // m/s
  template <typename T>
  bool operator()(const T* x, T* residual) const {
    residual[0] = (x[1] - limit) / limit;
    return true;
  }
};

// From nosnoc's examples: 200 m in the least time, from rest to rest, with |u| <= 5 m/s^2. The optimum is 40/3 s: full
// thrust, cruise at the limit and full brake; of 21 intervals 14 are with the turbo, so that the control switches at
// the end of one.
inline HybridProblem TurboCarProblem(const TurboCar& car = {}, double goal = 200, double limit = 20) {
  constexpr int kIntervals = 21;
  HybridProblem problem{
      .system = HybridSystem(car),
      .guess = {.initial = {0, 0}, .duration = 14, .num_intervals = kIntervals},
      .terms = {MakeDurationCost(1.0), MakeTerminalCost(0, goal, 1e-4, 2), MakeTerminalCost(1, 0.0, 1e-2, 2)}};
  for (int k = 0; k < kIntervals; ++k) problem.guess.control.push_back(2 * k < kIntervals ? 2.5 : -2.5);
  for (int i : {1, 2}) problem.terms[i].role = HybridTerm::Role::kEquality;
  problem.terms.push_back(
      {.name = "speed limit",
       .at = HybridTerm::Timing::kEachInterval,
       .role = HybridTerm::Role::kInequality,
       .with_state = true,
       .function = std::make_shared<ceres::AutoDiffCostFunction<LargestSpeed, 1, 2>>(new LargestSpeed{limit})});
  problem.free = {.control = true, .control_min = {-5}, .control_max = {5}, .duration = true};
  problem.free.duration_min = 5;
  problem.free.duration_max = 30;
  return problem;
}

}  // namespace saltus
