// A model's gradient against differences of its own loss.
#include "audit/gradient/own_differences.h"

#include <gtest/gtest.h>

#include "saltus/scene/scene.h"
#include "saltus/simulate/registry.h"

namespace saltus {
namespace {

// A disc that flies along a channel, `gap` from either wall: what moves it aside by more makes it bounce.
Scene AlongAChannel(double gap) {
  Scene scene;
  scene.name = "along_a_channel";
  scene.duration = 1;
  scene.steps = 10;
  scene.bodies = {{.name = "disc", .radius = 0.1, .mass = 1, .position = {0, 0}, .velocity = {0, 1}}};
  scene.planes = {{"left", {-0.1 - gap, 0}, {1, 0}}, {"right", {0.1 + gap, 0}, {-1, 0}}};
  scene.contact = {.restitution = 1, .friction = 0};
  scene.control = {{0}, {{0, 0}}};
  scene.objective.terminal = {{.body = 0, .target = {0.3, 0.5}}};
  scene.objective.effort = 0.001;
  return scene;
}

// Differences begin at a tenth of the way of a step, 0.01 m.
TEST(OwnDifferences, AgreeOnceTheyAreNarrowEnough) {
  for (const double gap : {1e-3, 1e-5, 1e-7}) {
    EXPECT_EQ(CompareWithOwnDifferences("event", AlongAChannel(gap)).agreement, Agreement::kAgrees) << gap;
  }
}

}  // namespace
}  // namespace saltus
