// The second derivatives of a condensed loss: its curvature along all directions, and Newton's step.
#include <glog/logging.h>

#include <algorithm>
#include <cmath>

#include "base/linear_algebra.h"
#include "optimality/condensed.h"

namespace saltus {

Eigen::MatrixXd CondensedLoss::Gram() const {
  const int n = num_functionals();
  Eigen::MatrixXd gram = Eigen::MatrixXd::Zero(n, n);
  for (int j = 0; j < n; ++j) {
    const Functional& a = functionals_[j];
    for (int k = j; k < n; ++k) {
      const Functional& b = functionals_[k];
      if (a.column / 2 != b.column / 2) continue;
      const int c = a.column / 2;
      const int begin = std::max(a.first, b.first);
      const int end =
          std::min(a.first + static_cast<int>(a.weights.size()), b.first + static_cast<int>(b.weights.size()));
      for (int i = begin; i < end; ++i) {
        const Restrictions::Force& force = ForceAt(i, c);
        const double share = force.free(a.column % 2, b.column % 2) / (1 + force.bend);
        gram(j, k) += share * a.weights[i - a.first] * b.weights[i - b.first] / lengths_[i];
      }
      gram(k, j) = gram(j, k);
    }
  }
  return gram;
}

void CondensedLoss::DivideByWeights(Eigen::VectorXd* x) const {
  for (Eigen::Index i = 0; i < x->size(); i += 2) {
    const Restrictions::Force& force = ForceAt(i / width_, static_cast<int>(i % width_ / 2));
    x->segment<2>(i) = (force.free * x->segment<2>(i) / ((1 + force.bend) * Length(i))).eval();
  }
}

Eigen::Index CondensedLoss::NumFree() const {
  double sum = 0;
  for (size_t k = 0; k < lengths_.size(); ++k) {
    for (int c = 0; c < width_ / 2; ++c) sum += ForceAt(k, c).free.trace();
  }
  return std::lround(sum);
}

CondensedLoss::Curvature CondensedLoss::SmallestCurvature() const {
  constexpr double kRank = 1e-10;
  CHECK_GT(scene_.objective.effort, 0);
  Eigen::MatrixXd hessian, gaps;
  SecondDerivatives(&hessian, &gaps);
  // Directions M^-1 F^T S p with S scaling each functional to one; p = Q w, orthonormal to integral |d|^2 dt.
  const Eigen::MatrixXd gram = Gram();
  Eigen::VectorXd scale(gram.rows());
  for (Eigen::Index i = 0; i < scale.size(); ++i) scale[i] = gram(i, i) > 0 ? 1 / std::sqrt(gram(i, i)) : 0.0;
  const SymmetricEigen metric = EigenOf(scale.asDiagonal() * gram * scale.asDiagonal());
  const Eigen::VectorXd& sizes = metric.values;  // rising
  Eigen::Index first = 0;
  while (first < sizes.size() && sizes[first] <= kRank * sizes[sizes.size() - 1]) ++first;
  const Eigen::Index rank = sizes.size() - first;
  // F d for the columns d of an orthonormal basis, and the functionals that make those columns.
  const Eigen::MatrixXd vectors = metric.vectors.rightCols(rank);
  const Eigen::VectorXd roots = sizes.tail(rank).cwiseSqrt();
  Eigen::MatrixXd image = scale.cwiseInverse().asDiagonal() * vectors * roots.asDiagonal();
  for (Eigen::Index i = 0; i < scale.size(); ++i) {
    if (scale[i] == 0) image.row(i).setZero();
  }
  Eigen::MatrixXd source = scale.asDiagonal() * vectors * roots.cwiseInverse().asDiagonal();
  if (num_held_ > 0) {  // what keeps the impacts on their nodes, and hard terms
    Eigen::MatrixXd rows = Multiply(gaps, image);
    for (Eigen::Index i = 0; i < rows.rows(); ++i) rows.row(i) /= std::max(rows.row(i).norm(), 1e-300);
    const Eigen::MatrixXd kept = NullSpace(rows);
    image = Multiply(image, kept);
    source = Multiply(source, kept);
  }
  Curvature result;
  result.direction = Eigen::VectorXd::Zero(control_.size());
  const Eigen::Index last = image.cols() - 1;
  const bool others = rank < NumFree();  // directions that the motion does not notice
  if (last < 0) return result;
  const Eigen::MatrixXd reduced = Multiply(MultiplyTransposed(image, hessian), image) / (2 * scene_.objective.effort);
  const SymmetricEigen curvature = EigenOf(reduced);
  result.smallest = 1 + curvature.values[0];
  result.largest = 1 + curvature.values[last];
  result.direction = Transposed(source * curvature.vectors.col(0));
  DivideByWeights(&result.direction);
  if (!restrictions_.forces.empty()) {  // orthonormal to another measure
    double square = 0;
    for (Eigen::Index i = 0; i < result.direction.size(); ++i) square += Length(i) * std::pow(result.direction[i], 2);
    result.direction /= std::sqrt(square);
  }
  Eigen::Index most = 0;
  result.direction.cwiseAbs().maxCoeff(&most);
  if (result.direction[most] < 0) result.direction = -result.direction;
  if (others) {
    result.smallest = std::min(result.smallest, 1.0);
    result.largest = std::max(result.largest, 1.0);
  }
  return result;
}

// With q = G' + G'' F d + A^T lambda, A the derivatives of what is held, 2 effort M (u + d) + F^T q vanishes and so
// does A F d: equations for q and lambda, whose number does not grow with the intervals.
std::optional<Eigen::VectorXd> CondensedLoss::NewtonStep() const {
  Eigen::MatrixXd hessian, held;
  SecondDerivatives(&hessian, &held);
  const int n = num_functionals(), m = num_held_;
  const Eigen::Map<const Eigen::VectorXd> values(values_.data(), n);
  Eigen::VectorXd slope(n);
  Sweep<double>(values_.data(), slope.data(), nullptr);
  const Eigen::MatrixXd gram = Gram() / (2 * scene_.objective.effort);
  Eigen::MatrixXd matrix = Eigen::MatrixXd::Zero(n + m, n + m);
  Eigen::MatrixXd corner = Eigen::MatrixXd::Identity(n, n);
  AddProduct(hessian, gram, &corner);
  matrix.topLeftCorner(n, n) = corner;
  matrix.topRightCorner(n, m) = -held.transpose();
  matrix.bottomLeftCorner(m, n) = Multiply(held, gram);
  Eigen::VectorXd right(n + m);
  right << slope - hessian * values, -(held * values);
  const Eigen::VectorXd found = SolveFullPivotLu(matrix, right);
  Eigen::VectorXd control = Transposed(found.head(n)) / (-2 * scene_.objective.effort);
  DivideByWeights(&control);
  if (!control.allFinite()) return std::nullopt;
  return control;
}

Eigen::MatrixXd CondensedLoss::DenseHessian() const {
  Eigen::MatrixXd by_functionals, gaps;
  SecondDerivatives(&by_functionals, &gaps);
  Eigen::MatrixXd f(num_functionals(), control_.size());
  for (int j = 0; j < num_functionals(); ++j) {
    f.row(j) = Transposed(Eigen::VectorXd::Unit(num_functionals(), j)).transpose();
  }
  Eigen::MatrixXd hessian = Multiply(MultiplyTransposed(f, by_functionals), f);
  for (Eigen::Index i = 0; i < hessian.rows(); ++i) hessian(i, i) += 2 * scene_.objective.effort * Length(i);
  return hessian;
}

}  // namespace saltus
