// Lemke's method, contacts with friction as a complementarity problem, and what iterations share: against the
// conditions that define the solution, and against all combinations of contact modes.
#include "contact/solvers/complementarity.h"

#include <gtest/gtest.h>

#include <Eigen/LU>
#include <cmath>
#include <optional>
#include <random>
#include <vector>

namespace saltus {
namespace {

// M is positive semidefinite but for a skew part, so that each problem has a solution.
TEST(Lemke, SolvesRandomProblems) {
  std::mt19937 random(1);
  std::uniform_real_distribution<double> uniform(-1, 1);
  for (const int n : {1, 2, 7, 40}) {
    for (int trial = 0; trial < 20; ++trial) {
      const Eigen::MatrixXd A = Eigen::MatrixXd::NullaryExpr(n, n, [&] { return uniform(random); });
      const Eigen::MatrixXd B = Eigen::MatrixXd::NullaryExpr(n, n, [&] { return uniform(random); });
      const Eigen::MatrixXd M = A * A.transpose() + B - B.transpose();
      const Eigen::VectorXd q = Eigen::VectorXd::NullaryExpr(n, [&] { return uniform(random); });
      const std::optional<Eigen::VectorXd> z = SolveByLemke(M, q, 50 * n);
      ASSERT_TRUE(z) << n;
      const Eigen::VectorXd w = M * *z + q;
      const double rounding = 1e-9 * (1 + z->maxCoeff());
      EXPECT_GE(z->minCoeff(), -rounding);
      EXPECT_GE(w.minCoeff(), -rounding);
      EXPECT_NEAR(z->dot(w), 0, n * rounding);
    }
  }
}

TEST(Lemke, ReturnsNothingOnARayOrAtTheLimit) {
  EXPECT_FALSE(SolveByLemke(-Eigen::MatrixXd::Identity(2, 2), Eigen::Vector2d(-1, 1), 100));
  EXPECT_FALSE(SolveByLemke(Eigen::MatrixXd::Identity(2, 2), Eigen::Vector2d(-1, -2), 1));
}

// The contacts of a few unit masses in the plane: responses R = J J^T and accelerations a = J g of random g.
struct Contacts {
  Contacts(int contacts, int masses, std::mt19937* random) : given(2 * contacts) {
    std::uniform_real_distribution<double> uniform(-1, 1);
    Eigen::MatrixXd J = Eigen::MatrixXd::Zero(2 * contacts, 2 * masses);
    for (int k = 0; k < contacts; ++k) {
      const double angle = 3.2 * uniform(*random);
      const int mass = static_cast<int>((*random)() % masses);
      J.block<2, 2>(2 * k, 2 * mass) << std::cos(angle), std::sin(angle), -std::sin(angle), std::cos(angle);
    }
    responses = J * J.transpose();
    given = J * Eigen::VectorXd::NullaryExpr(2 * masses, [&] { return uniform(*random); });
  }
  Eigen::MatrixXd responses;
  Eigen::VectorXd given;
};

// The largest violation of the conditions of SolveFrictionalLcp.
double Violation(double friction, const Contacts& contacts, const std::vector<int>& sliding, const Eigen::VectorXd& f) {
  const Eigen::VectorXd b = contacts.responses * f + contacts.given;
  double violation = 0;
  for (std::size_t k = 0; k < sliding.size(); ++k) {
    const double bound = friction * f[2 * k], tangential = f[2 * k + 1], along = b[2 * k + 1];
    violation = std::max({violation, -f[2 * k], -b[2 * k], std::abs(f[2 * k] * b[2 * k])});
    if (sliding[k] != 0) {
      violation = std::max(violation, std::abs(tangential + sliding[k] * bound));
      continue;
    }
    violation = std::max(violation, std::abs(tangential) - bound);
    if (along > 0) violation = std::max(violation, along * (tangential + bound));
    if (along < 0) violation = std::max(violation, -along * (bound - tangential));
  }
  return violation;
}

TEST(FrictionalLcp, SolvesContactsThatRestAndSlide) {
  std::mt19937 random(4);
  int found = 0, not_found = 0, active = 0;
  for (int trial = 0; trial < 300; ++trial) {
    const int n = 1 + trial % 5;
    const Contacts contacts(n, 1 + trial % 3, &random);
    const double friction = trial % 4 == 0 ? 0.0 : 0.3;
    std::vector<int> sliding(n, 0);
    if (trial % 2 == 1) sliding[0] = trial % 3 == 0 ? 1 : -1;
    const std::vector<double> of_each(n, friction);
    const auto forces = SolveFrictionalLcp(of_each, contacts.responses, contacts.given, sliding);
    not_found += !forces && trial % 2 == 0;
    if (!forces) continue;
    ++found;
    active += forces->lpNorm<Eigen::Infinity>() > 1e-6;
    EXPECT_LT(Violation(friction, contacts, sliding, *forces), 1e-9) << trial;
  }
  // Contacts that do not slide always have forces; where several walls hold a mass, ties of pivots may miss them.
  EXPECT_LE(not_found, 3);
  EXPECT_GT(found, 250);
  EXPECT_GT(active, 150);
}

TEST(GaussSeidelSweep, VisitsRowsInOrderAndReturnsTheLargestChange) {
  std::vector<std::ptrdiff_t> visited;
  const auto relax = [&](std::ptrdiff_t row) {
    visited.push_back(row);
    return row == 1 ? 5.0 : 1.0;
  };
  EXPECT_EQ(GaussSeidelSweep(3, relax), 5);
  EXPECT_EQ(GaussSeidelSweep(3, relax, /*backwards=*/true), 5);
  EXPECT_EQ(visited, (std::vector<std::ptrdiff_t>{0, 1, 2, 2, 1, 0}));
}

TEST(BlockPivoting, ChangesOneRowAfterThreeStepsWithoutProgressUntilThereIsSome) {
  BlockPivoting blocks;
  for (const auto& [wrong, all] : std::vector<std::pair<int, bool>>{
           {5, true}, {5, true}, {7, true}, {6, true}, {5, false}, {9, false}, {4, true}}) {
    EXPECT_EQ(blocks.ChangesAll(wrong), all) << wrong;
  }
}

}  // namespace
}  // namespace saltus
