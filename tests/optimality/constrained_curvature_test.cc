// The extreme curvatures along the null space of equations against dense eigenvalues.
#include "optimality/constrained_curvature.h"

#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <cmath>
#include <random>
#include <vector>

namespace saltus {
namespace {

using Eigen::MatrixXd;

MatrixXd RandomMatrix(int rows, int columns, std::mt19937* random) {
  std::normal_distribution<double> normal;
  return MatrixXd::NullaryExpr(rows, columns, [&] { return normal(*random); });
}

TEST(ConstrainedCurvature, AgreesWithDenseEigenvalues) {
  std::mt19937 random(1);
  for (int trial = 0; trial < 200; ++trial) {
    const int variables = 1 + static_cast<int>(random() % 40);
    const int states = static_cast<int>(random() % 120), held = static_cast<int>(random() % variables);
    const int n = variables + states;
    MatrixXd hessian = RandomMatrix(n, n, &random);
    hessian = (hessian + hessian.transpose()).eval();
    // States follow from variables; some equations hold these.
    MatrixXd equations = RandomMatrix(states + held, n, &random);
    equations.block(0, variables, states, states) += 10 * std::sqrt(n) * MatrixXd::Identity(states, states);
    const MatrixXd factor = RandomMatrix(variables, variables, &random) + 3 * MatrixXd::Identity(variables, variables);
    MatrixXd metric = MatrixXd::Zero(n, n);
    metric.topLeftCorner(variables, variables) = factor * factor.transpose() + MatrixXd::Identity(variables, variables);

    const MatrixXd basis = Eigen::FullPivLU<MatrixXd>(equations).kernel();
    const Eigen::GeneralizedSelfAdjointEigenSolver<MatrixXd> dense(basis.transpose() * hessian * basis,
                                                                   basis.transpose() * metric * basis);
    const auto found = FindConstrainedCurvature(hessian.sparseView(), equations.sparseView(), metric.sparseView());
    ASSERT_TRUE(found) << trial;
    const double size = dense.eigenvalues().cwiseAbs().maxCoeff();
    EXPECT_NEAR(found->smallest, dense.eigenvalues()[0], 1e-6 * size) << trial;
    EXPECT_NEAR(found->largest, dense.eigenvalues().tail<1>()[0], 1e-6 * size) << trial;
    const Eigen::VectorXd& d = found->direction;
    EXPECT_NEAR(d.dot(hessian * d), found->smallest * d.dot(metric * d), 1e-8 * size * d.dot(metric * d));
    EXPECT_LE((equations * d).norm(), 1e-9 * equations.norm() * d.norm());
  }
}

// A form of few functionals, with states that follow from others one by one and times that other equations determine.
TEST(ConstrainedCurvature, OfFewFunctionalsAgreesWithDenseEigenvalues) {
  std::mt19937 random(2);
  const auto below = [&](int most) { return static_cast<int>(random() % most); };
  for (int trial = 0; trial < 200; ++trial) {
    const int variables = 40 + below(60), times = below(4), states = 60 + below(60), held = times + below(3);
    const int n = variables + times + states, first_state = variables + times;
    const MatrixXd factor = RandomMatrix(variables, variables, &random) / std::sqrt(variables);
    MatrixXd metric = MatrixXd::Zero(n, n);
    metric.topLeftCorner(variables, variables) = factor * factor.transpose() + MatrixXd::Identity(variables, variables);
    MatrixXd hessian = metric;
    const auto add = [&](int i, int j, double value) {
      hessian(i, j) += value;
      if (i != j) hessian(j, i) += value;
    };
    for (int k = 0; k < 4; ++k) add(below(n), below(n), trial % 2 == 0 ? -2.0 : 3.0);
    for (int i = 0; i < n && times > 0; ++i) add(i, variables, 0.1 * std::sin(i + 1.0));
    MatrixXd equations = MatrixXd::Zero(states + held, n);
    std::vector<DefinedUnknown> defined;
    for (int i = 0; i < states; ++i) {
      defined.push_back({first_state + i, i});
      equations(i, first_state + i) = -1;
      for (int k = 0; k < 4; ++k) equations(i, below(first_state + i)) += 0.4;
    }
    equations.bottomRows(held) = RandomMatrix(held, n, &random);

    const MatrixXd basis = Eigen::FullPivLU<MatrixXd>(equations).kernel();
    const Eigen::GeneralizedSelfAdjointEigenSolver<MatrixXd> dense(basis.transpose() * hessian * basis,
                                                                   basis.transpose() * metric * basis);
    const auto found =
        FindConstrainedCurvature(hessian.sparseView(), equations.sparseView(), metric.sparseView(), defined);
    ASSERT_TRUE(found) << trial;
    const double size = dense.eigenvalues().cwiseAbs().maxCoeff();
    EXPECT_NEAR(found->smallest, dense.eigenvalues()[0], 1e-9 * size) << trial;
    EXPECT_NEAR(found->largest, dense.eigenvalues().tail<1>()[0], 1e-9 * size) << trial;
    const Eigen::VectorXd& d = found->direction;
    EXPECT_NEAR(d.dot(metric * d), 1, 1e-9);
    EXPECT_NEAR(d.dot(hessian * d), found->smallest, 1e-8 * size) << trial;
    EXPECT_LE((equations * d).norm(), 1e-9 * equations.norm() * d.norm()) << trial;
  }
}

// A chain of integrators with a cost of each state: the functionals are as many as the variables, and the first ones
// hardly notice these.
TEST(ConstrainedCurvature, OfFunctionalsThatHardlyNoticeVariablesAgreesWithDenseEigenvalues) {
  for (const int order : {2, 3, 4}) {
    for (int variables = 10; variables <= 120; variables += 10) {
      const int states = order * variables, n = variables + states;
      const double h = 1.5 / variables;
      MatrixXd metric = MatrixXd::Zero(n, n), equations = MatrixXd::Zero(states, n);
      metric.topLeftCorner(variables, variables) = 0.05 * h * MatrixXd::Identity(variables, variables);
      MatrixXd hessian = metric;
      std::vector<DefinedUnknown> defined;
      for (int k = 0; k < variables; ++k) {
        for (int i = 0; i < order; ++i) {  // the i-th integral after interval k
          const int row = k * order + i;
          defined.push_back({variables + row, row});
          equations(row, variables + row) = -1;
          double taylor = 1;  // h^j / j!
          for (int j = 0; j <= i; taylor *= h / ++j) {
            if (k > 0) equations(row, variables + row - order - j) = taylor;
          }
          equations(row, k) = taylor;
        }
        hessian(variables + k * order + order - 1, variables + k * order + order - 1) = h;
      }
      const MatrixXd of_states = -equations.rightCols(states).partialPivLu().solve(equations.leftCols(variables));
      const MatrixXd all = hessian.topLeftCorner(variables, variables) +
                           of_states.transpose() * hessian.bottomRightCorner(states, states) * of_states;
      const Eigen::SelfAdjointEigenSolver<MatrixXd> dense(all / (0.05 * h));
      const auto found =
          FindConstrainedCurvature(hessian.sparseView(), equations.sparseView(), metric.sparseView(), defined);
      ASSERT_TRUE(found) << order << " " << variables;
      const double largest = dense.eigenvalues().tail<1>()[0];
      EXPECT_NEAR(found->smallest, dense.eigenvalues()[0], 1e-9 * largest) << order << " " << variables;
      EXPECT_NEAR(found->largest, largest, 1e-9 * largest) << order << " " << variables;
    }
  }
}

// The Hessian of the control's effort alone is the metric.
TEST(ConstrainedCurvature, IsOneWhereTheHessianIsTheMetricAndNothingIsHeld) {
  const MatrixXd metric = MatrixXd::Identity(3, 3), none(0, 3);
  const auto found = FindConstrainedCurvature(metric.sparseView(), none.sparseView(), metric.sparseView());
  ASSERT_TRUE(found);
  EXPECT_EQ(found->smallest, 1);
  EXPECT_EQ(found->largest, 1);
  EXPECT_NEAR(found->direction.norm(), 1, 1e-15);
}

TEST(ConstrainedCurvature, HasNoDirectionWhereEquationsLeaveNone) {
  const MatrixXd square = MatrixXd::Identity(3, 3);
  EXPECT_FALSE(FindConstrainedCurvature(square.sparseView(), square.sparseView(), square.sparseView()));
}

}  // namespace
}  // namespace saltus
