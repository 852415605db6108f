#include "contact/solvers/lcp_solver.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

#include "base/linear_algebra.h"
#include "contact/solvers/complementarity.h"

namespace saltus {
namespace {

constexpr double kTolerance = 1e-5;       // on x and w
constexpr double kNoImpulse = 1e-6;       // smaller impulses are none
constexpr double kFarOutside = 1e-2;      // of its bounds
constexpr double kRegularization = 1e-4;  // on the diagonal, where there is no solution

// Added to the diagonal while pivoting only, relative to the largest entry, one after the other until a solution fits.
// Redundant contacts make the matrix singular; this decides their classes. Small ones bias less, large ones round less.
constexpr double kPivotRegularizations[] = {1e-8, 1e-7, 1e-6};

constexpr int kMaxSweeps = 2000;

template <int kMaxRows>
double Sigma(const BoxedLcpUpTo<kMaxRows>& problem, int row, LcpClass c) {
  const double friction = problem.friction[row];
  return c == LcpClass::kUpperBound ? friction : c == LcpClass::kLowerBound ? -friction : 0.0;
}

bool IsAtBound(LcpClass c) { return c == LcpClass::kUpperBound || c == LcpClass::kLowerBound; }

template <int kMaxRows>
LcpList<int, kMaxRows> ClampingRows(const LcpList<LcpClass, kMaxRows>& classes) {
  LcpList<int, kMaxRows> rows;
  for (int i = 0; i < static_cast<int>(classes.size()); ++i) {
    if (classes[i] == LcpClass::kClamping) rows.push_back(i);
  }
  return rows;
}

// Returns Q^+ for given classes.
template <int kMaxRows>
LcpMatrix<kMaxRows> InverseInClasses(const BoxedLcpUpTo<kMaxRows>& problem, const LcpList<LcpClass, kMaxRows>& classes,
                                     const LcpList<int, kMaxRows>& clamping, double rank_threshold) {
  const int n = static_cast<int>(clamping.size());
  if (n == 0) return {};
  LcpMatrix<kMaxRows> reduced(n, n);
  LcpList<int, kMaxRows> column(problem.size(), -1);
  for (int j = 0; j < n; ++j) column[clamping[j]] = j;
  for (int i = 0; i < n; ++i) {
    for (int j = 0; j < n; ++j) reduced(i, j) = problem.matrix(clamping[i], clamping[j]);
    for (int k = 0; k < problem.size(); ++k) {
      if (!IsAtBound(classes[k]) || column[problem.normal[k]] < 0) continue;
      reduced(i, column[problem.normal[k]]) += Sigma(problem, k, classes[k]) * problem.matrix(clamping[i], k);
    }
  }
  LcpMatrix<kMaxRows> inverse(n, n);
  PseudoInvert(reduced, rank_threshold, inverse);
  return inverse;
}

template <int kMaxRows>
LcpVector<kMaxRows> SolveInClasses(const BoxedLcpUpTo<kMaxRows>& problem, const LcpList<LcpClass, kMaxRows>& classes,
                                   const LcpList<int, kMaxRows>& clamping, const LcpMatrix<kMaxRows>& inverse) {
  const int n = static_cast<int>(clamping.size());
  LcpVector<kMaxRows> x = LcpVector<kMaxRows>::Zero(problem.size());
  for (int i = 0; i < n; ++i) {
    for (int j = 0; j < n; ++j) x[clamping[i]] += inverse(i, j) * problem.rhs[clamping[j]];
  }
  for (int k = 0; k < problem.size(); ++k) {
    if (IsAtBound(classes[k])) x[k] = Sigma(problem, k, classes[k]) * x[problem.normal[k]];
  }
  return x;
}

// Returns the class that row i should change to, or its present one.
template <int kMaxRows>
LcpClass BetterClass(const BoxedLcpUpTo<kMaxRows>& problem, const LcpList<LcpClass, kMaxRows>& classes,
                     const LcpVector<kMaxRows>& x, const LcpVector<kMaxRows>& w, int i, double tolerance) {
  const LcpClass c = classes[i];
  if (problem.IsNormal(i)) {
    if (c == LcpClass::kClamping && x[i] < -tolerance) return LcpClass::kFree;
    if (c == LcpClass::kFree && w[i] < -tolerance) return LcpClass::kClamping;
    return c;
  }
  const double bound = problem.friction[i] * x[problem.normal[i]];
  if (c == LcpClass::kClamping && x[i] > bound + tolerance) return LcpClass::kUpperBound;
  if (c == LcpClass::kClamping && x[i] < -bound - tolerance) return LcpClass::kLowerBound;
  if (c == LcpClass::kUpperBound && w[i] > tolerance) return LcpClass::kClamping;
  if (c == LcpClass::kLowerBound && w[i] < -tolerance) return LcpClass::kClamping;
  return c;
}

// Makes the tangents of separating normals separate, and stick where their normals no longer separate.
template <int kMaxRows>
void FollowNormals(const BoxedLcpUpTo<kMaxRows>& problem, LcpList<LcpClass, kMaxRows>* classes) {
  for (int i = 0; i < problem.size(); ++i) {
    if (problem.IsNormal(i)) continue;
    const bool touching = (*classes)[problem.normal[i]] == LcpClass::kClamping;
    if (!touching) (*classes)[i] = LcpClass::kFree;
    if (touching && (*classes)[i] == LcpClass::kFree) (*classes)[i] = LcpClass::kClamping;
  }
}

// Principal pivoting in blocks, or of the last row that violates its class (finite without friction). Returns the last
// x, whether or not it has converged.
template <int kMaxRows>
LcpVector<kMaxRows> Pivot(BoxedLcpUpTo<kMaxRows> problem, double regularization) {
  problem.matrix.diagonal().array() += regularization * problem.matrix.diagonal().maxCoeff();
  const double tolerance = 1e-8 * (1 + problem.rhs.cwiseAbs().maxCoeff());
  LcpList<LcpClass, kMaxRows> classes(problem.size(), LcpClass::kFree);
  for (int i = 0; i < problem.size(); ++i) {
    if (problem.IsNormal(i) && problem.rhs[i] > 0) classes[i] = LcpClass::kClamping;
  }
  FollowNormals(problem, &classes);

  LcpVector<kMaxRows> x;
  BlockPivoting blocks;
  for (int iteration = 0; iteration < 50 + 10 * problem.size(); ++iteration) {
    const LcpList<int, kMaxRows> clamping = ClampingRows<kMaxRows>(classes);
    x = SolveInClasses(problem, classes, clamping, InverseInClasses(problem, classes, clamping, 1e-14));
    const LcpVector<kMaxRows> w = problem.matrix * x - problem.rhs;
    LcpList<int, kMaxRows> wrong;
    LcpList<LcpClass, kMaxRows> better = classes;
    for (int i = 0; i < problem.size(); ++i) {
      better[i] = BetterClass(problem, classes, x, w, i, tolerance);
      if (better[i] != classes[i]) wrong.push_back(i);
    }
    if (wrong.empty()) break;
    if (blocks.ChangesAll(wrong.size())) {
      classes = better;
    } else {
      classes[wrong.back()] = better[wrong.back()];
    }
    FollowNormals(problem, &classes);
  }
  return x;
}

template <int kMaxRows>
LcpVector<kMaxRows> ProjectedGaussSeidel(const BoxedLcpUpTo<kMaxRows>& problem) {
  LcpVector<kMaxRows> x = LcpVector<kMaxRows>::Zero(problem.size());
  for (int sweep = 0; sweep < kMaxSweeps; ++sweep) {
    const double change = GaussSeidelSweep(problem.size(), [&](std::ptrdiff_t row) {
      const int i = static_cast<int>(row);
      const double step = (problem.rhs[i] - problem.matrix.row(i).dot(x)) / problem.matrix(i, i);
      const double bound = problem.friction[i] * x[problem.normal[i]];
      const double to = problem.IsNormal(i) ? std::max(0.0, x[i] + step) : std::clamp(x[i] + step, -bound, bound);
      return std::abs(to - std::exchange(x[i], to));
    });
    if (change < 1e-14) break;
  }
  return x;
}

// Returns the largest violation of the conditions, as LcpViolation() does, for problems with a bounded size.
template <int kMaxRows>
double Violation(const BoxedLcpUpTo<kMaxRows>& problem, const LcpVector<kMaxRows>& x, double at_bound) {
  const LcpVector<kMaxRows> w = problem.matrix * x - problem.rhs;
  double violation = 0;
  for (int i = 0; i < problem.size(); ++i) {
    const bool is_normal = problem.IsNormal(i);
    const double upper =
        is_normal ? std::numeric_limits<double>::infinity() : problem.friction[i] * x[problem.normal[i]];
    const double lower = is_normal ? 0.0 : -upper;
    violation = std::max({violation, lower - x[i], x[i] - upper});
    if (!(x[i] <= lower + at_bound)) violation = std::max(violation, w[i]);
    if (!(x[i] >= upper - at_bound)) violation = std::max(violation, -w[i]);
  }
  return violation;
}

template <int kMaxRows>
bool Fits(const BoxedLcpUpTo<kMaxRows>& problem, const LcpVector<kMaxRows>& x) {
  return x.allFinite() && Violation(problem, x, kTolerance) <= kTolerance;
}

template <int kMaxRows>
LcpClass Classify(const BoxedLcpUpTo<kMaxRows>& problem, const LcpVector<kMaxRows>& x, int i) {
  const bool is_normal = problem.IsNormal(i);
  const double normal = x[problem.normal[i]];
  if (std::abs(x[i]) < kNoImpulse) {
    return !is_normal && normal >= kNoImpulse ? LcpClass::kClamping : LcpClass::kFree;
  }
  const double upper = is_normal ? std::numeric_limits<double>::infinity() : problem.friction[i] * normal;
  const double lower = is_normal ? 0.0 : -upper;
  const bool inside = x[i] > lower + kTolerance && x[i] < upper - kTolerance;
  if (inside || x[i] < lower - kFarOutside || x[i] > upper + kFarOutside) return LcpClass::kClamping;
  if (is_normal || Classify(problem, x, problem.normal[i]) != LcpClass::kClamping) return LcpClass::kFree;
  return x[i] > 0 ? LcpClass::kUpperBound : LcpClass::kLowerBound;
}

template <int kMaxRows>
BoxedLcpUpTo<kMaxRows> FrictionlessProblem(BoxedLcpUpTo<kMaxRows> problem) {
  for (int i = 0; i < problem.size(); ++i) {
    if (problem.IsNormal(i)) continue;
    // The row becomes independent of all others: nothing acts on it, and it acts on nothing.
    problem.matrix.row(i).setZero();
    problem.matrix.col(i).setZero();
    problem.matrix(i, i) = 1;
    problem.rhs[i] = 0;
  }
  problem.friction.setZero();
  return problem;
}

// Classifies the rows of x, and solves for the impulses again within these classes.
template <int kMaxRows>
LcpSolutionUpTo<kMaxRows> Refine(const BoxedLcpUpTo<kMaxRows>& problem, const LcpVector<kMaxRows>& x,
                                 bool with_friction) {
  LcpSolutionUpTo<kMaxRows> solution;
  for (int i = 0; i < problem.size(); ++i) {
    const bool used = with_friction || problem.IsNormal(i);
    solution.classes.push_back(used ? Classify(problem, x, i) : LcpClass::kFree);
  }
  solution.clamping = ClampingRows<kMaxRows>(solution.classes);
  solution.inverse = InverseInClasses(problem, solution.classes, solution.clamping, 1e-11);
  solution.x = SolveInClasses(problem, solution.classes, solution.clamping, solution.inverse);
  if (!Fits(problem, solution.x)) solution.x = x;
  return solution;
}

}  // namespace

double LcpViolation(const BoxedLcp& problem, const Eigen::VectorXd& x, double at_bound) {
  return Violation(problem, x, at_bound);
}

LcpSolution SolveBoxedLcpInClasses(const BoxedLcp& problem, const std::vector<LcpClass>& classes,
                                   const LcpSolution& solution) {
  BoxedLcp regular = problem;
  regular.matrix.diagonal().array() += solution.regularization;
  LcpSolution result;
  result.classes = classes;
  result.clamping = ClampingRows<Eigen::Dynamic>(classes);
  result.inverse = InverseInClasses(regular, classes, result.clamping, 1e-11);
  result.regularization = solution.regularization;
  result.x = SolveInClasses(regular, classes, result.clamping, result.inverse);
  if (Fits(regular, result.x)) return result;
  result.x.setZero();
  for (int i : result.clamping) result.x[i] = solution.x[i];
  return result;
}

template <int kMaxRows>
LcpSolutionUpTo<kMaxRows> SolveBoxedLcp(const BoxedLcpUpTo<kMaxRows>& problem) {
  if (problem.size() == 0) return {};
  for (const double regularization : kPivotRegularizations) {
    const LcpSolutionUpTo<kMaxRows> solution = Refine(problem, Pivot(problem, regularization), true);
    if (Fits(problem, solution.x)) return solution;
  }

  BoxedLcpUpTo<kMaxRows> regular = problem;
  regular.matrix.diagonal().array() += kRegularization;
  bool with_friction = true;
  LcpVector<kMaxRows> x = Pivot(regular, 0);
  if (!Fits(regular, x)) x = ProjectedGaussSeidel(regular);
  if (!Fits(regular, x)) {
    regular = FrictionlessProblem(regular);
    with_friction = false;
    x = Pivot(regular, 0);
  }
  LcpSolutionUpTo<kMaxRows> solution = Refine(regular, x, with_friction);
  solution.regularization = kRegularization;
  const double scale = 1 + problem.rhs.cwiseAbs().maxCoeff() + solution.x.cwiseAbs().maxCoeff();
  solution.fits = solution.x.allFinite() && Violation(regular, solution.x, kTolerance) <= kTolerance * scale;
  return solution;
}

template LcpSolution SolveBoxedLcp(const BoxedLcp& problem);
template LcpSolutionUpTo<kFewLcpRows> SolveBoxedLcp(const BoxedLcpUpTo<kFewLcpRows>& problem);

}  // namespace saltus
