// Models whose step solves F(z; theta) = 0: Newton's method on values, then one Newton correction in T, which is the
// implicit function theorem.
//
// A problem is a class with theta in a scalar type and
//   using Scalar = ...;                                           that type, T
//   int size() const;                                             number of unknowns and equations
//   void Residual(std::span<const T> z, std::span<T> F) const;
//   template <typename U> auto Cast() const;                      the same with values of theta only, in U
// and, for InteriorPoint,
//   template <typename Visit> void VisitPositive(const VectorXd& z, const VectorXd& dz, const Visit& visit) const;
//       calls visit(x, dx) for each quantity that must stay positive, and its change along dz
//   double kappa;                                                 what products of complementary quantities shall be
#pragma once

#include <algorithm>
#include <cmath>
#include <span>
#include <type_traits>
#include <vector>

#include "base/linear_algebra.h"
#include "saltus/base/scalar.h"

namespace saltus {

// The residual F at z, and its Jacobian dF/dz.
struct Linearized {
  Eigen::VectorXd residual;
  Eigen::MatrixXd jacobian;
};

// Linearizes F. Not inlined, so that the iterations and the step in Jets share its compiled parts.
template <typename P>
[[gnu::noinline]] SALTUS_FLATTEN Linearized LinearizeByUnknowns(const P& problem, const Eigen::VectorXd& z) {
  using J = StepJet<double>;
  const auto lifted = problem.template Cast<J>();
  const int n = problem.size();
  Linearized out{Eigen::VectorXd(n), Eigen::MatrixXd(n, n)};
  std::vector<J> unknowns(n), residual(n);
  for (int first = 0; first < n; first += kJetWidth) {
    const int width = std::min(kJetWidth, n - first);
    for (int i = 0; i < n; ++i) unknowns[i] = J(z[i]);
    for (int i = 0; i < width; ++i) unknowns[first + i].v[i] = 1;
    lifted.Residual(std::span<const J>(unknowns), std::span<J>(residual));
    for (int i = 0; i < n; ++i) {
      out.residual[i] = residual[i].a;
      out.jacobian.row(i).segment(first, width) = residual[i].v.head(width);
    }
  }
  return out;
}

// Returns z in T: z - F_z^-1 F(z; theta), whose value stays z. `jacobian`: F_z at z.
template <typename P>
auto DifferentiableCorrection(const P& problem, const Eigen::VectorXd& z, const Eigen::MatrixXd& jacobian) {
  using T = typename P::Scalar;
  std::vector<T> corrected(z.begin(), z.end());
  if constexpr (!std::is_same_v<T, double>) {
    std::vector<T> residual(z.size());
    problem.Residual(std::span<const T>(corrected), std::span<T>(residual));
    Eigen::MatrixXd variation(z.size(), kJetWidth);
    for (int i = 0; i < z.size(); ++i) variation.row(i) = residual[i].v;
    const Eigen::MatrixXd change = SolveLuColumns(jacobian, variation);
    for (int i = 0; i < z.size(); ++i) corrected[i].v = -change.row(i);
  }
  return corrected;
}

struct PathOptions {
  double kappa = 1e-8;       // where the central path is left
  double tolerance = 1e-13;  // of the largest residual
  double reduction = 0.2;    // of kappa between points of the path
  double to_boundary = 0.99;
  int max_iterations = 500;
};

// Follows the central path of `problem` from (z, problem.kappa) to options.kappa. Returns false if it does not arrive.
// Not inlined: it is long, and no part of a derivative.
template <typename P>
[[gnu::noinline]] bool InteriorPoint(const PathOptions& options, P* problem, Eigen::VectorXd* z) {
  double best = HUGE_VAL;
  int stalled = 0;
  for (int iteration = 0; iteration < options.max_iterations; ++iteration) {
    const Linearized at = LinearizeByUnknowns(*problem, *z);
    const double error = at.residual.cwiseAbs().maxCoeff();
    if (!std::isfinite(error)) return false;
    if (problem->kappa > options.kappa) {
      if (error < problem->kappa) {
        problem->kappa = std::max(options.kappa, options.reduction * problem->kappa);
        continue;
      }
    } else {
      // Rounding may keep the residual above the tolerance, which shows in that it no longer falls.
      if (error < options.tolerance) return true;
      stalled = error < 0.5 * best ? 0 : stalled + 1;
      best = std::min(best, error);
      if (stalled > 8) return error < 1e3 * options.tolerance;
    }
    const Eigen::VectorXd step = SolveLu(at.jacobian, -at.residual);
    double length = 1;
    problem->VisitPositive(*z, step, [&](double x, double dx) {
      if (dx < 0) length = std::min(length, -options.to_boundary * x / dx);
    });
    *z += length * step;
  }
  return false;
}

}  // namespace saltus
