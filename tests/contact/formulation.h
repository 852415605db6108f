// Loss and gradient of the three tasks at their initial guess under one formulation, against values of an independent
// implementation, to the digits stated.
#pragma once

#include "contact/stepping.h"

namespace saltus::testing {

inline Scene BounceOnce() { return ProblemScene("bounce_once"); }

// The loss of a rollout from `arguments`. Its force is held over the horizon but for the first step's, `first_force`.
template <typename M, typename T>
T LossOf(const Scene& scene, StepArguments<T> arguments, const std::vector<Vec2<T>>& first_force) {
  using S = Base<T>;
  const std::vector<Vec2<T>> force = arguments.force;
  T loss = T(S(0));
  for (int k = 0; k < scene.steps; ++k) {
    arguments.force = k == 0 ? first_force : force;
    for (const int i : scene.control.bodies) {
      const Vec2<T>& u = arguments.force[i];
      loss += S(scene.objective.effort * scene.dt()) * Dot(u, u);
    }
    arguments.x = StepOnce<M>(scene, arguments);
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

template <typename M>
double LossOf(const Scene& scene) {
  const StepArguments<double> arguments = Arguments<double>(scene);
  return LossOf<M>(scene, arguments, arguments.force);
}

// Derivative of the loss by forward Jets. `quantity`: "dloss/" and dp_y, dv2_x (body 2 of 1, 2, ...), du0_y or du1_0_x
// (force on body 1 in step 0).
template <typename M>
double LossDerivative(const Scene& scene, const std::string& quantity) {
  using J = StepJet<double>;
  StepArguments<J> arguments = Arguments<J>(scene);
  std::vector<Vec2<J>> first_force = arguments.force;
  const char kind = quantity[7];
  const int component = quantity.back() == 'y';
  const bool numbered = kind == 'u' ? quantity[9] == '_' && quantity.size() > 11 : quantity[8] != '_';
  const int body = numbered ? quantity[8] - '1' : 0;
  J& seed = kind == 'p'   ? arguments.x[body].p[component]
            : kind == 'v' ? arguments.x[body].v[component]
                          : first_force[body][component];
  seed.v[0] = 1;
  return LossOf<M>(scene, arguments, first_force).v[0];
}

// Absolute, half a unit of the last of six decimals and rounding of the other.
inline constexpr double kPrinted = 1.1e-6;

struct BounceOnceValues {
  double loss, dp_y, dv_y, du0_y;
};
template <typename M>
void ExpectBounceOnce(const Scene& scene, const BounceOnceValues& expected) {
  EXPECT_NEAR(LossOf<M>(scene), expected.loss, kPrinted);
  EXPECT_NEAR((LossDerivative<M>(scene, "dloss/dp_y")), expected.dp_y, kPrinted);
  EXPECT_NEAR((LossDerivative<M>(scene, "dloss/dv_y")), expected.dv_y, kPrinted);
  EXPECT_NEAR((LossDerivative<M>(scene, "dloss/du0_y")), expected.du0_y, 1.1e-7);
}

struct GroundWallValues {
  double loss, dv_x, dv_y;
};
template <typename M>
void ExpectGroundWall(const Scene& scene, const GroundWallValues& expected, double tolerance = kPrinted) {
  EXPECT_NEAR(LossOf<M>(scene), expected.loss, tolerance);
  EXPECT_NEAR((LossDerivative<M>(scene, "dloss/dv_x")), expected.dv_x, tolerance);
  EXPECT_NEAR((LossDerivative<M>(scene, "dloss/dv_y")), expected.dv_y, tolerance);
}

struct TwoBallsValues {
  double loss, dp1_x, dp2_x, dv1_x, dv2_x, du0_x;
};
template <typename M>
void ExpectTwoBalls(const Scene& scene, const TwoBallsValues& expected) {
  EXPECT_NEAR(LossOf<M>(scene), expected.loss, kPrinted);
  EXPECT_NEAR((LossDerivative<M>(scene, "dloss/dp1_x")), expected.dp1_x, kPrinted);
  EXPECT_NEAR((LossDerivative<M>(scene, "dloss/dp2_x")), expected.dp2_x, kPrinted);
  EXPECT_NEAR((LossDerivative<M>(scene, "dloss/dv1_x")), expected.dv1_x, kPrinted);
  EXPECT_NEAR((LossDerivative<M>(scene, "dloss/dv2_x")), expected.dv2_x, kPrinted);
  EXPECT_NEAR((LossDerivative<M>(scene, "dloss/du1_0_x")), expected.du0_x, 1.1e-7);
}

// A disc of 1 kg on the ground that slides at 1 m/s, friction 0.1.
struct SlidingDisc {
  double speed_at_half, speed_at_end;  // m/s, after 0.5 s and after 1.5 s
};
template <typename M>
SlidingDisc Slide(double height = 0.1) {
  Scene scene = BounceOnce();
  scene.gravity = {0, -9.8};
  scene.bodies[0].position = {0, height};
  scene.bodies[0].velocity = {1, 0};
  scene.contact.friction = 0.1;
  scene.contact.restitution = 0;
  scene.objective.terminal = {{.body = 0, .quantity = TerminalTerm::Quantity::kVelocity, .component = 0}};
  scene.duration = 0.5;
  scene.steps = 240;
  const double half = LossOf<M>(scene);
  scene.duration = 1.5;
  scene.steps = 720;
  return {half, LossOf<M>(scene)};
}

}  // namespace saltus::testing
