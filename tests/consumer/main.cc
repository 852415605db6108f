// What the first lines of a user's program look like. Exit code 0 if the library answers as it should.
#include <iostream>

#include "saltus/physics/scene.h"

int main() {
  saltus::Scene scene;
  scene.name = "falling";
  scene.steps = 480;
  scene.bodies.push_back({.name = "ball", .radius = 0.1, .position = {0, 1}});
  scene.planes.push_back({.name = "ground", .normal = {0, 1}});
  if (const auto error = saltus::Validate(scene)) {
    std::cerr << "A valid scene was refused: " << error->key << ": " << error->message << '\n';
    return 1;
  }
  scene.bodies[0].position = {0, 0};
  if (!saltus::Validate(scene)) {
    std::cerr << "A ball inside the ground was accepted.\n";
    return 1;
  }
  return 0;
}
