// Loss and gradient of the three tasks at their initial guess under one formulation, against values of an independent
// implementation, to the digits stated.
#pragma once

#include "contact/stepping.h"

namespace saltus::testing {

inline Scene BounceOnce() { return ProblemScene("bounce_once"); }

// The loss of a rollout from `arguments`. Its force is held over the horizon but for the first step's, `first_force`.
template <typename T>
T LossOf(const Model& model, const Scene& scene, StepArguments<T> arguments, const std::vector<Vec2<T>>& first_force) {
  using S = Base<T>;
  const std::vector<Vec2<T>> force = arguments.force;
  T loss = T(S(0));
  for (int k = 0; k < scene.steps; ++k) {
    arguments.force = k == 0 ? first_force : force;
    for (const int i : scene.control.bodies) {
      const Vec2<T>& u = arguments.force[i];
      loss += S(scene.objective.effort * scene.dt()) * Dot(u, u);
    }
    arguments.x = StepOnce(model, scene, arguments);
  }
  for (const TerminalTerm& term : scene.objective.terminal) {
    const bool position = term.quantity == TerminalTerm::Quantity::kPosition;
    const Vec2<T>& q = position ? arguments.x[term.body].p : arguments.x[term.body].v;
    if (term.component) {
      loss += S(term.weight) * q[*term.component];
    } else {
      const Vec2<T> miss(q[0] - S(term.target[0]), q[1] - S(term.target[1]));
      loss += S(term.weight) * Dot(miss, miss);
    }
  }
  return loss;
}

inline double LossOf(const Model& model, const Scene& scene) {
  const StepArguments<double> arguments = Arguments<double>(scene);
  return LossOf(model, scene, arguments, arguments.force);
}

// Derivative of the loss by forward Jets. `quantity`: dp, dv or, for the force in the first step, du; the number of the
// disc from 1 on, unless there is one only; and _x or _y.
inline double LossDerivative(const Model& model, const Scene& scene, const std::string& quantity) {
  using J = StepJet<double>;
  StepArguments<J> arguments = Arguments<J>(scene);
  std::vector<Vec2<J>> first_force = arguments.force;
  const char kind = quantity[1];
  const int component = quantity.back() == 'y';
  const int body = quantity[2] == '_' ? 0 : quantity[2] - '1';
  J& seed = kind == 'p'   ? arguments.x[body].p[component]
            : kind == 'v' ? arguments.x[body].v[component]
                          : first_force[body][component];
  seed.v[0] = 1;
  return LossOf(model, scene, arguments, first_force).v[0];
}

// Absolute, half a unit of the last of six decimals and rounding of the other.
inline constexpr double kPrinted = 1.1e-6;

struct BounceOnceValues {
  double loss, dp_y, dv_y, du0_y;
};
inline void ExpectBounceOnce(const Model& model, const Scene& scene, const BounceOnceValues& expected) {
  EXPECT_NEAR(LossOf(model, scene), expected.loss, kPrinted);
  EXPECT_NEAR(LossDerivative(model, scene, "dp_y"), expected.dp_y, kPrinted);
  EXPECT_NEAR(LossDerivative(model, scene, "dv_y"), expected.dv_y, kPrinted);
  EXPECT_NEAR(LossDerivative(model, scene, "du_y"), expected.du0_y, 1.1e-7);
}

struct GroundWallValues {
  double loss, dv_x, dv_y;
};
inline void ExpectGroundWall(const Model& model, const Scene& scene, const GroundWallValues& expected,
                             double tolerance = kPrinted) {
  EXPECT_NEAR(LossOf(model, scene), expected.loss, tolerance);
  EXPECT_NEAR(LossDerivative(model, scene, "dv_x"), expected.dv_x, tolerance);
  EXPECT_NEAR(LossDerivative(model, scene, "dv_y"), expected.dv_y, tolerance);
}

struct TwoBallsValues {
  double loss, dp1_x, dp2_x, dv1_x, dv2_x, du0_x;
};
inline void ExpectTwoBalls(const Model& model, const Scene& scene, const TwoBallsValues& expected) {
  EXPECT_NEAR(LossOf(model, scene), expected.loss, kPrinted);
  EXPECT_NEAR(LossDerivative(model, scene, "dp1_x"), expected.dp1_x, kPrinted);
  EXPECT_NEAR(LossDerivative(model, scene, "dp2_x"), expected.dp2_x, kPrinted);
  EXPECT_NEAR(LossDerivative(model, scene, "dv1_x"), expected.dv1_x, kPrinted);
  EXPECT_NEAR(LossDerivative(model, scene, "dv2_x"), expected.dv2_x, kPrinted);
  EXPECT_NEAR(LossDerivative(model, scene, "du1_x"), expected.du0_x, 1.1e-7);
}

// A disc of 1 kg on the ground that slides at 1 m/s, friction 0.1.
struct SlidingDisc {
  double speed_at_half, speed_at_end;  // m/s, after 0.5 s and after 1.5 s
};
inline SlidingDisc Slide(const Model& model, double height = 0.1) {
  Scene scene = BounceOnce();
  scene.gravity = {0, -9.8};
  scene.bodies[0].position = {0, height};
  scene.bodies[0].velocity = {1, 0};
  scene.contact.friction = 0.1;
  scene.contact.restitution = 0;
  scene.objective.terminal = {{.body = 0, .quantity = TerminalTerm::Quantity::kVelocity, .component = 0}};
  scene.duration = 0.5;
  scene.steps = 240;
  const double half = LossOf(model, scene);
  scene.duration = 1.5;
  scene.steps = 720;
  return {half, LossOf(model, scene)};
}

}  // namespace saltus::testing
