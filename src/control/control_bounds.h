// The bounds on forces: of each component (Control::max), and of the length (Control::max_norm).
#pragma once

#include <algorithm>
#include <cmath>
#include <limits>
#include <span>

#include "saltus/physics/geometry.h"
#include "saltus/physics/scalar.h"
#include "saltus/physics/scene.h"

namespace saltus {

inline bool HasBounds(const Control& control) { return !control.max.empty() || !control.max_norm.empty(); }

// The force on pushed disc c within its bounds that is nearest to u.
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

// All forces of a control (K x C x 2) at once.
inline void MoveWithinBounds(const Control& bounds, std::span<double> control) {
  if (!HasBounds(bounds)) return;
  const size_t pushed = bounds.bodies.size();
  for (size_t k = 0; k < control.size() / 2; ++k) {
    const Vec2d u =
        NearestWithinBounds<double>(bounds, static_cast<int>(k % pushed), {control[2 * k], control[2 * k + 1]});
    control[2 * k] = u[0];
    control[2 * k + 1] = u[1];
  }
}

}  // namespace saltus
