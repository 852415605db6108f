// The bounds on forces: of each component (Control::max), and of the length (Control::max_norm); and on torques
// (Control::max_torque).
#pragma once

#include <algorithm>
#include <cmath>
#include <limits>
#include <span>

#include "saltus/base/scalar.h"
#include "saltus/scene/geometry.h"
#include "saltus/scene/scene.h"

namespace saltus {

// Returns the force on pushed disc c within its bounds that is nearest to u.
template <typename T>
Vec2<T> NearestWithinBounds(const Control& control, int c, const Vec2<T>& u) {
  using std::sqrt;
  const double inf = std::numeric_limits<double>::infinity();
  const double most = control.max.empty() ? inf : control.max[c];
  const double norm = control.max_norm.empty() ? inf : control.max_norm[c];
  const auto clip = [&](const T& x) { return Value(x) > most ? T(most) : Value(x) < -most ? T(-most) : x; };
  const Vec2<T> in_box(clip(u[0]), clip(u[1]));
  if (Value(Dot(in_box, in_box)) <= norm * norm) return in_box;
  const Vec2<T> in_ball = Scale(T(norm / sqrt(Dot(u, u))), u);
  const bool fits = std::abs(Value(in_ball[0])) <= most && std::abs(Value(in_ball[1])) <= most;
  if (fits) return in_ball;
  // Where the circle meets the side of the box that u is further beyond.
  const double other = std::sqrt(std::max(0.0, norm * norm - most * most));
  const int d = std::abs(Value(in_ball[0])) > std::abs(Value(in_ball[1])) ? 0 : 1;
  Vec2<T> corner;
  corner[d] = T(std::copysign(most, Value(u[d])));
  corner[1 - d] = T(std::copysign(other, Value(u[1 - d])));
  return corner;
}

// Returns the bound on |torque / radius| of turned disc t, N; infinity without a bound.
inline double MaxTorqueForce(const Scene& scene, int t) {
  if (scene.control.max_torque.empty()) return std::numeric_limits<double>::infinity();
  return scene.control.max_torque[t] / scene.bodies[scene.control.torque_bodies[t]].radius;
}

// Moves the forces and torques of all intervals of a control within their bounds.
inline void MoveWithinBounds(const Scene& scene, std::span<double> control) {
  if (!scene.control.IsBounded()) return;
  for (size_t k = 0; k < control.size() / scene.control_width(); ++k) {
    for (int c = 0; c < scene.num_controlled(); ++c) {
      double* force = &control[scene.ForceIndex(k, c)];
      const Vec2d u = NearestWithinBounds<double>(scene.control, c, {force[0], force[1]});
      std::copy_n(u.data(), 2, force);
    }
    for (int t = 0; t < scene.num_torques(); ++t) {
      double& turn = control[scene.TorqueIndex(k, t)];
      turn = std::clamp(turn, -MaxTorqueForce(scene, t), MaxTorqueForce(scene, t));
    }
  }
}

}  // namespace saltus
