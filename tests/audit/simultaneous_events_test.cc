// One-sided derivatives where impacts happen at one time.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <string>

#include "audit/gradient/step_study.h"
#include "saltus/scene/scene.h"

namespace saltus {
namespace {

// Discs that rest have no impacts, and thousands where they are moved a little: differences by every entry would take
// minutes. A simulator asks before every step with contact whether it shall stop.
TEST(OneSidedBySimultaneousEvents, IsNotLookedForWhereDisturbedMotionsHaveManyImpacts) {
  Scene scene;
  scene.duration = 1;
  scene.steps = 240;
  scene.gravity = {0, -9.8};
  scene.contact = {.restitution = 0, .friction = 0};
  scene.planes = {{"ground", {0, 0}, {0, 1}}};
  for (int i = 0; i < 20; ++i) {
    scene.bodies.push_back(
        {.name = "disc" + std::to_string(i), .radius = 0.1, .mass = 1, .position = {0, 0.1 * (2 * i + 1)}});
  }
  scene.objective.terminal = {{.body = 19}};
  const int enough = 10 * scene.steps;
  int asked = 0;
  EXPECT_THAT(OneSidedBySimultaneousEvents("event", scene, {}, [&] { return ++asked > enough; }), testing::IsEmpty());
  EXPECT_LE(asked, enough);
}

}  // namespace
}  // namespace saltus
