#include "solve/phases/augmented_lagrangian.h"

#include <ceres/autodiff_cost_function.h>
#include <ceres/sized_cost_function.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <memory>

namespace saltus {
namespace {

// The distance of a point to (2, 1), on the circle x^2 + y^2 = 1 or beside the empty set x^2 + y^2 = -1.
struct DistanceOnCircle {
  double square_of_radius;
  template <typename T>
  bool operator()(const T* x, T* rows) const {
    rows[0] = x[0] * x[0] + x[1] * x[1] - square_of_radius;
    rows[1] = x[0] - 2.0;
    rows[2] = x[1] - 1.0;
    return true;
  }
};

AugmentedLagrangian::Summary Minimize(double square_of_radius, bool one_of_many, double* x,
                                      double most_cost = INFINITY) {
  AugmentedLagrangian lagrangian;
  lagrangian.Add(
      std::make_unique<ceres::AutoDiffCostFunction<DistanceOnCircle, 3, 2>>(new DistanceOnCircle{square_of_radius}),
      {.equalities = 1},
      {x});
  AugmentedLagrangian::Options options;
  options.equality_weight = 1;
  options.most_open = 0.005;
  options.one_of_many = one_of_many;
  options.most_cost = most_cost;
  return lagrangian.Minimize(options);
}

TEST(AugmentedLagrangianTest, OneOfManyEndsAtTheOptimum) {
  double x[] = {0.3, 0.9};
  const AugmentedLagrangian::Summary summary = Minimize(1, /*one_of_many=*/true, x);
  EXPECT_TRUE(summary.converged);
  EXPECT_NEAR(x[0], 2 / std::sqrt(5), 1e-6) << "the root of Options::gain is 2e-7";
  EXPECT_NEAR(x[1], 1 / std::sqrt(5), 1e-6);
  EXPECT_NEAR(summary.cost, std::pow(std::sqrt(5) - 1, 2), 1e-8);
}

TEST(AugmentedLagrangianTest, OneOfManyIsGivenUpWhereAConstraintCannotBeMet) {
  double x[] = {0.3, 0.9}, y[] = {0.3, 0.9};
  const AugmentedLagrangian::Summary patient = Minimize(-1, /*one_of_many=*/false, x);
  const AugmentedLagrangian::Summary given_up = Minimize(-1, /*one_of_many=*/true, y);
  EXPECT_FALSE(patient.converged);
  EXPECT_FALSE(given_up.converged);
  EXPECT_GE(given_up.violation, 1) << "no point violates it by less";
  EXPECT_LT(given_up.jacobians, patient.jacobians / 3);
}

// At the optimum the costs are (sqrt(5) - 1)^2 = 1.5279.
TEST(AugmentedLagrangianTest, IsGivenUpWhereAnOptimumCostsTooMuch) {
  double x[] = {0.3, 0.9}, y[] = {0.3, 0.9};
  const AugmentedLagrangian::Summary enough = Minimize(1, /*one_of_many=*/true, x, 1.5280);
  const AugmentedLagrangian::Summary too_little = Minimize(1, /*one_of_many=*/true, y, 1.5278);
  EXPECT_TRUE(enough.converged);
  EXPECT_FALSE(too_little.converged);
  EXPECT_LT(too_little.jacobians, enough.jacobians);
}

struct InUnitDisc {
  template <typename T>
  bool operator()(const T* x, T* rows) const {
    rows[0] = 0.5 * (x[0] * x[0] + x[1] * x[1] - 1.0);
    return true;
  }
};
struct DistanceToPoint {
  template <typename T>
  bool operator()(const T* x, T* rows) const {
    rows[0] = x[0] - 2.0;
    rows[1] = x[1] - 1.0;
    return true;
  }
};

// The squared distance of a point of the unit disc to (2, 1).
AugmentedLagrangian::Summary MinimizeInDisc(bool are_curved, double* x) {
  AugmentedLagrangian lagrangian;
  lagrangian.Add(std::make_unique<ceres::AutoDiffCostFunction<InUnitDisc, 1, 2>>(new InUnitDisc),
                 {.inequalities = 1, .are_curved = are_curved},
                 {x});
  lagrangian.Add(std::make_unique<ceres::AutoDiffCostFunction<DistanceToPoint, 2, 2>>(new DistanceToPoint), {}, {x});
  return lagrangian.Minimize({});
}

TEST(AugmentedLagrangianTest, CurvatureOfAnInequalityMakesStepsThoseOfNewton) {
  double x[] = {0.3, 0.9}, y[] = {0.3, 0.9};
  const AugmentedLagrangian::Summary curved = MinimizeInDisc(/*are_curved=*/true, x);
  const AugmentedLagrangian::Summary flat = MinimizeInDisc(/*are_curved=*/false, y);
  EXPECT_TRUE(curved.converged);
  EXPECT_NEAR(x[0], 2 / std::sqrt(5), 1e-8);
  EXPECT_NEAR(x[1], 1 / std::sqrt(5), 1e-8);
  EXPECT_NEAR(curved.cost, std::pow(std::sqrt(5) - 1, 2), 1e-8);
  EXPECT_LT(curved.iterations, 0.7 * flat.iterations);
}

// x_0 <= most; counts its Jacobians.
class Below final : public ceres::SizedCostFunction<1, 2> {
 public:
  Below(double most, int* jacobians) : most_(most), jacobians_(*jacobians) {}
  bool Evaluate(double const* const* x, double* rows, double** jacobians) const override {
    rows[0] = x[0][0] - most_;
    if (jacobians == nullptr || jacobians[0] == nullptr) return true;
    ++jacobians_;
    jacobians[0][0] = 1;
    jacobians[0][1] = 0;
    return true;
  }

 private:
  double most_;
  int& jacobians_;
};

TEST(AugmentedLagrangianTest, InequalitiesThatHoldTakeNoJacobians) {
  for (const double most : {3.0, 1.0}) {
    double x[] = {0.3, 0.9};
    int jacobians = 0;
    AugmentedLagrangian lagrangian;
    lagrangian.Add(std::make_unique<Below>(most, &jacobians), {.inequalities = 1}, {x});
    lagrangian.Add(std::make_unique<ceres::AutoDiffCostFunction<DistanceToPoint, 2, 2>>(new DistanceToPoint), {}, {x});
    EXPECT_TRUE(lagrangian.Minimize({}).converged);
    EXPECT_NEAR(x[0], std::min(most, 2.0), 1e-8);
    EXPECT_EQ(jacobians > 0, most < 2);
  }
}

}  // namespace
}  // namespace saltus
