#include "contact/solvers/complementarity.h"

#include <cmath>
#include <numeric>
#include <utility>
#include <vector>

#include "base/linear_algebra.h"
#include "contact/thresholds.h"

namespace saltus {
namespace {

// w - M z - z0 = q, where the columns of the variables are w, z, z0; each row is solved for one of them.
class Tableau {
 public:
  Tableau(const Eigen::MatrixXd& M, const Eigen::VectorXd& q)
      : n_(static_cast<int>(q.size())),
        rows_(n_, 2 * n_ + 2),
        basis_(n_),
        smallest_(internal::kLemkePivot * M.cwiseAbs().maxCoeff()),
        tie_(internal::kLemkeTie * q.cwiseAbs().maxCoeff()) {
    rows_ << Eigen::MatrixXd::Identity(n_, n_), -M, Eigen::VectorXd::Constant(n_, -1), q;
    std::iota(basis_.begin(), basis_.end(), 0);
  }

  int artificial() const { return 2 * n_; }
  int Complement(int variable) const { return variable < n_ ? variable + n_ : variable - n_; }

  // Solves `row` for `variable`; returns the variable for which it was solved before.
  int Pivot(int row, int variable) {
    rows_.row(row) /= rows_(row, variable);
    for (int i = 0; i < n_; ++i) {
      if (const double factor = rows_(i, variable); i != row && factor != 0) rows_.row(i) -= factor * rows_.row(row);
    }
    return std::exchange(basis_[row], variable);
  }

  // Returns the row whose variable becomes negative first as `variable` grows; at a tie that of z0, else that of the
  // largest pivot. Returns std::nullopt if none does.
  std::optional<int> Leaving(int variable) const {
    std::optional<int> leaving;
    double least = std::numeric_limits<double>::infinity();
    for (int i = 0; i < n_; ++i) {
      if (rows_(i, variable) <= smallest_) continue;
      const double ratio = rows_(i, 2 * n_ + 1) / rows_(i, variable), tie = tie_ / rows_(i, variable);
      const bool tied = leaving && std::abs(ratio - least) <= tie;
      if (tied ? Prefers(i, *leaving, variable) : ratio < least) leaving = i;
      least = std::min(least, ratio);
    }
    return leaving;
  }

  Eigen::VectorXd Solution() const {
    Eigen::VectorXd z = Eigen::VectorXd::Zero(n_);
    for (int i = 0; i < n_; ++i) {
      if (basis_[i] >= n_) z[basis_[i] - n_] = rows_(i, 2 * n_ + 1);
    }
    return z;
  }

 private:
  bool Prefers(int row, int other, int variable) const {
    if (basis_[other] == artificial()) return false;
    return basis_[row] == artificial() || rows_(row, variable) > rows_(other, variable);
  }

  const int n_;
  Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor> rows_;
  std::vector<int> basis_;
  const double smallest_, tie_;
};

}  // namespace

bool BlockPivoting::ChangesAll(std::size_t num_wrong) {
  if (num_wrong < fewest_) {
    fewest_ = num_wrong;
    patience_ = internal::kBlockPatience;
  } else {
    --patience_;
  }
  return patience_ >= 0;
}

std::optional<Eigen::VectorXd> SolveByLemke(const Eigen::MatrixXd& M, const Eigen::VectorXd& q, int most_pivots) {
  int row = 0;
  if (q.size() == 0 || q.minCoeff(&row) >= 0) return Eigen::VectorXd::Zero(q.size());
  Tableau tableau(M, q);
  int entering = tableau.artificial();
  for (int count = 0; count < most_pivots; ++count) {
    const int left = tableau.Pivot(row, entering);
    if (left == tableau.artificial()) return tableau.Solution();
    entering = tableau.Complement(left);
    const std::optional<int> leaving = tableau.Leaving(entering);
    if (!leaving) return std::nullopt;
    row = *leaving;
  }
  return std::nullopt;
}

// Unknowns are the normal forces of all contacts and, for each that does not slide, its tangential forces to the left
// and to the right and the acceleration at which it begins to slide.
std::optional<Eigen::VectorXd> SolveFrictionalLcp(std::span<const double> friction, const Eigen::MatrixXd& responses,
                                                  const Eigen::VectorXd& given, std::span<const int> sliding) {
  const int n = static_cast<int>(sliding.size());
  std::vector<int> resting;
  for (int k = 0; k < n; ++k) {
    if (sliding[k] == 0 && friction[k] > 0) resting.push_back(k);
  }
  const int size = n + 3 * static_cast<int>(resting.size());
  if (size > internal::kMostComplementaryRows) return std::nullopt;
  Eigen::MatrixXd forces = Eigen::MatrixXd::Zero(2 * n, size);  // of unknowns
  for (int k = 0; k < n; ++k) {
    forces(2 * k, k) = 1;
    forces(2 * k + 1, k) = -friction[k] * sliding[k];
  }
  for (int i = 0; i < static_cast<int>(resting.size()); ++i) {
    forces(2 * resting[i] + 1, n + 3 * i) = -1;
    forces(2 * resting[i] + 1, n + 3 * i + 1) = 1;
  }
  const Eigen::MatrixXd accelerations = Multiply(responses, forces);
  Eigen::MatrixXd matrix = Eigen::MatrixXd::Zero(size, size);
  Eigen::VectorXd constant = Eigen::VectorXd::Zero(size);
  for (int k = 0; k < n; ++k) {
    matrix.row(k) = accelerations.row(2 * k);
    constant[k] = given[2 * k];
  }
  for (int i = 0; i < static_cast<int>(resting.size()); ++i) {
    const int k = resting[i], left = n + 3 * i, right = left + 1, speed = left + 2;
    matrix.row(left) = -accelerations.row(2 * k + 1);
    matrix.row(right) = accelerations.row(2 * k + 1);
    constant[left] = -given[2 * k + 1];
    constant[right] = given[2 * k + 1];
    matrix(left, speed) = matrix(right, speed) = 1;
    matrix(speed, k) = friction[k];
    matrix(speed, left) = matrix(speed, right) = -1;
  }
  const std::optional<Eigen::VectorXd> found = SolveByLemke(matrix, constant, internal::kLemkePivotsPerRow * size);
  if (!found) return std::nullopt;
  return forces * *found;
}

}  // namespace saltus
