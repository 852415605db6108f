// Conditions of optimality with unknown multipliers: values that are affine in them are to lie in convex cones. The
// distances from these are convex, so the multipliers that meet all conditions best are found by Newton's method on a
// sum of squares.
#pragma once

#include <Eigen/Core>
#include <utility>
#include <vector>

#include "saltus/scene/geometry.h"

namespace saltus {

// The cone of normals at a force, in the plane: nothing, a ray or what two rays span.
class NormalCone {
 public:
  void Add(const Vec2d& normal) { normals_.push_back(normal); }

  // w less its projection on the cone, and the derivative.
  void Residual(const Vec2d& w, Vec2d* residual, Eigen::Matrix2d* derivative) const;

 private:
  std::pair<Vec2d, Vec2d> Extremes() const;

  std::vector<Vec2d> normals_;
};

class ConeConditions {
 public:
  explicit ConeConditions(int num_unknowns) : theta_(Eigen::VectorXd::Zero(num_unknowns)) {}

  // `value` is to be opposite to the cone; `columns` are its derivatives by theta.
  void AddForce(const Vec2d& value, const Eigen::Matrix2Xd& columns, NormalCone cone) {
    forces_.push_back({value, columns, std::move(cone)});
  }
  // A number that is to vanish, or to have the sign `allowed`.
  void AddNumber(double value, const Eigen::RowVectorXd& columns, int allowed) {
    numbers_.push_back({value, columns, allowed});
  }

  void Solve();

  // What Solve has found, and what it leaves: of the forces the largest distance, and number i.
  const Eigen::VectorXd& theta() const { return theta_; }
  double LargestForce() const;
  double Number(size_t i) const { return Left(numbers_[i], theta_); }
  // Force i, as it was added, at theta.
  Vec2d Force(size_t i) const { return forces_[i].value + forces_[i].columns * theta_; }

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
  static double Left(const Scalar& number, const Eigen::VectorXd& theta);
  void Evaluate(const Eigen::VectorXd& theta, Eigen::VectorXd* r, Eigen::MatrixXd* jacobian) const;

  Eigen::VectorXd theta_;
  std::vector<Planar> forces_;
  std::vector<Scalar> numbers_;
};

}  // namespace saltus
