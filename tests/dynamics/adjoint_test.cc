// The adjoint against forward sensitivities, differences and published gradients.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "saltus/dynamics/registry.h"

namespace saltus {
namespace {

Scene TwoBalls(int steps) {
  Scene scene;
  scene.name = "two_balls";
  scene.steps = steps;
  scene.bodies = {{.name = "striker", .radius = 0.2, .position = {-2, -2}},
                  {.name = "target", .radius = 0.2, .position = {-1, -1}}};
  scene.control = {{0}, {Vec2d(3, 3)}};
  return scene;
}

TEST(Adjoint, DirectToiOnTwoBalls) {
  const Scene scene = TwoBalls(480);
  auto simulator = MakeSimulator("direct_toi", scene, Precision::kDouble);
  ASSERT_TRUE(simulator->Rollout(InitialState(scene), InitialControl(scene, 480)));
  std::vector<double> x(8);
  simulator->GetState(480, x);
  EXPECT_NEAR(x[4] * x[4] + x[5] * x[5] + 1.8, 2.058538, 1e-6);
  Sensitivity sensitivity;
  simulator->Adjoint(std::vector<double>{0, 0, 0, 0, 2 * x[4], 2 * x[5], 0, 0}, true, &sensitivity);
  EXPECT_NEAR(sensitivity.initial[0], -0.719080, 1e-6);
  EXPECT_NEAR(sensitivity.initial[2], -0.719080, 1e-6);
  EXPECT_NEAR(sensitivity.control[0] + 2 * 0.1 * 3 / 480, -0.0002481, 1e-7);
}

}  // namespace
}  // namespace saltus
