// Small control problems that the global bound supports, drawn at random.
#pragma once

#include <string>
#include <utility>

#include "base/random.h"
#include "saltus/scene/scene.h"

namespace saltus {

// Two or three discs, perhaps one of them fixed, walls and gravity.
inline Scene SmallProblem(Random* random) {
  Scene scene;
  scene.name = "small";
  scene.duration = random->Uniform(0.5, 1.5);
  scene.steps = 8;
  scene.contact.restitution = random->Uniform(0.3, 1);
  scene.optimize = Optimize::kControl;
  scene.objective.effort = random->Uniform(0.01, 0.1);
  if (random->UniformIndex(2) == 0) scene.gravity = {random->Symmetric(), -random->Uniform(0, 3)};
  const int discs = 2 + random->UniformIndex(2);
  for (int i = 0; i < discs; ++i) {
    Body disc{.name = "disc" + std::to_string(i), .radius = random->Uniform(0.1, 0.3), .mass = random->Uniform(0.5, 2)};
    disc.position = {0.8 * i, 0.3 * random->Symmetric()};
    if (random->UniformIndex(2) == 0) disc.velocity = {random->Symmetric(), random->Symmetric()};
    if (i == 2 && random->UniformIndex(3) == 0) {
      disc.fixed = true;
      disc.velocity = {0, 0};
    }
    scene.bodies.push_back(disc);
  }
  scene.control = {{0}, {{0, 0}}};
  if (random->UniformIndex(4) == 0) scene.control = {{0, 1}, {{0, 0}, {0, 0}}};
  if (random->UniformIndex(2) == 0) scene.planes.push_back({"ground", {0, -0.9}, {0.1 * random->Symmetric(), 1}});
  if (random->UniformIndex(3) == 0) scene.planes.push_back({"wall", {1.6 + 0.6, 0}, {-1, 0.2 * random->Symmetric()}});
  scene.objective.terminal = {{.body = 1, .target = {1 + random->Symmetric(), random->Symmetric()}}};
  if (random->UniformIndex(3) == 0) {
    scene.objective.terminal.push_back({.body = 0,
                                        .quantity = TerminalTerm::Quantity::kVelocity,
                                        .target = {0, 0},
                                        .weight = random->Uniform(0.01, 1)});
  }
  if (discs == 3 && random->UniformIndex(2) == 0) {  // the same in another order: the fixed disc may be the first
    std::swap(scene.bodies[0], scene.bodies[2]);
    const auto swap_index = [](int* body) { *body = *body == 1 ? 1 : 2 - *body; };
    for (int& body : scene.control.bodies) swap_index(&body);
    for (TerminalTerm& term : scene.objective.terminal) swap_index(&term.body);
  }
  return scene;
}

}  // namespace saltus
