// Two discs, written as a user's hybrid system, against the contact model `event`.
#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <vector>

#include "saltus/hybrid/hybrid_simulator.h"
#include "saltus/simulate/registry.h"
#include "saltus/simulate/simulator.h"
#include "test_scenes.h"

namespace saltus {
namespace {

// [p_1 v_1 p_2 v_2] of two discs of which the first is pushed, by u; p = [restitution].
struct TwoDiscs {
  std::array<double, 2> mass, gravity;
  double reach;  // sum of the radii, m

  static constexpr int kNumControls = 2;
  static constexpr int kNumParameters = 1;
  static constexpr std::array kStateSizes = {8};
  static constexpr std::array kNumGuards = {1};

  template <typename T>
  void Flow(int, const T&, const T* x, const T* u, const T*, T* xdot) const {
    for (int i = 0; i < 2; ++i) {
      for (int j = 0; j < 2; ++j) {
        xdot[4 * i + j] = x[4 * i + 2 + j];
        xdot[4 * i + 2 + j] = i == 0 ? T(gravity[j] + u[j] / mass[0]) : T(gravity[j]);
      }
    }
  }
  template <typename T>
  T Guard(int, int, const T&, const T* x, const T*) const {
    using std::sqrt;
    const T dx = x[4] - x[0], dy = x[5] - x[1];
    return sqrt(dx * dx + dy * dy) - reach;
  }
  template <typename T>
  int Reset(int, int, const T&, const T* x, const T* p, T* x_plus) const {
    using std::sqrt;
    const T dx = x[4] - x[0], dy = x[5] - x[1], distance = sqrt(dx * dx + dy * dy);
    const T n[2] = {dx / distance, dy / distance};
    const T speed = n[0] * (x[6] - x[2]) + n[1] * (x[7] - x[3]);
    const T impulse = -(1.0 + p[0]) * speed / (1.0 / mass[0] + 1.0 / mass[1]);
    for (int j = 0; j < 2; ++j) {
      x_plus[j] = x[j];
      x_plus[2 + j] = x[2 + j] - impulse / mass[0] * n[j];
      x_plus[4 + j] = x[4 + j];
      x_plus[6 + j] = x[6 + j] + impulse / mass[1] * n[j];
    }
    return 0;
  }
};

void ExpectSameMotion(const Scene& scene, int impacts) {
  const auto exact = MakeSimulator({"event"}, scene, Precision::kDouble);
  const std::vector<double> x0 = InitialState(scene), control = InitialControl(scene, exact->num_steps());
  ASSERT_TRUE(exact->Rollout(x0, control));
  std::vector<double> final_state(8), cotangent(8);
  exact->GetState(exact->num_steps(), final_state);

  HybridSimulator simulator(HybridSystem(TwoDiscs{.mass = {scene.bodies[0].mass, scene.bodies[1].mass},
                                                  .gravity = {scene.gravity[0], scene.gravity[1]},
                                                  .reach = scene.bodies[0].radius + scene.bodies[1].radius}));
  ASSERT_TRUE(simulator.Rollout({.initial = x0,
                                 .parameters = {scene.contact.restitution},
                                 .duration = scene.duration,
                                 .num_intervals = scene.steps,
                                 .control = control}));
  EXPECT_EQ(simulator.events().size(), static_cast<size_t>(impacts));
  for (int i = 0; i < 8; ++i) EXPECT_NEAR(simulator.final_state()[i], final_state[i], 1e-12);
  for (int i = 0; i < 8; ++i) {
    std::fill(cotangent.begin(), cotangent.end(), 0.0);
    cotangent[i] = 1;
    Sensitivity expected;
    exact->Adjoint(cotangent, /*with_parameters=*/false, &expected);
    const HybridGradient gradient = simulator.Adjoint(cotangent);
    for (int j = 0; j < 8; ++j) EXPECT_NEAR(gradient.initial[j], expected.initial[j], 1e-12) << i << " by " << j;
    for (size_t j = 0; j < control.size(); ++j) EXPECT_NEAR(gradient.control[j], expected.control[j], 1e-12) << i;
  }
}

TEST(DiscsAsHybridSystem, EqualTheModelEvent) {
  Scene scene = ProblemScene("two_balls");
  ExpectSameMotion(scene, 1);
  scene.contact.restitution = 0.7;
  scene.gravity = {0.3, -1};
  scene.bodies[0].mass = 1.3;
  scene.bodies[1].velocity = {0.1, 0.2};
  scene.steps = 40;
  ExpectSameMotion(scene, 1);
}

}  // namespace
}  // namespace saltus
