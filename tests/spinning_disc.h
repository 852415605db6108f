// A solid disc that spins.
#pragma once

#include "saltus/scene/scene.h"

namespace saltus {

inline Body Spinning(const char* name, double radius, double mass, const Vec2d& position, const Vec2d& velocity,
                     double spin) {
  return {.name = name,
          .radius = radius,
          .mass = mass,
          .position = position,
          .velocity = velocity,
          .inertia = {Inertia::Kind::kSolid},
          .angular_velocity = spin};
}

}  // namespace saltus
