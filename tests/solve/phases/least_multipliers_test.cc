#include "solve/phases/least_multipliers.h"

#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <random>
#include <vector>

namespace saltus {
namespace {

using SparseRows = Eigen::SparseMatrix<double, Eigen::RowMajor>;

// Rows of steps x' - x - dt a - h b = 0 with two states and a control each, all of which share the length h, and of
// every tenth of them a second such variable; the last row is a guard of the last state alone.
SparseRows RowsOfSteps(int steps, std::mt19937* random) {
  std::normal_distribution<double> number;
  const int states = 2;
  const Eigen::Index columns = steps * (states + 1) + 2;
  std::vector<Eigen::Triplet<double>> entries;
  for (int step = 0; step < steps; ++step) {
    for (int i = 0; i < states; ++i) {
      const int row = step * states + i;
      entries.emplace_back(row, step * (states + 1) + i, 1.0);
      entries.emplace_back(row, step * (states + 1) + states, 0.1 * number(*random));
      for (int j = 0; j < states && step > 0; ++j) {
        entries.emplace_back(row, (step - 1) * (states + 1) + j, (i == j ? -1.0 : 0.0) + 0.1 * number(*random));
      }
      entries.emplace_back(row, columns - 2, number(*random));
      if (step % 10 == 0) entries.emplace_back(row, columns - 1, number(*random));
    }
  }
  entries.emplace_back(steps * states, (steps - 1) * (states + 1), 1.0);
  SparseRows rows(steps * states + 1, columns);
  rows.setFromTriplets(entries.begin(), entries.end());
  return rows;
}

TEST(LeastMultipliers, AreThoseOfDenseLeastSquaresWhereStepsShareVariables) {
  std::mt19937 random(1);
  std::normal_distribution<double> number;
  for (const int steps : {1, 5, 60, 127, 128, 300}) {
    const SparseRows rows = RowsOfSteps(steps, &random);
    const Eigen::VectorXd gradient = Eigen::VectorXd::NullaryExpr(rows.cols(), [&] { return number(random); });
    const Eigen::VectorXd multipliers = LeastMultipliers(rows, gradient);
    const Eigen::MatrixXd dense = Eigen::MatrixXd(rows).transpose();
    const Eigen::VectorXd least = dense.completeOrthogonalDecomposition().solve(-gradient);
    ASSERT_EQ(multipliers.size(), least.size()) << steps;
    EXPECT_LT((multipliers - least).norm(), 1e-7 * least.norm()) << steps;
  }
}

// Where rows depend on each other, many multipliers leave as little.
TEST(LeastMultipliers, LeaveLeastWhereRowsDependOnEachOther) {
  std::mt19937 random(2);
  std::normal_distribution<double> number;
  const SparseRows once = RowsOfSteps(50, &random);
  SparseRows twice(2 * once.rows(), once.cols());
  twice.topRows(once.rows()) = once;
  twice.bottomRows(once.rows()) = once;
  const Eigen::VectorXd gradient = Eigen::VectorXd::NullaryExpr(once.cols(), [&] { return number(random); });
  const Eigen::VectorXd multipliers = LeastMultipliers(twice, gradient);
  ASSERT_EQ(multipliers.size(), twice.rows());
  const Eigen::MatrixXd dense = Eigen::MatrixXd(once).transpose();
  const Eigen::VectorXd least = gradient + dense * dense.completeOrthogonalDecomposition().solve(-gradient);
  EXPECT_NEAR((gradient + twice.transpose() * multipliers).norm(), least.norm(), 1e-8 * gradient.norm());
}

TEST(LeastMultipliers, AreNoneWithoutRows) {
  EXPECT_EQ(LeastMultipliers(SparseRows(0, 3), Eigen::VectorXd::Ones(3)).size(), 0);
}

// Compares with dense least squares; a column without entries changes nothing.
TEST(RowsAfterStep, AreTheResidualsOfLeastSquares) {
  Eigen::MatrixXd dense(5, 4);
  dense << 1, 2, 0, 0, 0, 1, 0, -1, 3, 0, 0, 1, 1, 1, 0, 1, 2, -1, 0, 0;
  const Eigen::VectorXd rows = Eigen::VectorXd::LinSpaced(5, -1.0, 3.0);
  const Eigen::SparseMatrix<double, Eigen::RowMajor> sparse = dense.sparseView();
  const Eigen::VectorXd found = RowsAfterStep(sparse, rows);
  const Eigen::VectorXd expected = rows - dense * dense.completeOrthogonalDecomposition().solve(rows);
  EXPECT_LE((found - expected).norm(), 1e-10);
}

}  // namespace
}  // namespace saltus
