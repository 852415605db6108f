// The optimal control of a disc that only the wall can spin, with the optimum of data/spin_references.json.
#pragma once

#include <nlohmann/json.hpp>

#include "reference_values.h"
#include "spinning_disc.h"

namespace saltus {

// A disc at rest that is pushed, and can be spun by the wall only.
inline Scene SpinControl(int steps) {
  Scene scene;
  scene.name = "spin_control";
  scene.steps = steps;
  scene.bodies = {Spinning("disc", 0.1, 1, {0, 0}, {0, 0}, 0)};
  scene.planes = {{"wall", {1, 0}, {-1, 0}}};
  scene.contact = {.restitution = 0.8, .friction = 0.5};
  scene.control = {{0}, {{3, 2}}};
  scene.objective.terminal = {
      {.body = 0, .target = {0.2, 0.8}},
      {.body = 0, .quantity = TerminalTerm::Quantity::kAngularVelocity, .target = {-12, 0}, .weight = 0.01}};
  scene.objective.effort = 0.05;
  scene.optimize = Optimize::kControl;
  return scene;
}

// A number of the optimum in continuous time, or an entry of two.
inline double SpinOptimum(const char* key, int entry = -1) {
  const nlohmann::json& value = ReferenceFile("spin_references.json").at("s5").at(key);
  return Number(entry < 0 ? value : value[entry]);
}

}  // namespace saltus
