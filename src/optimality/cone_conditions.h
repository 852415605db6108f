// Conditions of optimality with unknown multipliers: functions affine in these must lie in convex cones.
#pragma once

#include <Eigen/Dense>
#include <algorithm>
#include <utility>
#include <vector>

#include "base/linear_algebra.h"
#include "saltus/scene/geometry.h"

namespace saltus {

inline double Cross(const Vec2d& a, const Vec2d& b) { return a[0] * b[1] - a[1] * b[0]; }

// Whether w lies between a and b, which span less than half of the plane.
inline bool IsBetween(const Vec2d& a, const Vec2d& b, const Vec2d& w) {
  const double turn = Cross(a, b);
  return turn != 0 && Cross(a, w) * turn >= 0 && Cross(w, b) * turn >= 0;
}

// The cone of outward normals of the bounds at a force, in the plane: empty, a ray or what two rays span.
class NormalCone {
 public:
  explicit NormalCone(std::vector<Vec2d> normals) : normals_(std::move(normals)) {}

  // Computes w less its projection on the cone, and its derivative by w.
  void Residual(const Vec2d& w, Vec2d* residual, Eigen::Matrix2d* derivative) const {
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

 private:
  std::pair<Vec2d, Vec2d> Extremes() const {
    std::pair<Vec2d, Vec2d> widest = {normals_[0], normals_[0]};
    for (const Vec2d& a : normals_) {
      for (const Vec2d& b : normals_) {
        if (a.dot(b) < widest.first.dot(widest.second)) widest = {a, b};
      }
    }
    return widest;
  }

  std::vector<Vec2d> normals_;
};

// Conditions of optimality that are affine in unknown multipliers theta, each of which must lie in a convex cone. The
// distances from the cones are convex functions of theta. The solution minimises the sum of their squares,
// sum_i dist(value_i + columns_i theta, C_i)^2, which is convex and once continuously differentiable.
class ConeConditions {
 public:
  explicit ConeConditions(int num_unknowns) : theta_(Eigen::VectorXd::Zero(num_unknowns)) {}

  // Adds a force condition: `value` + `columns` theta must be opposite to the cone of these normals.
  void AddForce(const Vec2d& value, const Eigen::Matrix2Xd& columns, std::vector<Vec2d> normals) {
    forces_.push_back({value, columns, NormalCone(std::move(normals))});
  }
  // Adds a number that must vanish, or have the sign `allowed`.
  void AddNumber(double value, const Eigen::RowVectorXd& columns, int allowed) {
    numbers_.push_back({value, columns, allowed});
  }

  // Takes the steps of Newton's method that lower the sum, and shorter ones (Levenberg-Marquardt) where a whole step
  // crosses so many borders of cones that it does not.
  void Solve() {
    constexpr int kMostSteps = 100;
    constexpr double kLeastDamping = 1e-9, kMostDamping = 1e6;
    if (theta_.size() == 0) return;
    const Eigen::VectorXd sizes = SquaresOfColumns();
    Eigen::VectorXd r, next;
    Eigen::MatrixXd jacobian;
    double damping = kLeastDamping;
    for (int step = 0; step < kMostSteps; ++step) {
      Evaluate(theta_, &r, &jacobian);
      const auto is_lower = [&](const Eigen::VectorXd& by) {
        Evaluate(theta_ + by, &next, nullptr);
        return next.squaredNorm() < r.squaredNorm();
      };
      Eigen::VectorXd by = LeastNormSolution(jacobian, -r);
      bool lower = is_lower(by);
      for (damping = std::max(0.01 * damping, kLeastDamping); !lower && damping < kMostDamping; damping *= 10) {
        Eigen::MatrixXd normal = jacobian.transpose() * jacobian;
        normal.diagonal() += damping * sizes;
        by = normal.ldlt().solve(-jacobian.transpose() * r);
        lower = is_lower(by);
      }
      if (!lower) break;
      theta_ += by;
      if (next.squaredNorm() > (1 - 1e-9) * r.squaredNorm()) break;
    }
  }

  // The theta that Solve has found, and the residuals there: the largest distance of a force, and number i.
  const Eigen::VectorXd& theta() const { return theta_; }
  double LargestForce() const {
    double largest = 0;
    Vec2d residual;
    Eigen::Matrix2d derivative;
    for (const Planar& force : forces_) {
      force.cone.Residual(-(force.value + force.columns * theta_), &residual, &derivative);
      largest = std::max(largest, residual.norm());
    }
    return largest;
  }
  double Number(size_t i) const { return SlackAt(numbers_[i], theta_); }
  // Return force i and number i, as they were added, at theta.
  Vec2d Force(size_t i) const { return forces_[i].value + forces_[i].columns * theta_; }
  double Value(size_t i) const { return numbers_[i].value + numbers_[i].columns.dot(theta_.transpose()); }
  // Returns the largest change of a condition by unknown j.
  double LargestColumn(Eigen::Index j) const {
    double largest = 0;
    for (const Planar& force : forces_) largest = std::max(largest, force.columns.col(j).norm());
    for (const Scalar& number : numbers_) largest = std::max(largest, std::abs(number.columns[j]));
    return largest;
  }
  // Where multipliers are not unique, looks for those with which numbers of a given sign are not zero but at least
  // `margin`. Returns whether there are any for which no residual is above a tenth of it; theta stays otherwise.
  bool SolveStrictly(double margin) {
    const Eigen::VectorXd before = theta_;
    margin_ = margin;
    Solve();
    Eigen::VectorXd r;
    Evaluate(theta_, &r, nullptr);
    margin_ = 0;
    if (r.size() == 0 || r.cwiseAbs().maxCoeff() <= 0.1 * margin) return true;
    theta_ = before;
    return false;
  }

 private:
  struct Planar {
    Vec2d value;
    Eigen::Matrix2Xd columns;
    NormalCone cone;
  };
  struct Scalar {
    double value;
    Eigen::RowVectorXd columns;
    int allowed;
  };

  // Returns the sums of squares of the columns of all conditions; 1 for a column of zeros.
  Eigen::VectorXd SquaresOfColumns() const {
    Eigen::VectorXd sums = Eigen::VectorXd::Zero(theta_.size());
    for (const Planar& force : forces_) sums += force.columns.colwise().squaredNorm().transpose();
    for (const Scalar& number : numbers_) sums += number.columns.cwiseAbs2().transpose();
    return (sums.array() > 0).select(sums, 1.0);
  }

  double SlackAt(const Scalar& number, const Eigen::VectorXd& theta) const {
    const double value = number.value + number.columns.dot(theta.transpose()) - number.allowed * margin_;
    return number.allowed * value > 0 ? 0.0 : value;
  }

  void Evaluate(const Eigen::VectorXd& theta, Eigen::VectorXd* r, Eigen::MatrixXd* jacobian) const {
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
      (*r)[row] = SlackAt(number, theta);
      if (jacobian != nullptr && (*r)[row] != 0) jacobian->row(row) = number.columns;
      ++row;
    }
  }

  Eigen::VectorXd theta_;
  double margin_ = 0;
  std::vector<Planar> forces_;
  std::vector<Scalar> numbers_;
};

}  // namespace saltus
