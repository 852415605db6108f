// The extreme curvatures of a quadratic form along the directions that linear equations leave:
//
//   minimize (maximize) d^T H d   subject to   A d = 0,  d^T W d = 1,
//
// with H, A and W sparse, W positive semidefinite, and positive definite along the directions d with A d = 0.
//
// Some equations define an unknown each, in terms of unknowns before it, as the state after a step of a motion. The
// other unknowns are variables v with a metric W_v and, without one, times t. Where H - W is made from few linear
// functionals F of the unknowns, as for motions whose flow is linear, these are pulled back to the variables: with the
// other equations B_v v + B_t t = 0 solved for t, the form is d^T W_v d + (F d)^T G (F d), whose extreme curvatures
// are those of a dense matrix of the size of G (FindLeastCurvature).
//
// Otherwise a shift s is below the least curvature if and only if H - s W + rho A^T A is positive definite for a large
// rho (Debreu 1952), which a sparse Cholesky factorization decides. For the matrices of a motion it takes a time linear
// in the number of steps, as a Riccati sweep does. Shifts come from inverse iteration: v solves
// (H - s W) v + A^T l = W v0 with A v = 0, and its Rayleigh quotient is an upper bound.
#pragma once

#include <Eigen/SparseCore>
#include <optional>
#include <vector>

namespace saltus {

struct ConstrainedCurvature {
  double smallest = 0, largest = 0;
  Eigen::VectorXd direction;  // d of the smallest
};

// An unknown that an equation, a row of A, defines in terms of unknowns that are not defined, or earlier.
struct DefinedUnknown {
  int unknown, equation;
};

// The columns of H, A and W are of variables of order one, and so are the entries of W. Returns std::nullopt if no
// direction is left, or if the least curvature is not found within the accuracy of the factorization.
std::optional<ConstrainedCurvature> FindConstrainedCurvature(const Eigen::SparseMatrix<double>& hessian,
                                                             const Eigen::SparseMatrix<double>& equations,
                                                             const Eigen::SparseMatrix<double>& metric,
                                                             const std::vector<DefinedUnknown>& defined = {});

// Returns the x with H x + A^T l = right and A x = 0; std::nullopt if H is not positive definite along the directions
// with A x = 0, or singular.
std::optional<Eigen::VectorXd> SolveConstrained(const Eigen::SparseMatrix<double>& hessian,
                                                const Eigen::SparseMatrix<double>& equations,
                                                const Eigen::SparseMatrix<double>& metric,
                                                const Eigen::VectorXd& right);

}  // namespace saltus
