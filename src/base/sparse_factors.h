// Factorizations of sparse matrices, compiled once in sparse_factors.cc.
#pragma once

#include <Eigen/SparseCore>
#include <memory>
#include <vector>

namespace saltus {

using SparseMatrix = Eigen::SparseMatrix<double>;

// Of the entries' sums; what is not named is zero.
SparseMatrix SparseFromEntries(Eigen::Index size, const std::vector<Eigen::Triplet<double>>& entries);

// L D L^T of a symmetric matrix, of which the lower half counts.
class SparseLdlt {
 public:
  SparseLdlt();
  ~SparseLdlt();

  // False if the matrix has no factors.
  bool Factor(const SparseMatrix& matrix);
  // The same in two parts, for matrices that have their entries at the same places: the order of elimination, which
  // depends on these places alone, and the factors.
  void Analyze(const SparseMatrix& matrix);
  bool FactorAnalyzed(const SparseMatrix& matrix);
  Eigen::VectorXd Solve(const Eigen::VectorXd& right) const;

 private:
  struct Factors;
  std::unique_ptr<Factors> factors_;
};

// P L U Q of a square matrix and of its transpose.
class SparseLu {
 public:
  SparseLu();
  ~SparseLu();

  // False if the matrix is singular.
  bool Factor(const SparseMatrix& matrix);
  Eigen::VectorXd Solve(const Eigen::VectorXd& right) const;
  Eigen::VectorXd SolveTransposed(const Eigen::VectorXd& right) const;

 private:
  struct Factors;
  std::unique_ptr<Factors> factors_;
};

}  // namespace saltus
