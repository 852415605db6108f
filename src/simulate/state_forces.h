// The forces of a scene that depend on the state (Scene::forces).
#pragma once

#include <Eigen/Core>
#include <span>

#include "saltus/scene/scene.h"

namespace saltus {

// A force on a disc, and the opposite one on another disc, with its derivative by the state of the first, [p v], N/m
// and N s/m; that by the state of the other is the opposite.
struct ForceAtState {
  int body = 0, other = -1;  // other: -1 if there is none
  Vec2d value;
  Eigen::Matrix<double, 2, 4> by;
};

// Returns a force at a state, in which each disc has `body_size` numbers, [p_x p_y v_x v_y ...]. It is not a number
// where a spring with a length has none.
ForceAtState ForceAt(const StateForce& force, std::span<const double> x, int body_size);

// Whether all forces are affine functions of the state, so that flights have closed forms.
bool AreLinear(std::span<const StateForce> forces);

}  // namespace saltus
