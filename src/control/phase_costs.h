// Costs of discs in a step of free flight, at the end and at the start, as functions for Ceres. Templates on T, double
// or a Jet. SI units, or any others that fit.
#pragma once

#include <ceres/dynamic_autodiff_cost_function.h>

#include <array>
#include <cmath>
#include <memory>
#include <optional>
#include <utility>
#include <vector>

#include "saltus/scene/scene.h"
#include "simulate/flight.h"

namespace saltus {

// Makes a cost function of blocks of these sizes.
template <typename F>
std::shared_ptr<const ceres::CostFunction> MakeFunction(F function, const std::vector<int>& blocks, int rows) {
  auto made = std::make_shared<ceres::DynamicAutoDiffCostFunction<F, 4>>(new F(std::move(function)));
  for (const int block : blocks) made->AddParameterBlock(block);
  made->SetNumResiduals(rows);
  return made;
}

// A running term over a step: costs whose squares sum up to the integral, exact but where the target turns. Blocks:
// [x y v_x v_y] at the beginning, force if the disc is pushed, the time there, the length.
struct RunningCost {
  Vec2d gravity;
  double inverse_mass;
  bool pushed;
  RunningTerm term;
  static constexpr int kRows = 6;

  template <typename T>
  bool operator()(T const* const* blocks, T* rows) const {
    using std::sqrt;
    const T *x = blocks[0], *force = pushed ? blocks[1] : nullptr;
    const T &time = *blocks[pushed ? 2 : 1], &h = *blocks[pushed ? 3 : 2];
    for (size_t i = 0; i < kGaussNodes.size(); ++i) {
      const T s = kGaussNodes[i] * h;
      const Vec2<T> target = TargetAt(term, T(time + s));
      const T scale = std::sqrt(term.weight * kGaussWeights[i]) * sqrt(h);
      for (int j = 0; j < 2; ++j) {
        T a(gravity[j]);
        if (pushed) a += inverse_mass * force[j];
        const bool position = term.quantity == TerminalTerm::Quantity::kPosition;
        const T there = position ? T(x[j] + s * (x[2 + j] + 0.5 * s * a)) : T(x[2 + j] + s * a);
        *rows++ = scale * (there - target[j]);
      }
    }
    return true;
  }
};

// That the speed is at most `most`. Block: [x y v_x v_y]. Row: an inequality, smooth where the disc is at rest, of
// slope one at the bound, and linear far beyond it.
struct SpeedBound {
  double most;
  static constexpr int kRows = 1;
  template <typename T>
  bool operator()(T const* const* blocks, T* rows) const {
    using std::sqrt;
    const T* v = blocks[0] + 2;
    rows[0] = sqrt(2.0 * (v[0] * v[0] + v[1] * v[1] + most * most)) - 2 * most;
    return true;
  }
};

// Row, an inequality: how much nearer than at a touch two are, of their contact distance. Blocks: [x y v_x v_y] of each
// disc.
struct StartGap {
  double contact_distance;
  std::optional<HalfPlane<double>> plane = {};  // in the place of b
  static constexpr int kRows = 1;

  template <typename T>
  bool operator()(T const* const* x, T* rows) const {
    const Vec2<T> a(x[0][0], x[0][1]);
    const Separation<T> apart = plane ? Separate<T>(a, *plane) : Separate<T>(a, Vec2<T>(x[1][0], x[1][1]));
    rows[0] = 1.0 - apart.distance / contact_distance;
    return true;
  }
};

// sqrt(weight T), so that the loss gains weight T. Block: the final time.
struct DurationCost {
  double weight;
  static constexpr int kRows = 1;
  template <typename T>
  bool operator()(const T* end, T* rows) const {
    using std::sqrt;
    if (!(Value(end[0]) > 0)) return false;
    rows[0] = sqrt(weight * end[0]);
    return true;
  }
};

}  // namespace saltus
