// A scene in other units and at another place: the same motion, loss and gradient, with other numbers.
#pragma once

#include <cmath>
#include <ostream>
#include <vector>

#include "saltus/scene/scene.h"

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
    body.inertia.moment *= by.mass * by.length * by.length;
    body.angular_velocity /= by.time;
  }
  const auto move = [&](Vec2d* point) { *point = by.length * *point + by.shift; };
  for (Plane& plane : scene.planes) move(&plane.point);
  for (EdgeSegment& segment : scene.segments) {
    move(&segment.from);
    move(&segment.to);
  }
  for (EdgePolygon& polygon : scene.polygons) {
    for (Vec2d& point : polygon.points) move(&point);
  }
  for (EdgeArc& arc : scene.arcs) {
    move(&arc.center);
    arc.radius *= by.length;
  }
  for (Pocket& pocket : scene.pockets) {
    move(&pocket.position);
    pocket.radius *= by.length;
  }
  if (scene.table) scene.table->gravity *= by.acceleration();
  scene.contact.stiffness *= by.force() / by.length;
  scene.contact.damping *= by.force() / by.speed();
  for (Vec2d& force : scene.control.initial) force *= by.force();
  for (double& most : scene.control.max) most *= by.force();
  for (double& most : scene.control.max_norm) most *= by.force();
  const auto size_of = [&](const auto& term) {
    const double sizes[] = {by.length, by.speed(), 1, 1 / by.time};  // by quantity
    return sizes[static_cast<int>(term.quantity)];
  };
  const auto convert = [&](const auto& term, Vec2d* target) {
    *target *= size_of(term);
    if (term.quantity == TerminalTerm::Quantity::kPosition) *target += by.shift;
  };
  for (TerminalTerm& term : scene.objective.terminal) {
    convert(term, &term.target);
    term.weight *= by.loss / (term.component ? size_of(term) : size_of(term) * size_of(term));
  }
  for (ViaTerm& term : scene.objective.via) {
    convert(term, &term.target);
    term.time *= by.time;
    term.weight *= by.loss / (size_of(term) * size_of(term));
  }
  for (RunningTerm& term : scene.objective.running) {
    for (Vec2d& target : term.targets) convert(term, &target);
    for (double& time : term.times) time *= by.time;
    term.weight *= by.loss / (size_of(term) * size_of(term) * by.time);
  }
  if (std::optional<FreeDuration>& free = scene.objective.duration) {
    free->min *= by.time;
    free->max *= by.time;
    free->weight *= by.loss / by.time;
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
