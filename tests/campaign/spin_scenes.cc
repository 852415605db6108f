// Random scenes with discs that spin.
#include "campaign/scenes.h"

namespace saltus::campaign {

NamedScene WithSpin(NamedScene named, std::uint32_t seed) {
  testing::RandomScenes random(seed ^ 0x5151u);
  Scene& scene = named.scene;
  scene.table.reset();
  if (scene.contact.friction == 0) scene.contact.friction = random.Uniform(0, 1);
  for (int i = 0; i < scene.num_bodies(); ++i) {
    Body& body = scene.bodies[i];
    if (body.fixed || random.Chance(0.1)) continue;
    body.inertia.kind = Inertia::Kind::kSolid;
    if (random.Chance(0.3)) {
      body.inertia = {Inertia::Kind::kGiven, random.Uniform(0.1, 1) * body.mass * body.radius * body.radius};
    }
    if (random.Chance(0.7)) body.angular_velocity = random.Uniform(-30, 30);
    scene.objective.terminal.push_back({.body = i,
                                        .quantity = TerminalTerm::Quantity::kAngularVelocity,
                                        .target = {random.Uniform(-10, 10), 0},
                                        .weight = random.Uniform(0, 0.01)});
    scene.objective.terminal.push_back({.body = i,
                                        .quantity = TerminalTerm::Quantity::kAngle,
                                        .target = {random.Uniform(-3, 3), 0},
                                        .weight = random.Uniform(0, 0.1)});
  }
  return named;
}

}  // namespace saltus::campaign
