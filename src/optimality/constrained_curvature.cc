#include "optimality/constrained_curvature.h"

#include <Eigen/SparseCholesky>
#include <Eigen/SparseLU>
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
constexpr double kSlack = 1e-13;       // of the equations in a solve, which makes up for redundant ones
constexpr int kMostRefinements = 8;    // of a solve
constexpr double kNoDirection = 1e-8;  // of a solution, relative to that without equations

double LargestEntry(const Sparse& matrix) {
  return matrix.nonZeros() > 0 ? matrix.coeffs().cwiseAbs().maxCoeff() : 0.0;
}

class LeastCurvatureSearch {
 public:
  LeastCurvatureSearch(const Sparse& hessian, const Sparse& equations, const Sparse& metric)
      : hessian_(hessian), equations_(equations), metric_(metric), gram_(equations.transpose() * equations) {
    VectorXd diagonal = metric_.diagonal();
    start_ = VectorXd::Zero(diagonal.size());
    // Any start serves that is not orthogonal to the least direction by a symmetry.
    for (Eigen::Index i = 0; i < start_.size(); ++i) {
      if (diagonal[i] > 0) start_[i] = 1 + 0.5 * std::sin(1.0 + static_cast<double>(i) * static_cast<double>(i));
    }
  }

  // Finds the least curvature and its direction.
  bool Find(double* least, VectorXd* direction) {
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
      const double quotient = v.dot(hessian_ * v);
      const bool settled = std::abs(quotient - high) <= kConverged * std::max(1.0, std::abs(quotient));
      high = std::min(high, quotient);
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
    *direction = v;
    return std::isfinite(high);
  }

 private:
  // Whether H - s W is positive definite along the directions that the equations leave.
  bool IsBelow(double shift) {
    const Sparse shifted = hessian_ - shift * metric_;
    const Sparse matrix = shifted + kPenalty * std::max(LargestEntry(shifted), LargestEntry(metric_)) * gram_;
    if (!analyzed_) cholesky_.analyzePattern(matrix);
    analyzed_ = true;
    cholesky_.factorize(matrix);
    return cholesky_.info() == Eigen::Success;
  }

  // Solves (H - s W) x + A^T l = right with A x = 0.
  bool Solve(double shift, const VectorXd& right, VectorXd* x) const {
    const Eigen::Index n = hessian_.rows(), m = equations_.rows();
    const Sparse shifted = hessian_ - shift * metric_;
    const double scale = std::max(LargestEntry(shifted), LargestEntry(metric_));
    std::vector<Eigen::Triplet<double>> entries;
    for (Eigen::Index column = 0; column < n; ++column) {
      for (Sparse::InnerIterator it(shifted, column); it; ++it)
        entries.emplace_back(it.row(), column, it.value() / scale);
      for (Sparse::InnerIterator it(equations_, column); it; ++it) {
        entries.emplace_back(n + it.row(), column, it.value());
        entries.emplace_back(column, n + it.row(), it.value());
      }
    }
    for (Eigen::Index i = n; i < n + m; ++i) entries.emplace_back(i, i, -kSlack);
    Sparse matrix(n + m, n + m);
    matrix.setFromTriplets(entries.begin(), entries.end());
    Eigen::SparseLU<Sparse> factors(matrix);
    if (factors.info() != Eigen::Success) return false;
    VectorXd solution = VectorXd::Zero(n + m), open(n + m);
    open << right / scale, VectorXd::Zero(m);
    for (int step = 0; step < kMostRefinements; ++step) {
      const VectorXd change = factors.solve(open);
      if (!change.allFinite()) return false;
      solution += change;
      open.head(n) = (right - shifted * solution.head(n)) / scale - equations_.transpose() * solution.tail(m);
      open.tail(m) = -(equations_ * solution.head(n));
      if (open.tail(m).norm() <= 1e-14 * solution.head(n).norm()) break;
    }
    *x = solution.head(n);
    return (equations_ * *x).norm() <= kNoDirection * x->norm();
  }

  const Sparse &hessian_, &equations_, &metric_;
  const Sparse gram_;
  Eigen::SimplicialLLT<Sparse> cholesky_;
  VectorXd start_;
  bool analyzed_ = false;
};

}  // namespace

std::optional<ConstrainedCurvature> FindConstrainedCurvature(const Sparse& hessian, const Sparse& equations,
                                                             const Sparse& metric) {
  ConstrainedCurvature found;
  if (!LeastCurvatureSearch(hessian, equations, metric).Find(&found.smallest, &found.direction)) return std::nullopt;
  VectorXd of_largest;
  const Sparse negative = -hessian;
  if (!LeastCurvatureSearch(negative, equations, metric).Find(&found.largest, &of_largest)) return std::nullopt;
  found.largest = -found.largest;
  return found;
}

}  // namespace saltus
