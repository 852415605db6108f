#include "contact/solvers/lemke.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>
#include <utility>
#include <vector>

namespace saltus {
namespace {

constexpr double kPivot = 1e-11;  // of the largest entry of M: what is smaller is rounding
constexpr double kTie = 1e-15;    // of the largest entry of q

// w - M z - z0 = q, where the columns of the variables are w, z, z0; each row is solved for one of them.
class Tableau {
 public:
  Tableau(const Eigen::MatrixXd& M, const Eigen::VectorXd& q)
      : n_(static_cast<int>(q.size())),
        rows_(n_, 2 * n_ + 2),
        basis_(n_),
        smallest_(kPivot * M.cwiseAbs().maxCoeff()),
        tie_(kTie * q.cwiseAbs().maxCoeff()) {
    rows_ << Eigen::MatrixXd::Identity(n_, n_), -M, Eigen::VectorXd::Constant(n_, -1), q;
    std::iota(basis_.begin(), basis_.end(), 0);
  }

  int artificial() const { return 2 * n_; }
  int Complement(int variable) const { return variable < n_ ? variable + n_ : variable - n_; }

  // Solves `row` for `variable`; returns that for which it was solved.
  int Pivot(int row, int variable) {
    rows_.row(row) /= rows_(row, variable);
    for (int i = 0; i < n_; ++i) {
      if (const double factor = rows_(i, variable); i != row && factor != 0) rows_.row(i) -= factor * rows_.row(row);
    }
    return std::exchange(basis_[row], variable);
  }

  // The row that is the first to become negative as `variable` grows: z0's of several, else that of the largest pivot.
  // None if there is none.
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

}  // namespace saltus
