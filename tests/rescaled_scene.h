// A scene in other units and at another place: the same motion, loss and gradient, with other numbers.
#pragma once

#include <cmath>
#include <ostream>
#include <vector>

#include "saltus/physics/scene.h"

namespace saltus {

// The numbers that a factor multiplies, and where the origin goes.
struct Rescaling {
  const char* name;
  double length = 1, time = 1, mass = 1, loss = 1;
  Vec2d shift = Vec2d::Zero();  // in the new lengths

  double speed() const { return length / time; }
  double acceleration() const { return speed() / time; }
  double force() const { return mass * acceleration(); }

  friend void PrintTo(const Rescaling& by, std::ostream* os) { *os << by.name; }
};

inline Scene Rescaled(Scene scene, const Rescaling& by) {
  scene.duration *= by.time;
  scene.gravity *= by.acceleration();
  for (Body& body : scene.bodies) {
    body.radius *= by.length;
    body.mass *= by.mass;
    body.position = by.length * body.position + by.shift;
    body.velocity *= by.speed();
  }
  for (Plane& plane : scene.planes) plane.point = by.length * plane.point + by.shift;
  scene.contact.stiffness *= by.force() / by.length;
  scene.contact.damping *= by.force() / by.speed();
  for (Vec2d& force : scene.control.initial) force *= by.force();
  for (TerminalTerm& term : scene.objective.terminal) {
    const bool position = term.quantity == TerminalTerm::Quantity::kPosition;
    const double size = position ? by.length : by.speed();
    term.target = size * term.target;
    if (position) term.target += by.shift;
    term.weight *= by.loss / (term.component ? size : size * size);
  }
  scene.objective.effort *= by.loss / (by.force() * by.force() * by.time);
  return scene;
}

inline double Power(int exponent) { return std::ldexp(1.0, exponent); }

// Powers of two, which change no bit of any number; and shifts by a power of two, which change few.
inline std::vector<Rescaling> LossRescalings() {
  return {{.name = "small_loss", .loss = Power(-30)}, {.name = "large_loss", .loss = Power(30)}};
}
inline std::vector<Rescaling> UnitRescalings() {
  return {{.name = "short", .length = Power(-20)},
          {.name = "long", .length = Power(20)},
          {.name = "brief", .time = Power(-20)},
          {.name = "lasting", .time = Power(20)},
          {.name = "light", .mass = Power(-10)},
          {.name = "heavy", .mass = Power(10)},
          {.name = "all", .length = Power(-20), .time = Power(-12), .mass = Power(10), .loss = Power(-30)},
          {.name = "all_else", .length = Power(20), .time = Power(13), .mass = Power(-10), .loss = Power(30)}};
}

}  // namespace saltus
