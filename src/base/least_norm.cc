// What linear_algebra.h has of the complete orthogonal decomposition, of matrices by columns.
#include "base/linear_algebra.h"

namespace saltus {

LeastNormSolver::LeastNormSolver(const ConstMatrixRef& matrix, std::optional<double> threshold) {
  const auto compute = [&](auto& decomposition) {
    if (threshold) decomposition.setThreshold(*threshold);
    decomposition.compute(matrix);
  };
  if (matrix.rows() <= kMostSmallRows && matrix.cols() <= kMostSmallRows) {
    compute(decomposition_.emplace<0>());
  } else {
    compute(decomposition_.emplace<1>());
  }
}

void LeastNormSolver::Solve(const ConstVectorRef& right, VectorRef solution) const {
  if (const auto* small = std::get_if<0>(&decomposition_)) {
    using SmallVector = Eigen::Matrix<double, Eigen::Dynamic, 1, 0, kMostSmallRows, 1>;
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
  return matrix.completeOrthogonalDecomposition().solve(right);
}

void PseudoInvert(const ConstMatrixRef& matrix, std::optional<double> threshold, MatrixRef inverse) {
  const auto invert = [&](auto decomposition) {
    if (threshold) decomposition.setThreshold(*threshold);
    decomposition.compute(matrix);
    inverse = decomposition.pseudoInverse();
  };
  if (matrix.rows() <= kMostSmallRows) {
    using Small = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, 0, kMostSmallRows, kMostSmallRows>;
    invert(Eigen::CompleteOrthogonalDecomposition<Small>());
  } else {
    invert(Eigen::CompleteOrthogonalDecomposition<Eigen::MatrixXd>());
  }
}

Eigen::MatrixXd PseudoInverse(const Eigen::MatrixXd& matrix) {
  Eigen::MatrixXd inverse(matrix.cols(), matrix.rows());
  PseudoInvert(matrix, {}, inverse);
  return inverse;
}

Eigen::MatrixXd SchurComplement(const Eigen::MatrixXd& information, Eigen::Index count) {
  const Eigen::Index rest = information.cols() - count;
  if (rest == 0) return information;
  const Eigen::MatrixXd cross = information.topRightCorner(count, rest);
  const Eigen::MatrixXd others = information.bottomRightCorner(rest, rest);
  return information.topLeftCorner(count, count) -
         cross * others.completeOrthogonalDecomposition().solve(cross.transpose());
}

}  // namespace saltus
