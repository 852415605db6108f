// Factorizations of sparse matrices, compiled once in sparse_factors.cc.
#pragma once

#include <Eigen/SparseCore>
#include <memory>
#include <vector>

namespace saltus {

using SparseMatrix = Eigen::SparseMatrix<double>;

// Returns the square matrix whose entries are the sums of the given ones at each place, and zero elsewhere.
SparseMatrix SparseFromEntries(Eigen::Index size, const std::vector<Eigen::Triplet<double>>& entries);

// The factorization L D L^T of a symmetric matrix. Only its lower half is read.
class SparseLdlt {
 public:
  SparseLdlt();
  ~SparseLdlt();

  // Returns false if the factorization does not exist (a zero pivot).
  bool Factor(const SparseMatrix& matrix);
  // Factor() in two parts, for several matrices with the same sparsity pattern: the order of elimination, which depends
  // on the pattern only, and the numerical factorization.
  void Analyze(const SparseMatrix& matrix);
  bool FactorAnalyzed(const SparseMatrix& matrix);
  Eigen::VectorXd Solve(const Eigen::VectorXd& right) const;

 private:
  struct Factors;
  std::unique_ptr<Factors> factors_;
};

// The factorization P L U Q of a square matrix, which also solves with the transposed matrix.
class SparseLu {
 public:
  SparseLu();
  ~SparseLu();

  // Returns false if the matrix is singular.
  bool Factor(const SparseMatrix& matrix);
  Eigen::VectorXd Solve(const Eigen::VectorXd& right) const;
  Eigen::VectorXd SolveTransposed(const Eigen::VectorXd& right) const;

 private:
  struct Factors;
  std::unique_ptr<Factors> factors_;
};

}  // namespace saltus
