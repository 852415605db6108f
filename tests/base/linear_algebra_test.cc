// Decompositions by the properties that define them.
#include "base/linear_algebra.h"

#include <gtest/gtest.h>

#include <random>
#include <vector>

#include "base/sparse_factors.h"
#include "parameter_name.h"

namespace saltus {
namespace {

constexpr double kRounding = 1e-10;

Eigen::MatrixXd Random(int rows, int columns, unsigned seed) {
  std::mt19937 random(seed);
  std::uniform_real_distribution<double> entry(-1, 1);
  return Eigen::MatrixXd::NullaryExpr(rows, columns, [&] { return entry(random); });
}

Eigen::MatrixXd OfRank(int size, int rank) { return Random(size, rank, 1) * Random(rank, size, 2); }

double Distance(const Eigen::MatrixXd& a, const Eigen::MatrixXd& b) { return (a - b).norm() / (1 + a.norm()); }

// Below, at and above the sizes that take no memory from the heap, and where Eigen begins to work by blocks.
class PseudoInverseOf : public testing::TestWithParam<int> {};
INSTANTIATE_TEST_SUITE_P(Sizes, PseudoInverseOf, testing::Values(1, 2, 5, 8, 15, 16, 17, 40, 60), ParameterName());

void ExpectMoorePenrose(const Eigen::MatrixXd& a, const Eigen::MatrixXd& inverse) {
  EXPECT_LT(Distance(a, a * inverse * a), kRounding);
  EXPECT_LT(Distance(inverse, inverse * a * inverse), kRounding);
  EXPECT_LT(Distance(a * inverse, (a * inverse).transpose()), kRounding);
  EXPECT_LT(Distance(inverse * a, (inverse * a).transpose()), kRounding);
}

TEST_P(PseudoInverseOf, MeetsTheConditionsOfMooreAndPenrose) {
  const int n = GetParam();
  for (const int rank : {n, (n + 1) / 2, 1}) {
    const Eigen::MatrixXd a = OfRank(n, rank);
    Eigen::MatrixXd inverse(n, n);
    PseudoInvert(a, 1e-10, inverse);
    ExpectMoorePenrose(a, inverse);
    ExpectMoorePenrose(a, PseudoInverse(a));

    // Rows of the transpose are columns.
    Eigen::MatrixXd by_rows = a.transpose();
    PseudoInvertRows(n, {by_rows.data(), static_cast<std::size_t>(by_rows.size())}, 1e-10);
    ExpectMoorePenrose(a, by_rows.transpose());
  }
}

TEST(LeastNorm, OfAnEmptyMatrixIsZero) {
  for (const auto& [rows, columns] : {std::pair(0, 0), std::pair(0, 2), std::pair(3, 0)}) {
    const Eigen::MatrixXd empty(rows, columns);
    EXPECT_EQ(LeastNormSolutions(empty, Eigen::MatrixXd::Ones(rows, 2)), Eigen::MatrixXd::Zero(columns, 2));
    EXPECT_EQ(LeastNormSolution(empty, Eigen::VectorXd::Ones(rows)), Eigen::VectorXd::Zero(columns));
  }
}

TEST_P(PseudoInverseOf, GivesTheSolutionOfLeastNorm) {
  const int n = GetParam();
  const Eigen::MatrixXd a = OfRank(n, (n + 1) / 2);
  const Eigen::VectorXd right = Random(n, 1, 3);
  const Eigen::VectorXd expected = PseudoInverse(a) * right;
  EXPECT_LT(Distance(expected, LeastNormSolution(a, right)), kRounding);
  EXPECT_LT(Distance(expected, LeastNormSolutions(a, right)), kRounding);
  const Eigen::MatrixXd many = Random(n, kMostSmallRows + 1, 4);
  EXPECT_LT(Distance(PseudoInverse(a) * many, LeastNormSolutions(a, many)), kRounding);
  Eigen::VectorXd x = right;
  LeastNormSolver(a, 1e-10).Solve(x, x);
  EXPECT_LT(Distance(expected, x), kRounding);
}

// Eliminating the others is to invert, to take the block, and to invert again.
TEST(LinearAlgebra, SchurComplementIsTheInverseOfABlockOfTheInverse) {
  const Eigen::MatrixXd root = Random(7, 7, 4), information = root * root.transpose();
  const Eigen::MatrixXd covariance = SolveLuColumns(information, Eigen::MatrixXd::Identity(7, 7));
  const Eigen::MatrixXd left = SchurComplement(information, 3);
  EXPECT_LT(Distance(Eigen::MatrixXd::Identity(3, 3), left * covariance.topLeftCorner(3, 3)), kRounding);
  EXPECT_EQ(SchurComplement(information, 7), information);
}

TEST(LinearAlgebra, SolvesSquareSystems) {
  const Eigen::MatrixXd root = Random(9, 9, 5), a = root * root.transpose() + Eigen::MatrixXd::Identity(9, 9);
  const Eigen::VectorXd x = Random(9, 1, 6), right = a * x;
  EXPECT_LT(Distance(x, SolveLu(a, right)), kRounding);
  EXPECT_LT(Distance(x, SolveFullPivotLu(a, right)), kRounding);
  EXPECT_LT(Distance(x, SolveLdlt(a, right)), kRounding);
  ASSERT_TRUE(SolveCholesky(a, right).has_value());
  EXPECT_LT(Distance(x, *SolveCholesky(a, right)), kRounding);
  EXPECT_FALSE(SolveCholesky(-a, right).has_value());
  Eigen::MatrixXd factor = a, solutions = a;
  SolveCholeskyInPlace(factor, solutions);
  EXPECT_LT(Distance(Eigen::MatrixXd::Identity(9, 9), solutions), kRounding);
}

TEST(LinearAlgebra, LeastSquaresLeaveWhatIsOrthogonalToTheColumns) {
  const Eigen::MatrixXd a = Random(12, 5, 7);
  const Eigen::VectorXd right = Random(12, 1, 8);
  EXPECT_LT((a.transpose() * (a * LeastSquaresSolution(a, right) - right)).norm(), kRounding);
}

TEST(LinearAlgebra, NullSpaceIsOrthonormalAndOrthogonalToTheRows) {
  const Eigen::MatrixXd rows = Random(3, 8, 9), basis = NullSpace(rows);
  ASSERT_EQ(basis.cols(), 5);
  EXPECT_LT((rows * basis).norm(), kRounding);
  EXPECT_LT(Distance(Eigen::MatrixXd::Identity(5, 5), basis.transpose() * basis), kRounding);
}

TEST(LinearAlgebra, EigenvectorsAreStretchedByTheEigenvalues) {
  const Eigen::MatrixXd root = Random(6, 6, 10), a = root + root.transpose();
  const SymmetricEigen eigen = EigenOf(a);
  EXPECT_LT(Distance(a * eigen.vectors, eigen.vectors * eigen.values.asDiagonal()), kRounding);
  for (int i = 1; i < 6; ++i) EXPECT_LE(eigen.values[i - 1], eigen.values[i]);
}

// Small products and large ones, which Eigen computes in different ways, against sums that are written out.
TEST(LinearAlgebra, ProductsAreSums) {
  for (const int n : {2, 5, 30}) {
    const Eigen::MatrixXd a = Random(n, n + 1, 11), b = Random(n + 1, n, 12);
    Eigen::MatrixXd expected = Eigen::MatrixXd::Zero(n, n), gram = Eigen::MatrixXd::Zero(n + 1, n + 1);
    for (int i = 0; i < n; ++i) {
      for (int k = 0; k <= n; ++k) {
        for (int j = 0; j < n; ++j) expected(i, j) += a(i, k) * b(k, j);
        for (int j = 0; j <= n; ++j) gram(k, j) += 3 * a(i, k) * a(i, j);
      }
    }
    EXPECT_LT(Distance(expected, Multiply(a, b)), kRounding);
    EXPECT_LT(Distance(expected, MultiplyTransposed(a.transpose(), b)), kRounding);
    EXPECT_LT(Distance(expected, MultiplyByTransposed(a, b.transpose())), kRounding);
    Eigen::MatrixXd sum = expected;
    AddProduct(a, b, &sum);
    EXPECT_LT(Distance(2 * expected, sum), kRounding);
    Eigen::MatrixXd sum_of_grams = gram;
    AddGram(3, a, &sum_of_grams);
    EXPECT_LT(Distance(2 * gram, sum_of_grams), kRounding);
  }
}

// A chain of springs, and the same with a drift, which makes it unsymmetric.
TEST(LinearAlgebra, SparseFactorsSolve) {
  constexpr int kSize = 30;
  for (const double drift : {0.0, 0.3}) {
    std::vector<Eigen::Triplet<double>> entries;
    Eigen::MatrixXd dense = Eigen::MatrixXd::Zero(kSize, kSize);
    const auto add = [&](int row, int column, double value) {
      entries.emplace_back(row, column, value);
      dense(row, column) += value;
    };
    for (int i = 0; i < kSize; ++i) {
      add(i, i, 1);
      add(i, i, 1.5);  // entries of the same place are summed
      if (i > 0) add(i, i - 1, -1 - drift);
      if (i + 1 < kSize) add(i, i + 1, -1);
    }
    const SparseMatrix matrix = SparseFromEntries(kSize, entries);
    const Eigen::VectorXd x = Random(kSize, 1, 13);
    SparseLu lu;
    ASSERT_TRUE(lu.Factor(matrix));
    EXPECT_LT(Distance(x, lu.Solve(dense * x)), kRounding);
    EXPECT_LT(Distance(x, lu.SolveTransposed(dense.transpose() * x)), kRounding);
    if (drift != 0) continue;
    SparseLdlt ldlt, analyzed;
    ASSERT_TRUE(ldlt.Factor(matrix));
    EXPECT_LT(Distance(x, ldlt.Solve(dense * x)), kRounding);
    analyzed.Analyze(matrix);
    ASSERT_TRUE(analyzed.FactorAnalyzed(matrix));
    EXPECT_LT(Distance(x, analyzed.Solve(dense * x)), kRounding);
  }
}

}  // namespace
}  // namespace saltus
