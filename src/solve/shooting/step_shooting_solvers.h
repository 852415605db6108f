// Solvers by step shooting: states and forces are variables, and each simulator step is a cost or a constraint.
#pragma once

#include "saltus/solve/solver.h"

namespace saltus {

// Levenberg-Marquardt along a feasible path, by ceres::Solver with sparse linear algebra (path_problem.h). Iterates are
// those of Gauss-Newton in the forces alone; what differs from ceres_lm is the linear algebra, whose cost grows with
// the steps and not with the terminal residuals, and the damping, which is of states and forces alike.
//
// With exact impact times, forces that are constant on a grid make the loss kink wherever an impact crosses a node, and
// each of many nodes is a local minimum at which this must stall. It then holds the impacts on their nodes, where the
// loss is smooth, and moves them from node to node while that helps. Such an end has converged if it is stationary in
// the sense of Clarke: the gradients g_e and g_l as if the impact were just before and just after the node balance,
// theta g_e + (1 - theta) g_l = 0 for a theta in [0, 1].
// On 480 steps this takes the loss of task 3 from 1.396648 to 1.396543, the best on that grid, and that of the problem
// single_collision from 0.31508 to 0.31142.
//
// Precondition: the objective is a sum of squares.
SolveReport SolveByCeresShooting(const SolveRequest& request, const SolverOptions& options);

// Step shooting by an augmented Lagrangian (augmented_lagrangian.h), which demonstrates that this fails: terminal terms
// and effort are minimized over states and forces, subject to
//
//   c_k = x_{k+1} - f(x_k, u_k) = 0,
//
// of weight 1 / dt at first: defects per time, in the mean over time.
//
// Without contact this converges. Through a collision it should not be trusted: with its defects open a trajectory need
// not collide as the forces would have it. The Jacobian of a defect does not depend on a collision in the step before
// or after, so that a defect which carries a disc past a collision, or hits it without one, is never corrected through
// the forces. Runs end at false minima, or with defects open. Losses in the report are therefore those of rollouts of
// the forces, at every iterate.
//
// kConverged means: every defect is below 1e-9, and the gradient of the rollout's loss has vanished. Precondition: the
// objective is a sum of squares.
SolveReport SolveByCeresLagrangian(const SolveRequest& request, const SolverOptions& options);

}  // namespace saltus
