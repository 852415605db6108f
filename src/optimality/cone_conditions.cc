#include "optimality/cone_conditions.h"

#include <algorithm>

#include "base/linear_algebra.h"

namespace saltus {
namespace {

constexpr int kMostNewtonSteps = 50;

double Cross(const Vec2d& a, const Vec2d& b) { return a[0] * b[1] - a[1] * b[0]; }

// In a cone less than half of the plane.
bool IsBetween(const Vec2d& a, const Vec2d& b, const Vec2d& w) {
  const double turn = Cross(a, b);
  return turn != 0 && Cross(a, w) * turn >= 0 && Cross(w, b) * turn >= 0;
}

}  // namespace

void NormalCone::Residual(const Vec2d& w, Vec2d* residual, Eigen::Matrix2d* derivative) const {
  *residual = w;
  derivative->setIdentity();
  if (normals_.empty()) return;
  const auto [a, b] = Extremes();
  if (IsBetween(a, b, w)) {
    residual->setZero();
    derivative->setZero();
    return;
  }
  const Vec2d& nearest = a.dot(w) > b.dot(w) ? a : b;
  if (nearest.dot(w) <= 0) return;
  *residual -= nearest.dot(w) * nearest;
  *derivative -= nearest * nearest.transpose();
}

std::pair<Vec2d, Vec2d> NormalCone::Extremes() const {
  std::pair<Vec2d, Vec2d> widest = {normals_[0], normals_[0]};
  for (const Vec2d& a : normals_) {
    for (const Vec2d& b : normals_) {
      if (a.dot(b) < widest.first.dot(widest.second)) widest = {a, b};
    }
  }
  return widest;
}

void ConeConditions::Solve() {
  for (int step = 0; step < kMostNewtonSteps && theta_.size() > 0; ++step) {
    Eigen::VectorXd r;
    Eigen::MatrixXd jacobian;
    Evaluate(theta_, &r, &jacobian);
    const Eigen::VectorXd by = LeastNormSolution(jacobian, -r);
    double length = 1;
    Eigen::VectorXd next;
    for (; length > 1e-4; length *= 0.5) {
      Evaluate(theta_ + length * by, &next, nullptr);
      if (next.squaredNorm() < r.squaredNorm()) break;
    }
    if (!(next.squaredNorm() < r.squaredNorm())) break;
    theta_ += length * by;
    if (next.squaredNorm() > (1 - 1e-9) * r.squaredNorm()) break;
  }
}

double ConeConditions::LargestForce() const {
  double largest = 0;
  Vec2d residual;
  Eigen::Matrix2d derivative;
  for (const Planar& force : forces_) {
    force.cone.Residual(-(force.value + force.columns * theta_), &residual, &derivative);
    largest = std::max(largest, residual.norm());
  }
  return largest;
}

double ConeConditions::Left(const Scalar& number, const Eigen::VectorXd& theta) {
  const double value = number.value + number.columns.dot(theta.transpose());
  return number.allowed * value > 0 ? 0.0 : value;
}

void ConeConditions::Evaluate(const Eigen::VectorXd& theta, Eigen::VectorXd* r, Eigen::MatrixXd* jacobian) const {
  const Eigen::Index rows = 2 * forces_.size() + numbers_.size();
  r->resize(rows);
  if (jacobian != nullptr) jacobian->setZero(rows, theta.size());
  Eigen::Index row = 0;
  Vec2d residual;
  Eigen::Matrix2d derivative;
  for (const Planar& force : forces_) {
    force.cone.Residual(-(force.value + force.columns * theta), &residual, &derivative);
    r->segment<2>(row) = residual;
    if (jacobian != nullptr) jacobian->middleRows<2>(row) = -derivative * force.columns;
    row += 2;
  }
  for (const Scalar& number : numbers_) {
    (*r)[row] = Left(number, theta);
    if (jacobian != nullptr && (*r)[row] != 0) jacobian->row(row) = number.columns;
    ++row;
  }
}

}  // namespace saltus
