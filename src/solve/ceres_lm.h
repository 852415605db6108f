// Levenberg-Marquardt, by ceres::Solver, with the states eliminated: the residuals are the terminal ones and
// sqrt(effort dt) u, as functions of the decision variables.
//
// The Gauss-Newton matrix is a multiple of the identity plus one rank a terminal residual. It is never formed: the
// variables come in small blocks, and conjugate gradients need one iteration per distinct eigenvalue, three for one
// terminal term.
// Running terms are residuals at Gauss' nodes of each step, via terms and a final time as they are; bounds on
// components of forces are Ceres' own.
#pragma once

#include "saltus/solve/solver.h"

namespace saltus {

// Precondition: the objective is a sum of squares.
SolveReport SolveByCeresLm(const SolveRequest& request, const SolverOptions& options);

}  // namespace saltus
