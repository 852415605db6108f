// The complete orthogonal decompositions of linear_algebra.h. They are compiled for two types of matrices (bounded and
// dynamic size), with right-hand sides of the same type only. Other types are copied, as each further instantiation
// takes seconds to compile.
#include <algorithm>

#include "base/linear_algebra.h"

namespace saltus {
namespace {

using SmallMatrix = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, 0, kMostSmallRows, kMostSmallRows>;
using SmallVector = Eigen::Matrix<double, Eigen::Dynamic, 1, 0, kMostSmallRows, 1>;

template <typename Matrix>
void Compute(const auto& matrix, std::optional<double> threshold,
             Eigen::CompleteOrthogonalDecomposition<Matrix>* decomposition) {
  if (threshold) decomposition->setThreshold(*threshold);
  decomposition->compute(matrix);
}

template <typename Matrix>
Matrix Solutions(const auto& matrix, std::optional<double> threshold, const Matrix& right) {
  if (matrix.size() == 0) return Matrix::Zero(matrix.cols(), right.cols());  // Eigen does not decompose it
  Eigen::CompleteOrthogonalDecomposition<Matrix> decomposition;
  Compute(matrix, threshold, &decomposition);
  return decomposition.solve(right);
}

template <typename Matrix>
Matrix Inverse(const auto& matrix, std::optional<double> threshold) {
  return Solutions<Matrix>(matrix, threshold, Matrix::Identity(matrix.rows(), matrix.rows()));
}

// Sets `inverse` to the pseudo-inverse of `matrix`, which may be stored by rows or by columns.
void InvertInto(const auto& matrix, std::optional<double> threshold, auto* inverse) {
  if (matrix.rows() <= kMostSmallRows) {
    *inverse = Inverse<SmallMatrix>(matrix, threshold);
  } else {
    *inverse = Inverse<Eigen::MatrixXd>(matrix, threshold);
  }
}

}  // namespace

LeastNormSolver::LeastNormSolver(const ConstMatrixRef& matrix, std::optional<double> threshold) {
  if (matrix.size() == 0) return;
  if (matrix.rows() <= kMostSmallRows && matrix.cols() <= kMostSmallRows) {
    Compute(matrix, threshold, &decomposition_.emplace<0>());
  } else {
    Compute(matrix, threshold, &decomposition_.emplace<1>());
  }
}

void LeastNormSolver::Solve(const ConstVectorRef& right, VectorRef solution) const {
  if (const auto* small = std::get_if<0>(&decomposition_)) {
    if (small->rows() == 0) {  // of an empty matrix
      solution.setZero();
      return;
    }
    const SmallVector copy = right, found = small->solve(copy);
    solution = found;
  } else {
    const Eigen::VectorXd copy = right, found = std::get<1>(decomposition_).solve(copy);
    solution = found;
  }
}

Eigen::VectorXd LeastNormSolution(const Eigen::MatrixXd& matrix, const Eigen::VectorXd& right) {
  Eigen::VectorXd solution(matrix.cols());
  LeastNormSolver(matrix).Solve(right, solution);
  return solution;
}

Eigen::MatrixXd LeastNormSolutions(const Eigen::MatrixXd& matrix, const Eigen::MatrixXd& right) {
  if (std::max({matrix.rows(), matrix.cols(), right.cols()}) <= kMostSmallRows) {
    return Solutions<SmallMatrix>(matrix, {}, right);
  }
  return Solutions<Eigen::MatrixXd>(matrix, {}, right);
}

void PseudoInvert(const ConstMatrixRef& matrix, std::optional<double> threshold, MatrixRef inverse) {
  InvertInto(matrix, threshold, &inverse);
}

Eigen::MatrixXd PseudoInverse(const Eigen::MatrixXd& matrix) {
  Eigen::MatrixXd inverse(matrix.cols(), matrix.rows());
  PseudoInvert(matrix, {}, inverse);
  return inverse;
}

// Inverts by rows, because inverting the transpose instead would choose other pivots, and so round otherwise.
void PseudoInvertRows(int n, std::span<double> matrix, double threshold) {
  using RowMajor = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;
  Eigen::Map<RowMajor> rows(matrix.data(), n, n);
  InvertInto(rows, threshold, &rows);
}

Eigen::MatrixXf PseudoInverse(const Eigen::MatrixXf& matrix) {
  return matrix.completeOrthogonalDecomposition().pseudoInverse();
}

Eigen::MatrixXd SchurComplement(const Eigen::MatrixXd& information, Eigen::Index count) {
  const Eigen::Index rest = information.cols() - count;
  if (rest == 0) return information;
  const Eigen::MatrixXd cross = information.topRightCorner(count, rest);
  const Eigen::MatrixXd others = information.bottomRightCorner(rest, rest);
  const Eigen::MatrixXd right = cross.transpose();
  return information.topLeftCorner(count, count) - cross * others.completeOrthogonalDecomposition().solve(right);
}

}  // namespace saltus
