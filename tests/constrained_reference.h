// Optima in continuous time of the task of two balls with bounds, hard terms, running costs and a free final time:
// data/constrained_references.json.
#pragma once

#include <algorithm>
#include <nlohmann/json.hpp>
#include <stdexcept>
#include <string>
#include <vector>

#include "reference_values.h"
#include "saltus/scene/scene.h"
#include "saltus/simulate/simulator.h"
#include "saltus/solve/solver.h"
#include "test_scenes.h"

namespace saltus {

using Json = nlohmann::json;

inline Vec2d VectorOf(const Json& json) { return {json[0].get<double>(), json[1].get<double>()}; }

inline std::vector<Json> References() {
  const Json& optima = ReferenceFile("constrained_references.json").at("optima");
  return {optima.begin(), optima.end()};
}

// The task of two balls with what a reference changes.
inline Scene SceneOf(const Json& reference, int steps) {
  Scene scene = ProblemScene("two_balls");
  scene.steps = steps;
  if (reference.contains("target_start")) scene.bodies[1].position = VectorOf(reference["target_start"]);
  if (reference.contains("effort")) scene.objective.effort = reference["effort"];
  scene.objective.terminal[0].hard = reference.value("hard", false);
  if (const auto control = reference.find("control"); control != reference.end()) {
    if (control->contains("max")) scene.control.max = {(*control)["max"].get<double>()};
    if (control->contains("max_norm")) scene.control.max_norm = {(*control)["max_norm"].get<double>()};
  }
  if (const auto duration = reference.find("duration"); duration != reference.end()) {
    scene.objective.duration = FreeDuration{(*duration)["min"], (*duration)["max"], (*duration)["weight"]};
  }
  if (const auto running = reference.find("running"); running != reference.end()) {
    RunningTerm term;
    for (const Json& row : *running) {
      term.times.push_back(row[0]);
      term.targets.emplace_back(row[1].get<double>(), row[2].get<double>());
    }
    scene.objective.running = {term};
  }
  return scene;
}

// The reference of that name.
inline Json Reference(const std::string& name) {
  for (const Json& reference : References()) {
    if (reference["name"] == name) return reference;
  }
  throw std::out_of_range("no reference " + name);
}

// Returns the name of the test of a reference.
inline std::string TestName(const Json& reference) {
  std::string name = reference["name"];
  std::replace(name.begin(), name.end(), '.', '_');
  return name;
}

// The initial control as one that is given: ceres_phases solves once from there, and tries no random motions, which
// may be better than the reference.
inline SolverOptions FromGuess(const Scene& scene) {
  SolverOptions options;
  options.guess = ControlGuess{InitialControl(scene, scene.steps), {}};
  return options;
}

}  // namespace saltus
