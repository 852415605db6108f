#include "solve/search/search_starts.h"

#include <algorithm>
#include <cmath>

#include "base/random.h"

namespace saltus {
namespace {

// The box of all discs and the targets of positions.
struct Box {
  Vec2d low, high;
  void Include(const Vec2d& p) {
    low = low.cwiseMin(p);
    high = high.cwiseMax(p);
  }
};

Box BoxOf(const Scene& scene) {
  Box box{scene.bodies[0].position, scene.bodies[0].position};
  for (const Body& body : scene.bodies) box.Include(body.position);
  for (const TerminalTerm& term : scene.objective.terminal) {
    if (term.quantity == TerminalTerm::Quantity::kPosition)
      box.Include(term.Goal().Nearest(scene.bodies[term.body].position));
  }
  return box;
}

Vec2d DriftOf(const Scene& scene, int body, double t) {
  const Body& disc = scene.bodies[body];
  if (disc.fixed) return disc.position;
  return disc.position + t * disc.velocity + 0.5 * t * t * scene.gravity;
}

// A place on the way of another disc, off its middle by up to a contact distance; or anywhere.
Vec2d Place(const Scene& scene, int pushed, double t, Random* random) {
  const int other = random->UniformIndex(scene.num_bodies() + 1);
  if (other < scene.num_bodies() && other != pushed) {
    const double distance = scene.bodies[pushed].radius + scene.bodies[other].radius;
    const double x = random->Symmetric(), y = random->Symmetric();
    return DriftOf(scene, other, t) + distance * Vec2d(x, y);
  }
  const Box box = BoxOf(scene);
  const double x = random->Uniform(-0.25, 1.25), y = random->Uniform(-0.25, 1.25);
  return box.low + (box.high - box.low).cwiseProduct(Vec2d(x, y));
}

}  // namespace

std::vector<Vec2d> SearchStart(const Scene& scene, std::uint64_t seed, int number) {
  std::vector<Vec2d> forces(scene.control.bodies.size(), Vec2d::Zero());
  if (number == 0) return forces;
  Random random(seed * 1000003 + number);
  for (size_t c = 0; c < forces.size(); ++c) {
    const int body = scene.control.bodies[c];
    const double t = random.Uniform(0.3, 1) * scene.duration;
    const Vec2d place = Place(scene, body, t, &random);
    forces[c] = 2 * scene.bodies[body].mass / (t * t) * (place - DriftOf(scene, body, t));
  }
  return forces;
}

std::vector<double> ControlAround(const Scene& scene, const ControlGuess& control, std::uint64_t seed, int number) {
  constexpr double kSizes[] = {0.1, 0.3, 1};
  const int pushed = scene.num_controlled();
  std::vector<double> u = control.control;
  Random random(seed * 1000003 + 500009 + number);
  for (int c = 0; c < pushed; ++c) {
    const auto at = [&](size_t k) { return 2 * (k * pushed + c); };
    double mean = 0, whole = 0;
    for (size_t k = 0; k < control.durations.size(); ++k) {
      mean += control.durations[k] * std::hypot(u[at(k)], u[at(k) + 1]);
      whole += control.durations[k];
    }
    // At least what moves the disc by its radius.
    const Body& body = scene.bodies[scene.control.bodies[c]];
    const double size = kSizes[number % 3] * std::max(mean / whole, 2 * body.mass * body.radius / (whole * whole));
    double random_forces[4];
    for (double& force : random_forces) force = size * random.Symmetric();
    double begin = 0;
    for (size_t k = 0; k < control.durations.size(); ++k) {
      const double place = 2 * (begin + 0.5 * control.durations[k]) / whole - 1;  // in [-1, 1]
      for (int j = 0; j < 2; ++j) u[at(k) + j] += random_forces[j] + place * random_forces[2 + j];
      begin += control.durations[k];
    }
  }
  return u;
}

std::optional<Scene> BeginAtRandom(Scene scene, std::uint64_t seed, int number) {
  if (scene.optimize == Optimize::kNone) return std::nullopt;
  if (scene.optimize == Optimize::kControl) {
    scene.control.initial = SearchStart(scene, seed, number);
    return scene;
  }
  Random random(seed * 1000003 + number);
  const Scene before = scene;
  for (const int body : scene.free) {
    const double t = random.Uniform(0.3, 1) * scene.duration;
    const Vec2d place = Place(before, body, t, &random);
    if (scene.optimize == Optimize::kPosition) {
      scene.bodies[body].position = place;
    } else {
      scene.bodies[body].velocity += (place - DriftOf(before, body, t)) / t;
    }
  }
  for (const int body : scene.free_spin) {  // as fast as some rolling
    Body& disc = scene.bodies[body];
    disc.angular_velocity += random.Symmetric() * disc.velocity.norm() / disc.radius;
  }
  return scene;
}

}  // namespace saltus
