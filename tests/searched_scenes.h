// Scenes whose best motion a search over collision sequences found hard to reach, and its limits in tests.
#pragma once

#include <string>

#include "saltus/scene/scene.h"
#include "saltus/solve/solver.h"

namespace saltus {

// Limits of mode_search in counts, so that no test depends on how fast the machine is.
inline SolverOptions Counted(int iterations = 1000, int starts = 8) {
  SolverOptions options;
  options.limits.iterations = iterations;
  options.sequences.limits.work = 0;
  options.sequences.limits.starts = starts;
  return options;
}

// The best push strikes at the final time: 0.104 or less. Doing nothing costs 6.25.
inline Scene VelocityAtTheEnd() {
  Scene scene;
  scene.name = "velocity_at_the_end";
  scene.duration = 1;
  scene.steps = 200;
  scene.bodies = {{.name = "striker", .radius = 0.2, .mass = 1, .position = {-1.5, 0.1}},
                  {.name = "target", .radius = 0.2, .mass = 1, .position = {0, 0}}};
  scene.contact.restitution = 0.8;
  scene.control = {{0}, {{3, 0}}};
  scene.objective.terminal = {
      {.body = 1, .quantity = TerminalTerm::Quantity::kVelocity, .target = {1, 0.5}, .weight = 5}};
  scene.objective.effort = 0.02;
  scene.optimize = Optimize::kControl;
  return scene;
}

// The best way between two posts touches on the way: 0.01498 (ceres_lm: 0.014984).
inline Scene Gap() {
  Scene scene;
  scene.name = "gap";
  scene.duration = 2;
  scene.steps = 400;
  scene.bodies = {{.name = "ball", .radius = 0.1, .mass = 1, .position = {0, 0.1}},
                  {.name = "top", .radius = 0.3, .fixed = true, .position = {1, 0.45}},
                  {.name = "bottom", .radius = 0.3, .fixed = true, .position = {1, -0.45}}};
  scene.contact.restitution = 0.9;
  scene.control = {{0}, {{1, 0.1}}};
  scene.objective.terminal = {{.body = 0, .target = {2, 0}}};
  scene.objective.effort = 0.01;
  scene.optimize = Optimize::kControl;
  return scene;
}

// Ten pins in a triangle, to be sent to one place: 1.014 or less, with more than six impacts.
inline Scene Bowling() {
  Scene scene;
  scene.name = "bowling";
  scene.duration = 1.5;
  scene.steps = 300;
  scene.bodies = {{.name = "bowl", .radius = 0.15, .mass = 5, .position = {-1.5, 0.02}}};
  for (int row = 0; row < 4; ++row) {
    for (int place = 0; place <= row; ++place) {
      scene.bodies.push_back({.name = "pin" + std::to_string(scene.num_bodies() - 1),
                              .radius = 0.06,
                              .mass = 1.5,
                              .position = {0.2 * row, 0.115 * (2 * place - row)}});
      scene.objective.terminal.push_back({.body = scene.num_bodies() - 1, .target = {1.5, 0}, .weight = 0.1});
    }
  }
  scene.contact.restitution = 0.7;
  scene.control = {{0}, {{10, 0}}};
  scene.objective.effort = 0.001;
  scene.optimize = Optimize::kControl;
  return scene;
}

}  // namespace saltus
