#include "optimality/constrained_curvature.h"

#include <Eigen/SparseCholesky>
#include <algorithm>
#include <cmath>
#include <map>
#include <vector>

#include "base/linear_algebra.h"

namespace saltus {
namespace {

using Eigen::MatrixXd;
using Eigen::VectorXd;
using Sparse = Eigen::SparseMatrix<double>;

constexpr double kPenalty = 1e6;        // rho, relative to the largest entry of H - s W
constexpr double kConverged = 1e-8;     // relative, of the curvature
constexpr int kMostShifts = 60;         // factorizations
constexpr double kSlack = 1e-9;         // of the equations in factors, which makes up for redundant ones
constexpr int kMostRefinements = 8;     // of a solve
constexpr double kNoDirection = 1e-8;   // of a solution, relative to that without equations
constexpr double kSameAsMetric = 1e-9;  // of the metric: a difference of H and W that is rounding
constexpr int kMostFunctionals = 150;   // with which a dense matrix takes less time than the sparse ones
constexpr int kManyPartners = 30;       // entries of an unknown in H - W that one functional combines

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
        of_all_(AddMultiplierColumns({hessian, metric, equations.transpose() * equations}, equations)) {
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

 private:
  static std::vector<Sparse> AddMultiplierColumns(std::vector<Sparse> summands, const Sparse& equations) {
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

  const Sparse &hessian_, &equations_, &metric_;
  Combination of_unknowns_, of_all_;  // of the Hessian, the metric, the penalty, and then A and the slack
  Eigen::SimplicialLLT<Sparse> cholesky_;
  Eigen::SimplicialLDLT<Sparse> ldlt_;
  VectorXd start_;
  double sign_ = 1;
};

// The least curvature of M + F^T G F, with M positive definite, along directions d that keep what is held: F d is in
// the null space of `held`. Given are F M^-1 F^T and G; d^T M d = 1.
struct LeastCurvature {
  double smallest = 0, largest = 0;  // of F^T G F alone; M adds 1
  Eigen::VectorXd source;            // the direction is M^-1 F^T source; empty if no direction keeps what is held
  Eigen::Index rank = 0;             // of F M^-1 F^T
};
LeastCurvature FindLeastCurvature(const MatrixXd& gram, const MatrixXd& hessian, const MatrixXd& held) {
  constexpr double kRank = 1e-10;
  // Directions M^-1 F^T S p with S scaling each functional to one; p = Q w, orthonormal to integral |d|^2 dt.
  VectorXd scale(gram.rows());
  for (Eigen::Index i = 0; i < scale.size(); ++i) scale[i] = gram(i, i) > 0 ? 1 / std::sqrt(gram(i, i)) : 0.0;
  const SymmetricEigen metric = EigenOf(scale.asDiagonal() * gram * scale.asDiagonal());
  const VectorXd& sizes = metric.values;  // rising
  Eigen::Index first = 0;
  while (first < sizes.size() && sizes[first] <= kRank * sizes[sizes.size() - 1]) ++first;
  LeastCurvature result;
  result.rank = sizes.size() - first;
  // F d for the columns d of an orthonormal basis, and the functionals that make those columns.
  const MatrixXd vectors = metric.vectors.rightCols(result.rank);
  const VectorXd roots = sizes.tail(result.rank).cwiseSqrt();
  MatrixXd image = scale.cwiseInverse().asDiagonal() * vectors * roots.asDiagonal();
  for (Eigen::Index i = 0; i < scale.size(); ++i) {
    if (scale[i] == 0) image.row(i).setZero();
  }
  MatrixXd source = scale.asDiagonal() * vectors * roots.cwiseInverse().asDiagonal();
  if (held.rows() > 0) {
    MatrixXd rows = Multiply(held, image);
    for (Eigen::Index i = 0; i < rows.rows(); ++i) rows.row(i) /= std::max(rows.row(i).norm(), 1e-300);
    const MatrixXd kept = NullSpace(rows);
    image = Multiply(image, kept);
    source = Multiply(source, kept);
  }
  const Eigen::Index last = image.cols() - 1;
  if (last < 0) return result;
  const MatrixXd reduced = Multiply(MultiplyTransposed(image, hessian), image);
  const SymmetricEigen curvature = EigenOf(reduced);
  result.smallest = curvature.values[0];
  result.largest = curvature.values[last];
  result.source = source * curvature.vectors.col(0);
  return result;
}

// The form as that of few functionals of the variables.
class CondensedForm {
 public:
  CondensedForm(const Sparse& hessian, const Sparse& equations, const Sparse& metric,
                const std::vector<DefinedUnknown>& defined)
      : metric_(metric), equations_(equations), defined_(defined), other_(hessian - metric) {}

  // Returns std::nullopt if there are too many functionals, or if the equations do not determine the times.
  std::optional<ConstrainedCurvature> Find() {
    Classify();
    if (!FindFunctionals() || !FactorMetric()) return std::nullopt;
    const auto functionals = static_cast<Eigen::Index>(rows_.size());
    AddEquations();
    const auto all = static_cast<Eigen::Index>(rows_.size()), held = all - functionals;
    const auto num_times = static_cast<Eigen::Index>(times_.size());
    MatrixXd of_variables(all, variables_.size()), of_times(all, num_times);
    for (Eigen::Index i = 0; i < all; ++i) {
      const VectorXd row = PulledBack(rows_[i]);
      of_variables.row(i) = row(variables_);
      of_times.row(i) = row(times_);
    }
    // The times follow from the equations; the combinations of these that have no time hold variables.
    const MatrixXd by_times = of_times.bottomRows(held);
    const MatrixXd combined = num_times > 0 ? NullSpace(by_times.transpose()) : MatrixXd::Identity(held, held);
    if (combined.cols() != held - num_times) return std::nullopt;
    MatrixXd solved(num_times, held);  // t = -solved B_v v
    for (Eigen::Index i = 0; i < held && num_times > 0; ++i) {
      solved.col(i) = LeastSquaresSolution(by_times, VectorXd::Unit(held, i));
    }
    MatrixXd image = MatrixXd::Identity(functionals, all);
    image.rightCols(held) = -Multiply(of_times.topRows(functionals), solved);
    MatrixXd kept = MatrixXd::Zero(combined.cols(), all);
    kept.rightCols(held) = combined.transpose();
    const MatrixXd divided = metric_of_variables_.solve(of_variables.transpose());
    const LeastCurvature least =
        FindLeastCurvature(Multiply(of_variables, divided), Multiply(MultiplyTransposed(image, Form()), image), kept);
    ConstrainedCurvature found{1, 1, VectorXd::Zero(metric_.rows())};
    VectorXd along;
    if (least.source.size() > 0) {
      found.smallest = 1 + least.smallest;
      found.largest = 1 + least.largest;
      along = divided * least.source;
    }
    if (least.rank < of_variables.cols() && !(found.smallest < 1)) {
      // Along directions that functionals do not notice, or hardly, the curvature is 1.
      const Eigen::Index few = std::min(of_variables.cols(), all + 1);
      const MatrixXd noticed = of_variables.leftCols(few), unnoticed = NullSpace(noticed);
      found.smallest = 1;
      found.largest = std::max(found.largest, 1.0);
      along = VectorXd::Zero(of_variables.cols());
      along.head(few) = unnoticed.cols() > 0 ? VectorXd(unnoticed.col(0))
                                             : VectorXd(EigenOf(MultiplyTransposed(noticed, noticed)).vectors.col(0));
    }
    if (along.size() == 0) return std::nullopt;
    found.direction(variables_) = along;
    found.direction(times_) = -solved * (of_variables.bottomRows(held) * along);
    for (const DefinedUnknown& state : defined_) {
      double sum = 0, own = 0;
      for (RowMajor::InnerIterator it(equations_, state.equation); it; ++it) {
        (it.col() == state.unknown ? own : sum) +=
            it.value() * (it.col() == state.unknown ? 1 : found.direction[it.col()]);
      }
      found.direction[state.unknown] = -sum / own;
    }
    found.direction /= std::sqrt(found.direction.dot(metric_ * found.direction));
    return found;
  }

 private:
  using Row = std::vector<std::pair<int, double>>;

  void Classify() {
    std::vector<char> is_defined(metric_.rows(), 0);
    for (const DefinedUnknown& state : defined_) is_defined[state.unknown] = 1;
    for (int i = 0; i < metric_.rows(); ++i) {
      if (!is_defined[i]) (metric_.coeff(i, i) > 0 ? variables_ : times_).push_back(i);
    }
  }

  // Finds the functionals: unknowns between which H - W has entries, and for each unknown with many such entries the
  // sum of these.
  bool FindFunctionals() {
    other_.prune([&](Eigen::Index i, Eigen::Index j, double value) {
      return std::abs(value) > kSameAsMetric * std::sqrt(metric_.coeff(i, i) * metric_.coeff(j, j));
    });
    std::vector<char> is_hub(other_.cols(), 0);
    for (int j = 0; j < other_.cols(); ++j) is_hub[j] = other_.innerVector(j).nonZeros() > kManyPartners;
    std::map<int, int> place;  // of an unknown among the functionals
    const auto functional_of = [&](int unknown) {
      const auto [at, is_new] = place.try_emplace(unknown, static_cast<int>(rows_.size()));
      if (is_new) rows_.push_back({{unknown, 1.0}});
      return at->second;
    };
    for (int j = 0; j < other_.cols(); ++j) {
      Row sum;
      for (Sparse::InnerIterator it(other_, j); it; ++it) {
        if (is_hub[j] && !is_hub[it.row()]) {
          sum.emplace_back(it.row(), it.value());
        } else if (is_hub[j] || !is_hub[it.row()]) {
          form_.emplace_back(functional_of(it.row()), functional_of(j), it.value());
        }
      }
      if (!sum.empty()) {
        const int at = functional_of(j), of_sum = static_cast<int>(rows_.size());
        rows_.push_back(std::move(sum));
        form_.emplace_back(at, of_sum, 1.0);
        form_.emplace_back(of_sum, at, 1.0);
      }
      if (rows_.size() > kMostFunctionals) return false;
    }
    return true;
  }
  MatrixXd Form() const {
    Eigen::Index size = 0;
    for (const auto& entry : form_) size = std::max<Eigen::Index>(size, 1 + std::max(entry.row(), entry.col()));
    MatrixXd form = MatrixXd::Zero(size, size);
    for (const auto& entry : form_) form(entry.row(), entry.col()) += entry.value();
    return form;
  }

  bool FactorMetric() {
    std::vector<int> place(metric_.rows(), -1);
    for (size_t i = 0; i < variables_.size(); ++i) place[variables_[i]] = static_cast<int>(i);
    std::vector<Eigen::Triplet<double>> entries;
    for (int j = 0; j < metric_.cols(); ++j) {
      for (Sparse::InnerIterator it(metric_, j); it; ++it) entries.emplace_back(place[it.row()], place[j], it.value());
    }
    Sparse of_variables(static_cast<int>(variables_.size()), static_cast<int>(variables_.size()));
    of_variables.setFromTriplets(entries.begin(), entries.end());
    metric_of_variables_.compute(of_variables);
    return metric_of_variables_.info() == Eigen::Success;
  }

  // Adds the equations that define no unknown to the functionals.
  void AddEquations() {
    std::vector<char> defines(equations_.rows(), 0);
    for (const DefinedUnknown& state : defined_) defines[state.equation] = 1;
    for (int i = 0; i < equations_.rows(); ++i) {
      if (defines[i]) continue;
      Row& row = rows_.emplace_back();
      for (RowMajor::InnerIterator it(equations_, i); it; ++it) row.emplace_back(it.col(), it.value());
    }
  }

  // Returns a functional of the unknowns that are not defined.
  VectorXd PulledBack(const Row& row) const {
    VectorXd all = VectorXd::Zero(metric_.rows());
    for (const auto& [unknown, value] : row) all[unknown] += value;
    for (auto state = defined_.rbegin(); state != defined_.rend(); ++state) {
      if (all[state->unknown] == 0) continue;
      const double weight = all[state->unknown] / equations_.coeff(state->equation, state->unknown);
      for (RowMajor::InnerIterator it(equations_, state->equation); it; ++it) all[it.col()] -= weight * it.value();
      all[state->unknown] = 0;
    }
    return all;
  }

  using RowMajor = Eigen::SparseMatrix<double, Eigen::RowMajor>;
  const Sparse& metric_;
  const RowMajor equations_;
  const std::vector<DefinedUnknown>& defined_;
  Sparse other_;  // H - W
  std::vector<int> variables_, times_;
  std::vector<Row> rows_;                     // of the functionals
  std::vector<Eigen::Triplet<double>> form_;  // G
  Eigen::SimplicialLLT<Sparse> metric_of_variables_;
};

}  // namespace

std::optional<ConstrainedCurvature> FindConstrainedCurvature(const Sparse& hessian, const Sparse& equations,
                                                             const Sparse& metric,
                                                             const std::vector<DefinedUnknown>& defined) {
  if (auto condensed = CondensedForm(hessian, equations, metric, defined).Find()) return condensed;
  ConstrainedCurvature found;
  VectorXd of_largest;
  LeastCurvatureSearch search(hessian, equations, metric);
  if (!search.Find(1, &found.smallest, &found.direction) || !search.Find(-1, &found.largest, &of_largest)) {
    return std::nullopt;
  }
  found.largest = -found.largest;
  return found;
}

std::optional<VectorXd> SolveConstrained(const Sparse& hessian, const Sparse& equations, const Sparse& metric,
                                         const VectorXd& right) {
  VectorXd x;
  LeastCurvatureSearch search(hessian, equations, metric);
  if (!search.IsBelow(0) || !search.Solve(0, right, &x)) return std::nullopt;
  return x;
}

}  // namespace saltus
