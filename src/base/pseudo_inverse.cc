// Pseudo-inverses of linear_algebra.h for matrices by rows, and in float.
#include "base/linear_algebra.h"

namespace saltus {

Eigen::MatrixXf PseudoInverse(const Eigen::MatrixXf& matrix) {
  return matrix.completeOrthogonalDecomposition().pseudoInverse();
}

// Not the inverse of the transpose: that would pivot otherwise.
void PseudoInvertRows(int n, std::span<double> matrix, double threshold) {
  using RowMajor = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;
  using Small = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor, kMostSmallRows, kMostSmallRows>;
  const auto invert = [&](auto decomposition) {
    Eigen::Map<RowMajor> map(matrix.data(), n, n);
    decomposition.setThreshold(threshold);
    decomposition.compute(map);
    map = decomposition.pseudoInverse();
  };
  if (n <= kMostSmallRows) {
    invert(Eigen::CompleteOrthogonalDecomposition<Small>());
  } else {
    invert(Eigen::CompleteOrthogonalDecomposition<RowMajor>());
  }
}

}  // namespace saltus
