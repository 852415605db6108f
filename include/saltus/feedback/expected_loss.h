// Minimisation of the expected loss under normal errors of the initial state and of the executed decision variables.
//
// The expectation is that of the 2 r points of the spherical rule of degree 3 (McNamee, Stenger 1967), +-sqrt(r) l_j
// with equal weights, where l_j are the r columns of a square root of the covariance. It is exact for losses that are
// cubic in the error. To second order it is the loss plus half the trace of its Hessian times the covariance: for a
// terminal cost |x - target|^2, the trace of the covariance of the final state is added. Each point is a motion through
// its own events, so that the gradient, the mean of adjoints, has the derivatives of the saltation matrices in it, and
// a loss with a kink where an event meets a jump of the control is rounded off.
#pragma once

#include <Eigen/Core>

#include "saltus/hybrid/hybrid_problem.h"
#include "saltus/solve/solver.h"

namespace saltus {

// Covariance matrices of the errors, symmetric and positive semidefinite, one of them not zero. Empty: no error.
struct Errors {
  // Covariance of the initial state of a hybrid system, or of a scene in the layout of its initial state (simulator.h,
  // initial_size() numbers). Angles of a scene must have no error.
  Eigen::MatrixXd initial = {};
  // Covariance of the variables of SingleShooting or HybridShooting, such as of the velocity of a shot.
  Eigen::MatrixXd variables = {};
};

// Minimise the expected loss by L-BFGS, with states eliminated by simulation, over the variables of the request or
// problem.
// Options: iterations, callback, stop. The report's losses are expected losses. kNotApplicable with a reason for a
// problem that ceres_lbfgs cannot take.
SolveReport SolveExpectedLoss(const SolveRequest& request, const Errors& errors, const SolverOptions& options);
SolveReport SolveExpectedLoss(const HybridProblem& problem, const Errors& errors, const SolverOptions& options);

}  // namespace saltus
