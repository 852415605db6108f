// The optimal control of one disc that strikes another towards a target, among controls that are constant on the steps
// of a time grid; the motion is exact, not integrated.
//
// The problem is that of two_disc_optimum.h. On a grid the optimal control jumps where the impact is, and the loss has
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
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "exact/two_disc_optimum.h"
#include "saltus/scene/geometry.h"
#include "saltus/scene/scene.h"

namespace saltus {

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

// The best control with the impact on node `node`, 2 <= node < scene.steps. Preconditions, failures and `why_not` as in
// FindTwoDiscOptimum; the angle of the impact is the minimum nearest to that of the optimum in continuous time.
std::optional<GridOptimum> OptimizeWithImpactAt(const Scene& scene, TwoDiscSequence sequence, int node,
                                                std::string* why_not = nullptr);

// Returns the best optimum over all nodes.
std::optional<GridOptimum> FindGridOptimum(const Scene& scene, TwoDiscSequence sequence,
                                           std::string* why_not = nullptr);

}  // namespace saltus
