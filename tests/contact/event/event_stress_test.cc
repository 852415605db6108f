// A hundred impacts a scene of the event-driven model: none missed, nothing that is not a number.
#include <gtest/gtest.h>

#include <cmath>

#include "contact/event/event_run.h"
#include "contact/random_scene.h"

namespace saltus {
namespace {

using testing::EventRun;
using testing::RandomScenes;

#ifdef __SANITIZE_ADDRESS__  // takes ten times as long, and looks at memory
constexpr int kScenes = 100;
#else
constexpr int kScenes = 1000;
#endif
constexpr int kImpacts = 100 * kScenes;
constexpr double kOverlap = 1e-9;  // m

// Discs in a closed box.
Scene RandomBox(RandomScenes* random) {
  Scene scene;
  scene.duration = 1.4;
  scene.steps = 8;
  if (random->Chance(0.5)) scene.gravity = random->InSquare(7);
  random->AddDiscs(random->Integer(2, 6), 0.3, &scene);
  const Vec2d up = random->Direction();
  for (const Vec2d& normal : {up, Vec2d(-up), Perpendicular(up), Vec2d(-Perpendicular(up))}) {
    random->AddPlane(normal, &scene);
  }
  scene.contact.restitution = random->Chance(0.3) ? 1 : random->Uniform(0, 1);
  scene.contact.friction = random->Chance(0.5) ? 0 : random->Uniform(0, 1);
  return scene;
}

double LargestOverlap(const Scene& scene, const std::vector<double>& x) {
  double overlap = 0;
  for (int i = 0; i < scene.num_bodies(); ++i) {
    const Vec2d p(x[4 * i], x[4 * i + 1]);
    const double radius = scene.bodies[i].radius;
    for (int j = 0; j < i; ++j) {
      const double distance = (p - Vec2d(x[4 * j], x[4 * j + 1])).norm();
      overlap = std::max(overlap, radius + scene.bodies[j].radius - distance);
    }
    for (const Plane& plane : scene.planes) {
      overlap = std::max(overlap, radius - Dot(plane.normal, Vec2d(p - plane.point)));
    }
  }
  return overlap;
}

TEST(EventStress, NoImpactIsMissed) {
  RandomScenes random(3);
  int impacts = 0;
  for (int i = 0; i < kScenes; ++i) {
    const Scene scene = RandomBox(&random);
    EventRun run(scene);
    ASSERT_TRUE(run.finite) << i;
    for (int k = 0; k <= scene.steps; ++k) {
      ASSERT_LE(LargestOverlap(scene, run.State(k)), kOverlap) << "step " << k << " of scene " << i;
    }
    for (const StepTouch& touch : run.simulator.touches()) {
      impacts += touch.touch.kind == ContactKind::kImpact;
    }
    if (i % 10 != 0) continue;
    const Sensitivity gradient = run.GradientOf(0);
    for (double entry : gradient.initial) ASSERT_FALSE(std::isnan(entry)) << i;
    for (double entry : gradient.control) ASSERT_FALSE(std::isnan(entry)) << i;
  }
  EXPECT_GE(impacts, kImpacts);
}

}  // namespace
}  // namespace saltus
