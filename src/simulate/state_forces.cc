#include "simulate/state_forces.h"

#include <ceres/jet.h>

#include <algorithm>

namespace saltus {

ForceAtState ForceAt(const StateForce& force, std::span<const double> x, int body_size) {
  using Jet = ceres::Jet<double, 4>;
  ForceAtState at;
  Vec2<Jet> value;
  const auto difference = [&](const Spring& spring, int j) {
    const double point = j < 2 ? spring.point[j] : 0.0;
    return Jet(x[body_size * spring.body + j] - (spring.to < 0 ? point : x[body_size * spring.to + j]), j);
  };
  if (const auto* drag = std::get_if<Drag>(&force)) {
    at.body = drag->body;
    for (int j = 0; j < 2; ++j) value[j] = -drag->linear * Jet(x[body_size * drag->body + 2 + j], 2 + j);
  } else {
    const auto& spring = std::get<Spring>(force);
    at.body = spring.body;
    at.other = spring.to;
    const Vec2<Jet> d(difference(spring, 0), difference(spring, 1)), w(difference(spring, 2), difference(spring, 3));
    if (spring.length == 0) {
      value = Scale(-spring.stiffness, d) - Scale(spring.damping, w);
    } else {
      const Jet distance = sqrt(d[0] * d[0] + d[1] * d[1]);
      const Vec2<Jet> n(d[0] / distance, d[1] / distance);
      value = Scale(Jet(-spring.stiffness * (distance - spring.length) - spring.damping * Dot(n, w)), n);
    }
  }
  for (int j = 0; j < 2; ++j) {
    at.value[j] = value[j].a;
    at.by.row(j) = value[j].v.transpose();
  }
  return at;
}

bool AreLinear(std::span<const StateForce> forces) {
  return std::ranges::all_of(forces, [](const StateForce& force) {
    const auto* spring = std::get_if<Spring>(&force);
    return spring == nullptr || spring->length == 0;
  });
}

}  // namespace saltus
