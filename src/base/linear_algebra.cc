// The functions of linear_algebra.h that do not need the complete orthogonal decomposition (for that: least_norm.cc).
#include "base/linear_algebra.h"

#include <Eigen/Dense>
#include <cmath>

namespace saltus {

Eigen::VectorXd SolveLu(const Eigen::MatrixXd& matrix, const Eigen::VectorXd& right) {
  return matrix.partialPivLu().solve(right);
}

Eigen::MatrixXd SolveLuColumns(const Eigen::MatrixXd& matrix, const Eigen::MatrixXd& right) {
  return matrix.partialPivLu().solve(right);
}

Eigen::VectorXd SolveFullPivotLu(const Eigen::MatrixXd& matrix, const Eigen::VectorXd& right) {
  return matrix.fullPivLu().solve(right);
}

std::optional<Eigen::VectorXd> SolveCholesky(const Eigen::MatrixXd& matrix, const Eigen::VectorXd& right) {
  const Eigen::LLT<Eigen::MatrixXd> factor(matrix);
  if (factor.info() != Eigen::Success) return std::nullopt;
  return factor.solve(right);
}

void SolveCholeskyInPlace(MatrixRef matrix, MatrixRef right) { Eigen::LLT<MatrixRef>(matrix).solveInPlace(right); }

CholeskySolver::CholeskySolver(const Eigen::MatrixXd& matrix) : factor_(matrix) {}
Eigen::MatrixXd CholeskySolver::Solve(const Eigen::MatrixXd& right) const { return factor_.solve(right); }
Eigen::VectorXd CholeskySolver::SolveLower(const Eigen::VectorXd& right) const {
  return factor_.matrixL().solve(right);
}
double CholeskySolver::LogDeterminant() const {
  double logarithm = 0;
  for (Eigen::Index i = 0; i < factor_.rows(); ++i) logarithm += 2 * std::log(factor_.matrixLLT()(i, i));
  return logarithm;
}

Eigen::VectorXd SolveLdlt(const Eigen::MatrixXd& matrix, const Eigen::VectorXd& right) {
  return matrix.ldlt().solve(right);
}

Eigen::VectorXd LeastSquaresSolution(const Eigen::MatrixXd& matrix, const Eigen::VectorXd& right) {
  return matrix.colPivHouseholderQr().solve(right);
}

Eigen::MatrixXd NullSpace(const Eigen::MatrixXd& rows) {
  if (rows.size() == 0) return Eigen::MatrixXd::Identity(rows.cols(), rows.cols());
  const Eigen::ColPivHouseholderQR<Eigen::MatrixXd> qr(rows.transpose());
  const Eigen::MatrixXd q = qr.householderQ() * Eigen::MatrixXd::Identity(rows.cols(), rows.cols());
  return q.rightCols(rows.cols() - qr.rank());
}

SymmetricEigen EigenOf(const Eigen::MatrixXd& symmetric) {
  if (symmetric.size() == 0) return {};
  const Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd> solver(symmetric);
  return {solver.eigenvalues(), solver.eigenvectors()};
}

void Multiply(const ConstMatrixRef& a, const ConstMatrixRef& b, MatrixRef product) { product.noalias() = a * b; }

void MultiplyTransposed(const ConstMatrixRef& a, const ConstMatrixRef& b, MatrixRef product) {
  product.noalias() = a.transpose() * b;
}

void MultiplyByTransposed(const ConstMatrixRef& a, const ConstMatrixRef& b, MatrixRef product) {
  product.noalias() = a * b.transpose();
}

Eigen::MatrixXd Multiply(const ConstMatrixRef& a, const ConstMatrixRef& b) {
  Eigen::MatrixXd product(a.rows(), b.cols());
  Multiply(a, b, product);
  return product;
}

Eigen::MatrixXd MultiplyTransposed(const ConstMatrixRef& a, const ConstMatrixRef& b) {
  Eigen::MatrixXd product(a.cols(), b.cols());
  MultiplyTransposed(a, b, product);
  return product;
}

Eigen::MatrixXd MultiplyByTransposed(const ConstMatrixRef& a, const ConstMatrixRef& b) {
  Eigen::MatrixXd product(a.rows(), b.rows());
  MultiplyByTransposed(a, b, product);
  return product;
}

void AddProduct(const ConstMatrixRef& a, const ConstMatrixRef& b, Eigen::MatrixXd* sum) { sum->noalias() += a * b; }

void AddGram(double weight, const Eigen::MatrixXd& a, Eigen::MatrixXd* sum) { *sum += weight * a.transpose() * a; }

}  // namespace saltus
