// What scripts/build_cost.sh measures the machine with: derivatives of a decomposition, as much of the library compiles
// them, and nothing of the library, so that it stays the same.
#include <ceres/jet.h>

#include <Eigen/Dense>

template <typename T, int n>
T Solve(const double* values) {
  Eigen::Matrix<T, n, n> matrix;
  for (int i = 0; i < n * n; ++i) matrix(i) = T(values[i]);
  const Eigen::Matrix<T, n, n> square = matrix * matrix.transpose();
  const Eigen::Matrix<T, n, 1> one = Eigen::Matrix<T, n, 1>::Ones();
  return square.ldlt().solve(one).norm() + square.partialPivLu().solve(one).sum();
}

double Reference(const double* values) { return Solve<double, 3>(values) + Solve<ceres::Jet<double, 4>, 3>(values).a; }
