#include "optimality/constrained_curvature.h"

#include <Eigen/SparseCholesky>
#include <algorithm>
#include <cmath>
#include <vector>

namespace saltus {
namespace {

using Eigen::VectorXd;
using Sparse = Eigen::SparseMatrix<double>;

constexpr double kPenalty = 1e6;       // rho, relative to the largest entry of H - s W
constexpr double kConverged = 1e-8;    // relative, of the curvature
constexpr int kMostShifts = 60;        // factorizations
constexpr double kSlack = 1e-9;        // of the equations in factors, which makes up for redundant ones
constexpr int kMostRefinements = 8;    // of a solve
constexpr double kNoDirection = 1e-8;  // of a solution, relative to that without equations

// Linear combinations of symmetric matrices. Sum and summands share one pattern of the lower triangle.
class Combination {
 public:
  explicit Combination(const std::vector<Sparse>& summands) {
    sum_.resize(summands[0].rows(), summands[0].cols());
    for (const Sparse& summand : summands) sum_ += Sparse(summand.triangularView<Eigen::Lower>());
    for (const Sparse& summand : summands) {
      sum_.coeffs().setZero();
      for (Eigen::Index column = 0; column < summand.cols(); ++column) {
        for (Sparse::InnerIterator it(summand, column); it; ++it) {
          if (it.row() >= column) sum_.coeffRef(it.row(), column) = it.value();
        }
      }
      values_.emplace_back(sum_.coeffs());
    }
  }

  const Sparse& Sum(const std::vector<double>& factors) {
    sum_.coeffs() = factors[0] * values_[0];
    for (size_t i = 1; i < factors.size(); ++i) sum_.coeffs() += factors[i] * values_[i];
    return sum_;
  }
  double LargestEntry(const std::vector<double>& factors) {
    return sum_.nonZeros() > 0 ? Sum(factors).coeffs().abs().maxCoeff() : 0.0;
  }

 private:
  Sparse sum_;
  std::vector<Eigen::ArrayXd> values_;
};

// Factors [H - s W + rho A^T A, A^T; A, -slack] for shifts s below the least curvature: it is positive definite in the
// unknowns and negative definite in the multipliers, and so needs no pivots.
class LeastCurvatureSearch {
 public:
  LeastCurvatureSearch(const Sparse& hessian, const Sparse& equations, const Sparse& metric)
      : hessian_(hessian),
        equations_(equations),
        metric_(metric),
        of_unknowns_({hessian, metric, equations.transpose() * equations}),
        of_all_(WithMultipliers({hessian, metric, equations.transpose() * equations}, equations)) {
    cholesky_.analyzePattern(of_unknowns_.Sum({1, 1, 1}));
    ldlt_.analyzePattern(of_all_.Sum({1, 1, 1, 1}));
    VectorXd diagonal = metric_.diagonal();
    start_ = VectorXd::Zero(diagonal.size());
    // Any start serves that is not orthogonal to the least direction by a symmetry.
    for (Eigen::Index i = 0; i < start_.size(); ++i) {
      if (diagonal[i] > 0) start_[i] = 1 + 0.5 * std::sin(1.0 + static_cast<double>(i) * static_cast<double>(i));
    }
  }

  // Finds the least curvature of H, or of -H if the sign is -1, and its direction.
  bool Find(double sign, double* least, VectorXd* direction) {
    sign_ = sign;
    double low = -1;
    while (!IsBelow(low)) {
      low *= 4;
      if (low < -1e16) return false;
    }
    VectorXd v = start_;
    double high = INFINITY;
    for (int shift = 0; shift < kMostShifts; ++shift) {
      VectorXd next;
      const bool solved = Solve(low, metric_ * v, &next);
      const double square = solved ? next.dot(metric_ * next) : 0;
      if (!(square > 0) || !std::isfinite(square)) break;
      v = next / std::sqrt(square);
      const double quotient = sign * v.dot(hessian_ * v);
      const bool settled = std::abs(quotient - high) <= kConverged * std::max(1.0, std::abs(quotient));
      if (quotient < high) {
        high = quotient;
        *direction = v;
      }
      if (settled || high - low <= kConverged * std::max(1.0, std::abs(high))) break;
      // The shift is as near to the upper bound as the factorization stays positive definite.
      for (const double part : {0.01, 0.1, 0.5}) {
        const double trial = high - part * (high - low);
        if (!IsBelow(trial)) continue;
        low = trial;
        break;
      }
    }
    *least = high;
    return std::isfinite(high);
  }

 private:
  static std::vector<Sparse> WithMultipliers(std::vector<Sparse> summands, const Sparse& equations) {
    const Eigen::Index n = equations.cols(), m = equations.rows();
    std::vector<Eigen::Triplet<double>> entries;
    for (Eigen::Index column = 0; column < n; ++column) {
      for (Sparse::InnerIterator it(equations, column); it; ++it)
        entries.emplace_back(n + it.row(), column, it.value());
    }
    for (Eigen::Index i = n; i < n + m; ++i) entries.emplace_back(i, i, -kSlack);
    for (Sparse& summand : summands) summand.conservativeResize(n + m, n + m);
    summands.emplace_back(n + m, n + m);
    summands.back().setFromTriplets(entries.begin(), entries.end());
    return summands;
  }

  double ScaleAt(double shift) {
    return std::max(of_unknowns_.LargestEntry({sign_, -shift, 0}), of_unknowns_.LargestEntry({0, 1, 0}));
  }

  // Whether H - s W is positive definite along the directions that the equations leave.
  bool IsBelow(double shift) {
    cholesky_.factorize(of_unknowns_.Sum({sign_, -shift, kPenalty * ScaleAt(shift)}));
    return cholesky_.info() == Eigen::Success;
  }

  // Solves (H - s W) x + A^T l = right with A x = 0, where the penalty is zero.
  bool Solve(double shift, const VectorXd& right, VectorXd* x) {
    const Eigen::Index n = hessian_.rows(), m = equations_.rows();
    const double scale = ScaleAt(shift);
    ldlt_.factorize(of_all_.Sum({sign_ / scale, -shift / scale, kPenalty, 1}));
    if (ldlt_.info() != Eigen::Success) return false;
    VectorXd solution = VectorXd::Zero(n + m), open(n + m);
    open << right / scale, VectorXd::Zero(m);
    for (int step = 0; step < kMostRefinements; ++step) {
      const VectorXd change = ldlt_.solve(open);
      if (!change.allFinite()) return false;
      solution += change;
      const auto unknowns = solution.head(n);
      open.tail(m) = -(equations_ * unknowns);
      open.head(n) = (right - sign_ * (hessian_ * unknowns) + shift * (metric_ * unknowns)) / scale -
                     equations_.transpose() * (solution.tail(m) - kPenalty * open.tail(m));
      if (open.tail(m).norm() <= 1e-14 * unknowns.norm()) break;
    }
    *x = solution.head(n);
    return (equations_ * *x).norm() <= kNoDirection * x->norm();
  }

  const Sparse &hessian_, &equations_, &metric_;
  Combination of_unknowns_, of_all_;  // of the Hessian, the metric, the penalty, and then A and the slack
  Eigen::SimplicialLLT<Sparse> cholesky_;
  Eigen::SimplicialLDLT<Sparse> ldlt_;
  VectorXd start_;
  double sign_ = 1;
};

}  // namespace

std::optional<ConstrainedCurvature> FindConstrainedCurvature(const Sparse& hessian, const Sparse& equations,
                                                             const Sparse& metric) {
  ConstrainedCurvature found;
  VectorXd of_largest;
  LeastCurvatureSearch search(hessian, equations, metric);
  if (!search.Find(1, &found.smallest, &found.direction) || !search.Find(-1, &found.largest, &of_largest)) {
    return std::nullopt;
  }
  found.largest = -found.largest;
  return found;
}

}  // namespace saltus
