// Two coupled contacts, a disc on the ground and a disc on that disc, in many states; models that pose the same problem
// must agree on them.
#pragma once

#include <random>

#include "contact/stepping.h"

namespace saltus::testing {

// A disc that overlaps the ground by 1 mm and another that overlaps it, moving at random; no forces.
inline Scene TwoContacts(std::mt19937_64& random, double friction, double restitution) {
  const auto uniform = [&](double low, double high) {
    return low + (high - low) * (static_cast<double>(random() >> 11) / 9007199254740992.0);
  };
  Scene scene;
  scene.duration = 1.0 / 480;
  scene.steps = 1;
  const double angle = uniform(0.4, 2.7), distance = 0.499;
  scene.bodies = {{.name = "a", .radius = 0.2, .mass = uniform(0.5, 2), .position = {0, 0.199}},
                  {.name = "b",
                   .radius = 0.3,
                   .mass = uniform(0.5, 2),
                   .position = {distance * std::cos(angle), 0.199 + distance * std::sin(angle)}}};
  for (Body& body : scene.bodies) body.velocity = {uniform(-2, 2), uniform(-3, 0.5)};
  scene.planes = {{.name = "ground", .point = {0, 0}, .normal = {0, 1}}};
  scene.contact.friction = friction;
  scene.contact.restitution = restitution;
  return scene;
}

// Velocities after one step, and their derivatives by positions and velocities, of both models, in 200 random states in
// which both contacts push.
inline void ExpectAgreement(const Model& model, const Model& other_model, double value_tolerance,
                            double derivative_tolerance) {
  using J = StepJet<double>;
  std::mt19937_64 random(7);
  int both = 0;
  for (int i = 0; both < 200; ++i) {
    ASSERT_LT(i, 10000);
    const Scene scene = TwoContacts(random, i % 2 == 0 ? 0.0 : 0.3, i % 4 < 2 ? 0.0 : 0.5);
    if (scene.bodies[1].position[1] < 0.31) continue;  // it would touch the ground as well
    // Models differ in whether restitution keeps up the parting of a contact that opens, so both must close.
    const Vec2d apart = scene.bodies[1].position - scene.bodies[0].position;
    const Vec2d closing = scene.bodies[1].velocity - scene.bodies[0].velocity;
    if (Dot(apart, closing) >= 0 || scene.bodies[0].velocity[1] >= 0) continue;
    std::vector<Touch> touches;
    StepOnce(model, scene, &touches);
    both += touches.size() == 2;
    for (int first : {0, 4}) {  // columns of disc a, then of disc b
      StepArguments<J> arguments = Arguments<J>(scene);
      for (int k = 0; k < 4; ++k) arguments.Scalars()[first + k]->v[k] = 1;
      const auto one = StepOnce(model, scene, arguments), other = StepOnce(other_model, scene, arguments);
      for (int disc = 0; disc < 2; ++disc) {
        for (int axis = 0; axis < 2; ++axis) {
          const J& a = one[disc].v[axis];
          const J& b = other[disc].v[axis];
          ASSERT_NEAR(a.a, b.a, value_tolerance) << "state " << i;
          const double scale = std::max(1.0, b.v.lpNorm<Eigen::Infinity>());
          ASSERT_LT((a.v - b.v).lpNorm<Eigen::Infinity>(), derivative_tolerance * scale) << "state " << i;
        }
      }
    }
  }
}

}  // namespace saltus::testing
