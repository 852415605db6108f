// The optimal control of one disc that strikes another towards a target, in continuous time.
//
// The first disc (m1) is pushed by u(t); it strikes the second (m2) at time s, the normal n from the first to the
// second at angle phi. Then the second flies on alone, and u = 0. With w the first disc's velocity just before the
// impact, d = p2 + v2 s - (r1 + r2) n - p1 the way to go, D = d - v1 s and W = w - v1, the least effort to be there
// with w is
//
//   integral of |u|^2 dt = m1^2 (12 |D|^2 / s^3 - 12 D.W / s^2 + 4 |W|^2 / s),  u(t) = c0 + c1 t,
//   c0 = m1 (6 D / s^2 - 2 W / s),  c1 = m1 (6 W / s^2 - 12 D / s^3),
//
// and the second disc ends at x = p2 + v2 T + kappa (T - s) (n.(w - v2)) n with kappa = m1 (1 + e) / (m1 + m2). The
// loss
//
//   J = weight |x - target|^2 + effort * integral of |u|^2 dt
//
// is quadratic in w, which is eliminated; J(s, phi) is minimised by Newton's method with exact second derivatives.
//
// If the second disc then bounces off an elastic frictionless plane, its path is unfolded: target becomes the mirror
// image.
//
// The costates obey the conditions of the hybrid minimum principle of Hu, Long, Zang, E, Han, "Solving optimal control
// of rigid-body dynamics with collisions using the hybrid minimum principle" (arXiv 2205.08622), with the Hamiltonian
// H = effort |u|^2 + sum_i (lambda_p,i . v_i) + lambda_v,1 . u / m1. SI units.
#pragma once

#include <array>
#include <optional>
#include <string>
#include <vector>

#include "saltus/scene/geometry.h"
#include "saltus/scene/scene.h"

namespace saltus {

// Which collisions happen. Among those of one sequence the optimum is the best that was found, from many starts;
// another sequence may be better.
enum class TwoDiscSequence {
  kImpact,           // the discs, once
  kImpactThenPlane,  // the discs, then the second disc on the plane
};

struct TwoDiscCostate {
  std::array<Vec2d, 2> position = {Vec2d::Zero(), Vec2d::Zero()};  // lambda_p of either disc
  std::array<Vec2d, 2> velocity = {Vec2d::Zero(), Vec2d::Zero()};  // lambda_v of either disc
};

struct TwoDiscOptimum {
  double loss = 0;  // terminal + running
  double terminal = 0;
  double running = 0;
  double impact_time = 0;                  // s
  double angle = 0;                        // phi, rad
  Vec2d normal = Vec2d::Zero();            // (cos phi, sin phi), from the first disc to the second
  Vec2d striker_velocity = Vec2d::Zero();  // of the first disc just before the impact, m/s
  double impact_speed = 0;                 // n.(w - v2), m/s
  Vec2d control_start = Vec2d::Zero();     // c0, N
  Vec2d control_slope = Vec2d::Zero();     // c1, N/s
  Vec2d target_velocity = Vec2d::Zero();   // of the second disc just after the impact
  Vec2d target_final = Vec2d::Zero();      // of the second disc at T, where it really is, m
  std::optional<double> plane_time;        // when the second disc strikes the plane

  TwoDiscCostate costate_start;   // at time 0; the gradient of the optimal loss by the initial state
  TwoDiscCostate costate_before;  // just before the impact
  TwoDiscCostate costate_after;   // just after the impact
  double hamiltonian_start = 0;   // at time 0, just before and just after the impact; constant by theory
  double hamiltonian_before = 0;
  double hamiltonian_after = 0;

  double curvature = 0;  // second derivative by the impact time of the loss minimised over all else
  double kink_slope =
      0;  // effort |u(s-)|^2: how fast the loss of a fixed control rises as the impact leaves the jump of u

  // Returns u(t), N; it is zero from the impact on.
  Vec2d Control(double t) const;
};

// The optimum of `scene` among the controls with the given sequence, or nothing and a reason in
// `reason_not_applicable`. Preconditions, else nothing: two moving discs, only the first of them pushed; the objective
// is one squared distance of the second disc's final position, with effort > 0; no gravity, no friction; restitution >
// 0; for kImpactThenPlane exactly one plane and restitution 1. That the paths touch nothing else is checked.
std::optional<TwoDiscOptimum> FindTwoDiscOptimum(const Scene& scene, TwoDiscSequence sequence,
                                                 std::string* reason_not_applicable = nullptr);

// The optimal control of one disc that strikes another towards a target, among controls that are constant on the steps
// of a time grid; the motion is exact, not integrated.
//
// The problem is that above. On a grid the optimal control jumps where the impact is, and the loss has
// a kink wherever the impact crosses a node, so that optima have their impact exactly on a node s = k dt. There the
// least effort that brings the striker to the impact is a least-norm problem with two linear constraints per
// coordinate,
//
//   sum_i dt (s - t_i) u_i = m1 D,  sum_i dt u_i = m1 W,  t_i the middle of step i < k,
//
// solved by its 2x2 Gram matrix: u_i = m1 (beta + alpha (s - t_i)).
//
// Such a point is stationary in the sense of Clarke: with the gradients of the loss by the control as if the impact
// were just before the node (early: the force at the impact is u_{k-1}) and just after (late: u_k = 0), there is a
// theta in [0, 1] with theta early + (1 - theta) late = 0.
struct GridOptimum {
  double loss = 0;  // terminal + running
  double terminal = 0;
  double running = 0;
  int node = 0;                            // k
  double impact_time = 0;                  // k dt, s
  Vec2d normal = Vec2d::Zero();            // from the first disc to the second
  Vec2d striker_velocity = Vec2d::Zero();  // just before the impact, m/s
  std::vector<Vec2d> control;              // N, one per step; zero from the impact on
  std::optional<double> plane_time;        // when the second disc strikes the plane

  double theta = 0;     // a local minimum if in [0, 1]
  double residual = 0;  // largest component of theta early + (1 - theta) late, 1/N
};

// The best control with the impact on node `node`, 2 <= node < scene.steps. Preconditions, failures and
// `reason_not_applicable` as in FindTwoDiscOptimum; the angle of the impact is the minimum nearest to that of the
// optimum in continuous time.
std::optional<GridOptimum> OptimizeWithImpactAt(const Scene& scene, TwoDiscSequence sequence, int node,
                                                std::string* reason_not_applicable = nullptr);

// Returns the best optimum over all nodes.
std::optional<GridOptimum> FindGridOptimum(const Scene& scene, TwoDiscSequence sequence,
                                           std::string* reason_not_applicable = nullptr);

}  // namespace saltus
