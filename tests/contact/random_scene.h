// Random scenes of discs and planes, the same with every standard library.
#pragma once

#include <cmath>
#include <numbers>
#include <random>
#include <string>

#include "saltus/scene/scene.h"

namespace saltus::testing {

class RandomScenes {
 public:
  explicit RandomScenes(unsigned seed) : random_(seed) {}

  // std::uniform_real_distribution is not the same everywhere.
  double Uniform(double low, double high) { return low + (high - low) * (random_() / 4294967296.0); }
  int Integer(int low, int high) { return low + static_cast<int>(random_() % (high - low + 1)); }
  bool Chance(double probability) { return Uniform(0, 1) < probability; }
  double Sign() { return Chance(0.5) ? 1 : -1; }
  Vec2d InSquare(double half) {
    const double x = Uniform(-half, half);
    return {x, Uniform(-half, half)};
  }
  Vec2d Direction() {
    const double angle = Uniform(0, 2 * std::numbers::pi);
    return {std::cos(angle), std::sin(angle)};
  }

  // Discs of different size and mass within half a metre or so, all pushed, that do not touch; at most one is fixed.
  void AddDiscs(int count, double fixed_probability, Scene* scene) {
    while (scene->num_bodies() < count) {
      Body body{.name = "disc" + std::to_string(scene->num_bodies()),
                .radius = Uniform(0.08, 0.2),
                .mass = Uniform(0.3, 3),
                .position = InSquare(0.7)};
      if (!IsFree(body, *scene)) continue;
      body.fixed = scene->num_bodies() == 1 && Chance(fixed_probability);
      if (!body.fixed) {
        body.velocity = InSquare(2);
        scene->control.bodies.push_back(scene->num_bodies());
        scene->control.initial.push_back(InSquare(4));
      }
      scene->bodies.push_back(body);
    }
  }
  // A half-plane that holds all discs of AddDiscs.
  void AddPlane(const Vec2d& normal, Scene* scene) {
    scene->planes.push_back({"plane" + std::to_string(scene->planes.size()), -Uniform(1.2, 1.4) * normal, normal});
  }

 private:
  static bool IsFree(const Body& body, const Scene& scene) {
    for (const Body& other : scene.bodies) {
      if ((body.position - other.position).norm() < body.radius + other.radius + 0.01) return false;
    }
    return true;
  }

  std::mt19937 random_;
};

}  // namespace saltus::testing
