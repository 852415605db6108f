// The scenes that data/exact_references.json has values for, and a reader for those values.
#pragma once

#include <algorithm>
#include <cmath>
#include <nlohmann/json.hpp>

#include "reference_values.h"
#include "saltus/scene/scene.h"

namespace saltus::exact_test {

inline const nlohmann::json& References() { return ReferenceFile("exact_references.json"); }
inline Vec2d Vector(const nlohmann::json& value) { return {Number(value[0]), Number(value[1])}; }

inline double RelativeError(double actual, double expected) {
  return std::abs(actual - expected) / std::max(1e-300, std::abs(expected));
}

constexpr double kTolerance = 1e-12;

#define EXPECT_RELATIVE(actual, expected) \
  EXPECT_LT(RelativeError(actual, expected), exact_test::kTolerance) << (actual) << " is not " << (expected)

inline Body Disc(const char* name, double radius, const Vec2d& position, const Vec2d& velocity = Vec2d::Zero()) {
  Body body;
  body.name = name;
  body.radius = radius;
  body.position = position;
  body.velocity = velocity;
  return body;
}

inline TerminalTerm ReachTerm(int body, const Vec2d& target) {
  TerminalTerm term;
  term.body = body;
  term.target = target;
  return term;
}

inline Scene BounceOnce() {
  Scene scene;
  scene.steps = 480;
  scene.bodies = {Disc("ball", 0.1, {-1, 1}, {2, -2})};
  scene.planes = {{"ground", {0, 0}, {0, 1}}};
  scene.control = {{0}, {{0, 0}}};
  TerminalTerm height;
  height.component = 1;
  scene.objective.terminal = {height};
  return scene;
}

inline Scene GroundWall(double friction) {
  Scene scene;
  scene.duration = 0.6;
  scene.steps = 288;
  scene.gravity = {0, -9.8};
  scene.bodies = {Disc("ball", 0.1, {-0.5, 1}, {5, -5})};
  scene.planes = {{"ground", {0, 0}, {0, 1}}, {"wall", {1.75, 0}, {-1, 0}}};
  scene.contact.restitution = 0.92;
  scene.contact.friction = friction;
  scene.objective.terminal = {ReachTerm(0, {-2, 1.5})};
  return scene;
}

inline Scene TwoDiscScene(const Vec2d& first, const Vec2d& second, const Vec2d& force, double effort, int steps) {
  Scene scene;
  scene.steps = steps;
  scene.bodies = {Disc("striker", 0.2, first), Disc("target", 0.2, second)};
  scene.control = {{0}, {force}};
  scene.objective.terminal = {ReachTerm(1, {0, 0})};
  scene.objective.effort = effort;
  return scene;
}

inline Scene TwoBalls(int steps = 480) { return TwoDiscScene({-2, -2}, {-1, -1}, {3, 3}, 0.1, steps); }
inline Scene SingleCollision(int steps = 480) { return TwoDiscScene({-1, -2}, {-1, -1}, {0, 3}, 0.01, steps); }
inline Scene MultipleCollisions(int steps = 480) {
  Scene scene = TwoDiscScene({0.25, -0.3}, {-0.5, 0.6}, {-3.5, 3}, 0.01, steps);
  scene.planes = {{"wall", {0, 1}, {0, -1}}};
  return scene;
}

// df/dx at 0 from central differences of widths h, h/2, h/4 (Richardson). Error about h^6 f^(7).
template <typename F>
double Richardson(const F& f, double h) {
  const auto central = [&](double w) { return (f(w) - f(-w)) / (2 * w); };
  const double a = central(h), b = central(h / 2), c = central(h / 4);
  const double ab = (4 * b - a) / 3, bc = (4 * c - b) / 3;
  return (16 * bc - ab) / 15;
}

}  // namespace saltus::exact_test
