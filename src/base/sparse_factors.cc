#include "base/sparse_factors.h"

#include <Eigen/SparseCholesky>
#include <Eigen/SparseLU>

namespace saltus {

SparseMatrix SparseFromEntries(Eigen::Index size, const std::vector<Eigen::Triplet<double>>& entries) {
  SparseMatrix matrix(size, size);
  matrix.setFromTriplets(entries.begin(), entries.end());
  return matrix;
}

struct SparseLdlt::Factors {
  Eigen::SimplicialLDLT<SparseMatrix> ldlt;
};

SparseLdlt::SparseLdlt() : factors_(std::make_unique<Factors>()) {}
SparseLdlt::~SparseLdlt() = default;

bool SparseLdlt::Factor(const SparseMatrix& matrix) {
  factors_->ldlt.compute(matrix);
  return factors_->ldlt.info() == Eigen::Success;
}

void SparseLdlt::Analyze(const SparseMatrix& matrix) { factors_->ldlt.analyzePattern(matrix); }

bool SparseLdlt::FactorAnalyzed(const SparseMatrix& matrix) {
  factors_->ldlt.factorize(matrix);
  return factors_->ldlt.info() == Eigen::Success;
}

Eigen::VectorXd SparseLdlt::Solve(const Eigen::VectorXd& right) const { return factors_->ldlt.solve(right); }

struct SparseLu::Factors {
  Eigen::SparseLU<SparseMatrix> given, transposed;
};

SparseLu::SparseLu() : factors_(std::make_unique<Factors>()) {}
SparseLu::~SparseLu() = default;

bool SparseLu::Factor(const SparseMatrix& matrix) {
  factors_->given.compute(matrix);
  factors_->transposed.compute(SparseMatrix(matrix.transpose()));
  return factors_->given.info() == Eigen::Success && factors_->transposed.info() == Eigen::Success;
}

Eigen::VectorXd SparseLu::Solve(const Eigen::VectorXd& right) const { return factors_->given.solve(right); }

Eigen::VectorXd SparseLu::SolveTransposed(const Eigen::VectorXd& right) const {
  return factors_->transposed.solve(right);
}

}  // namespace saltus
