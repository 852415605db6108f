#include "scene/scene_generators.h"

#include <glog/logging.h>

#include <cmath>
#include <numbers>
#include <string>

#include "base/random.h"

namespace saltus {
namespace {

void ExpectInRange(bool in_range) { CHECK(in_range) << "an option of the scene is out of range"; }

// Adds the mean squared distance of all discs from `target` to the loss.
void AimAt(const Vec2d& target, Scene* scene) {
  for (int i = 0; i < scene->num_bodies(); ++i) {
    scene->objective.terminal.push_back({.body = i,
                                         .quantity = TerminalTerm::Quantity::kPosition,
                                         .target = target,
                                         .weight = 1.0 / scene->num_bodies()});
  }
  scene->objective.effort = 0.1;
  scene->control = {{0}, {Vec2d::Zero()}};
  scene->optimize = Optimize::kVelocity;
}

}  // namespace

Scene GasInABox(const GasOptions& options, std::uint64_t seed) {
  ExpectInRange(options.discs >= 1 && options.discs <= 100000 && options.radius > 0);
  ExpectInRange(options.fraction > 0 && options.fraction <= 0.35 && options.speed >= 0);
  Random random(seed);
  Scene scene;
  scene.name = "gas_in_a_box";
  scene.duration = options.duration;
  scene.steps = options.steps;
  scene.contact.restitution = options.restitution;

  const double area = options.discs * std::numbers::pi * options.radius * options.radius;
  const double side = std::sqrt(area / options.fraction);
  const int columns = static_cast<int>(std::ceil(std::sqrt(options.discs)));
  const int rows = (options.discs + columns - 1) / columns;
  const Vec2d cell(side / columns, side / rows);
  for (int i = 0; i < options.discs; ++i) {
    Vec2d place((i % columns + 0.5) * cell[0], (i / columns + 0.5) * cell[1]);
    for (int j = 0; j < 2; ++j) place[j] += 0.9 * (0.5 * cell[j] - options.radius) * random.Symmetric();
    scene.bodies.push_back({.name = "disc" + std::to_string(i),
                            .radius = options.radius,
                            .position = place,
                            .velocity = options.speed * std::sqrt(0.5) * random.Normal()});
    scene.free.push_back(i);
  }
  scene.planes = {
      {"left", {0, 0}, {1, 0}}, {"right", {side, 0}, {-1, 0}}, {"bottom", {0, 0}, {0, 1}}, {"top", {0, side}, {0, -1}}};
  AimAt({0.5 * side, 0.5 * side}, &scene);
  return scene;
}

Scene BilliardBreak(const BreakOptions& options, std::uint64_t seed) {
  ExpectInRange(options.discs >= 2 && options.discs <= 100000 && options.radius > 0 && options.mass > 0);
  ExpectInRange(options.gap > 0 && options.gap <= 1 && options.speed > 0);
  Random random(seed);
  Scene scene;
  scene.name = "billiard_break";
  scene.duration = options.duration;
  scene.steps = options.steps;
  scene.contact.restitution = options.restitution;

  const double pitch = (2 + options.gap) * options.radius;
  const double gap = options.gap * options.radius;
  scene.bodies.push_back({.name = "cue",
                          .radius = options.radius,
                          .mass = options.mass,
                          .position = {-4 * options.radius, 0.1 * options.radius * random.Symmetric()},
                          .velocity = {options.speed, 0}});
  for (int row = 0; scene.num_bodies() < options.discs; ++row) {
    for (int place = 0; place <= row && scene.num_bodies() < options.discs; ++place) {
      Vec2d at(row * pitch * std::sqrt(0.75), (place - 0.5 * row) * pitch);
      const double angle = std::numbers::pi * random.Symmetric();
      const double length = 0.25 * gap * std::abs(random.Symmetric());
      at += length * Vec2d(std::cos(angle), std::sin(angle));
      scene.bodies.push_back({.name = "disc" + std::to_string(scene.num_bodies()),
                              .radius = options.radius,
                              .mass = options.mass,
                              .position = at});
    }
  }
  scene.free = {0};
  AimAt({0, 0}, &scene);
  return scene;
}

Scene FallingPile(const PileOptions& options, std::uint64_t seed) {
  ExpectInRange(options.discs >= 1 && options.discs <= 100000 && options.radius > 0);
  ExpectInRange(options.friction >= 0 && options.restitution >= 0 && options.restitution <= 1);
  Random random(seed);
  Scene scene;
  scene.name = "falling_pile";
  scene.duration = options.duration;
  scene.steps = options.steps;
  scene.gravity = {0, -9.8};
  scene.contact.friction = options.friction;
  scene.contact.restitution = options.restitution;

  const double pitch = 2.5 * options.radius, disturbed = 0.1 * options.radius;
  const int columns = static_cast<int>(std::ceil(std::sqrt(options.discs)));
  for (int i = 0; i < options.discs; ++i) {
    const int row = i / columns;
    const double size = 1 + 0.1 * random.Symmetric();
    Vec2d place(0.6 * pitch + (i % columns + 0.4 * (row % 2)) * pitch, (0.6 + row) * pitch);
    for (int j = 0; j < 2; ++j) place[j] += disturbed * random.Symmetric();
    scene.bodies.push_back(
        {.name = "disc" + std::to_string(i), .radius = size * options.radius, .mass = size * size, .position = place});
  }
  const double width = (columns + 0.6) * pitch;
  scene.planes = {{"ground", {0, 0}, {0, 1}}, {"left", {0, 0}, {1, 0}}, {"right", {width, 0}, {-1, 0}}};
  scene.free = {options.discs - 1};
  AimAt({0.5 * width, 0}, &scene);
  return scene;
}

}  // namespace saltus
