// Scenes that several tests use.
#pragma once

#include <gtest/gtest.h>

#include <string>
#include <utility>

#include "folders.h"
#include "saltus/scene/scene_file.h"

namespace saltus {

// The scene of problems/<name>.yaml.
inline Scene ProblemScene(const std::string& name) {
  std::variant<Scene, SceneFileError> scene = LoadSceneFile(SourceFolder() + "/problems/" + name + ".yaml");
  if (const SceneFileError* error = std::get_if<SceneFileError>(&scene)) {
    ADD_FAILURE() << error->ToString();
    return {};
  }
  return std::get<Scene>(scene);
}

// Task 1 off its tie: the impact no longer falls on a node of the time grid.
inline Scene BounceOffTheGrid() {
  Scene scene = ProblemScene("bounce_once");
  scene.bodies[0].position[1] = 1.001;
  return scene;
}

// Task 2 off its tie: the impact on the wall no longer falls on the end of a tenth of a step.
inline Scene LaunchOffTheGrid() {
  Scene scene = ProblemScene("ground_wall");
  scene.bodies[0].position[0] += 1e-3;
  return scene;
}

// One disc that is pushed and strikes two others at the same time, about 0.3 s after the start: which of them first
// decides what follows.
inline Scene StrikesTwo() {
  Scene scene;
  scene.name = "strikes_two";
  scene.duration = 1;
  scene.steps = 100;
  scene.bodies = {{.name = "striker", .radius = 0.1, .mass = 1, .position = {-0.6, 0}, .velocity = {1.5, 0}},
                  {.name = "left", .radius = 0.1, .mass = 1, .position = {0, 0.11}},
                  {.name = "right", .radius = 0.1, .mass = 1, .position = {0, -0.11}}};
  scene.contact = {.restitution = 1, .friction = 0};
  scene.control = {{0}, {{0.3, 0}}};
  scene.objective.terminal = {{.body = 0, .target = {0.1, 0}}, {.body = 1, .target = {0.5, 0.5}, .weight = 0.3}};
  scene.objective.effort = 0.01;
  scene.optimize = Optimize::kControl;
  return scene;
}
// Returns the scene with the lines of the two in the other order.
inline Scene StrikesTwoSwapped() {
  Scene scene = StrikesTwo();
  std::swap(scene.bodies[1], scene.bodies[2]);
  scene.objective.terminal[1].body = 2;
  return scene;
}

// Three moving discs of unequal masses and a fixed one, two planes, gravity; discs meet discs, the fixed one and the
// planes. Two discs are pushed.
inline Scene FourDiscs(double friction) {
  Scene scene;
  scene.name = "four_discs";
  scene.duration = 0.375;
  scene.steps = 150;
  scene.gravity = {0.4, -5};
  scene.bodies = {{.name = "a", .radius = 0.2, .mass = 1.3, .position = {-0.9, 0.7}, .velocity = {3, -1}},
                  {.name = "post", .radius = 0.25, .fixed = true, .position = {0.3, 1.1}},
                  {.name = "b", .radius = 0.3, .mass = 2.1, .position = {0.33, 0.41}, .velocity = {-0.5, 0.2}},
                  {.name = "c", .radius = 0.15, .mass = 0.6, .position = {1.2, 1.0}, .velocity = {-2.5, 1}}};
  scene.planes = {{"ground", {0, 0}, {0.1, 1}}, {"wall", {1.6, 0}, {-1, 0}}};
  scene.contact = {.restitution = 0.8, .friction = friction, .stiffness = 3000, .damping = 4};
  scene.control = {{3, 0}, {{0.5, -1}, {1, 0.7}}};
  scene.objective.terminal = {
      {.body = 0, .quantity = TerminalTerm::Quantity::kPosition, .target = {0.2, 0.9}, .weight = 1.5},
      {.body = 2, .quantity = TerminalTerm::Quantity::kVelocity, .target = {0.1, -0.3}, .weight = 0.4},
      {.body = 3, .quantity = TerminalTerm::Quantity::kPosition, .target = {1, 1}}};
  scene.objective.effort = 0.05;
  scene.optimize = Optimize::kControl;
  return scene;
}

}  // namespace saltus
