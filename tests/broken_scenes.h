// Scenes as a user of the library may build them by mistake: each breaks one rule of ValidateStructure.
#pragma once

#include <functional>
#include <limits>
#include <string>
#include <vector>

#include "test_scenes.h"

namespace saltus {

struct BrokenScene {
  std::string key;  // that the refusal must name
  Scene scene;
};

// Two discs, two planes, a control, an objective: all lists are used.
inline Scene SceneToBreak() {
  Scene scene = ProblemScene("two_balls");
  scene.planes = {{"ceiling", {0, 10}, {0, -1}}, {"wall", {10, 0}, {-1, 0}}};
  scene.free = {1};
  return scene;
}

inline std::vector<BrokenScene> BrokenScenes() {
  const double nan = std::numeric_limits<double>::quiet_NaN(), infinity = std::numeric_limits<double>::infinity();
  std::vector<BrokenScene> broken;
  const auto add = [&](const std::string& key, const std::function<void(Scene*)>& breaks) {
    broken.push_back({key, SceneToBreak()});
    breaks(&broken.back().scene);
  };
  for (const double value : {nan, infinity, 0.0, -1.0, 1e25}) {
    add("duration", [&](Scene* s) { s->duration = value; });
    add("bodies[1].radius", [&](Scene* s) { s->bodies[1].radius = value; });
    add("bodies[0].mass", [&](Scene* s) { s->bodies[0].mass = value; });
  }
  for (const double value : {nan, -infinity, -1e25}) {
    add("gravity[1]", [&](Scene* s) { s->gravity[1] = value; });
    add("bodies[1].position[0]", [&](Scene* s) { s->bodies[1].position[0] = value; });
    add("bodies[0].velocity[1]", [&](Scene* s) { s->bodies[0].velocity[1] = value; });
    add("planes[1].point[0]", [&](Scene* s) { s->planes[1].point[0] = value; });
    add("planes[0].normal[1]", [&](Scene* s) { s->planes[0].normal[1] = value; });
    add("contact.restitution", [&](Scene* s) { s->contact.restitution = value; });
    add("contact.friction", [&](Scene* s) { s->contact.friction = value; });
    add("contact.stiffness", [&](Scene* s) { s->contact.stiffness = value; });
    add("contact.damping", [&](Scene* s) { s->contact.damping = value; });
    add("control.initial[0][0]", [&](Scene* s) { s->control.initial[0][0] = value; });
    add("objective.effort", [&](Scene* s) { s->objective.effort = value; });
    add("objective.terminal[0].weight", [&](Scene* s) { s->objective.terminal[0].weight = value; });
    add("objective.terminal[0].target[1]", [&](Scene* s) { s->objective.terminal[0].target[1] = value; });
  }
  for (const int value : {0, -1, std::numeric_limits<int>::min(), std::numeric_limits<int>::max()}) {
    add("steps", [&](Scene* s) { s->steps = value; });
  }
  for (const int body : {-1, 2, 40, std::numeric_limits<int>::max(), std::numeric_limits<int>::min()}) {
    add("control.bodies[0]", [&](Scene* s) { s->control.bodies[0] = body; });
    add("objective.terminal[0].body", [&](Scene* s) { s->objective.terminal[0].body = body; });
    add("free[0]", [&](Scene* s) { s->free[0] = body; });
  }
  for (const int component : {-1, 2, 40}) {
    add("objective.terminal[0].component", [&](Scene* s) { s->objective.terminal[0].component = component; });
  }
  add("bodies", [](Scene* s) { s->bodies.clear(); });
  add("bodies[1].velocity", [](Scene* s) {
    s->bodies[1].fixed = true;
    s->bodies[1].velocity = {1, 0};
    s->free.clear();
  });
  add("planes[1].normal", [](Scene* s) { s->planes[1].normal = {0, 0}; });
  add("contact.restitution", [](Scene* s) { s->contact.restitution = 1.5; });
  add("control.bodies[0]", [](Scene* s) { s->bodies[0].fixed = true; });
  add("control.bodies[1]", [](Scene* s) {
    s->control.bodies = {0, 0};
    s->control.initial.resize(2, Vec2d::Zero());
  });
  add("control.initial", [](Scene* s) { s->control.initial.clear(); });
  add("control.initial", [](Scene* s) { s->control.initial.resize(3, Vec2d::Zero()); });
  add("control.initial", [](Scene* s) { s->control.bodies.clear(); });
  add("free[1]", [](Scene* s) { s->free = {1, 1}; });
  add("free[0]", [](Scene* s) { s->bodies[1].fixed = true; });
  return broken;
}

}  // namespace saltus
