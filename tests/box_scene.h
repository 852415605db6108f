// A scene whose sequence is mended, which several tests use.
#pragma once

#include "saltus/scene/scene.h"

namespace saltus {

// A ball that flies about in a box, and needs a small correction on its long way: 10 bounces a second. In the first
// second, that correction makes the last two impacts change places.
inline Scene BallInBox(double duration, int steps) {
  Scene scene;
  scene.name = "mended";
  scene.duration = duration;
  scene.steps = steps;
  scene.bodies = {{.name = "ball", .radius = 0.1, .mass = 1, .position = {0.2, 0.3}, .velocity = {4.5, 2.7}}};
  scene.planes = {{"left", {-0.5, 0}, {1, 0}},
                  {"right", {0.5, 0}, {-1, 0}},
                  {"floor", {0, -0.5}, {0, 1}},
                  {"roof", {0, 0.5}, {0, -1}}};
  scene.control = {{0}, {{0, 0}}};
  scene.objective.terminal = {{.body = 0, .target = {0.1, -0.2}}};
  scene.objective.effort = 0.001;
  scene.optimize = Optimize::kControl;
  return scene;
}

}  // namespace saltus
