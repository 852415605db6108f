#include "contact/solvers/lcp_solver.h"

#include <gtest/gtest.h>

#include <Eigen/QR>
#include <cmath>
#include <random>

#include "base/linear_algebra.h"

namespace saltus {
namespace {

// Contacts of a few unit-mass points in the plane in random directions: rows n, t, n, t, ... or just normals.
BoxedLcp RandomProblem(int contacts, int points, double friction, std::mt19937* random) {
  std::uniform_real_distribution<double> uniform(-1, 1);
  const int rows = friction > 0 ? 2 : 1;
  Eigen::MatrixXd A = Eigen::MatrixXd::Zero(contacts * rows, 2 * points);
  BoxedLcp problem;
  problem.friction = Eigen::VectorXd::Constant(contacts * rows, friction);
  for (int i = 0; i < contacts; ++i) {
    const double angle = 3.2 * uniform(*random);
    const int a = static_cast<int>((*random)() % points);
    const int b = static_cast<int>((*random)() % points);
    for (int row = 0; row < rows; ++row) {
      const Eigen::RowVector2d d(std::cos(angle + row * M_PI / 2), std::sin(angle + row * M_PI / 2));
      A.block<1, 2>(i * rows + row, 2 * a) = d;
      if (a != b) A.block<1, 2>(i * rows + row, 2 * b) = -d;
      problem.normal.push_back(i * rows);
    }
  }
  problem.matrix = A * A.transpose();
  Eigen::VectorXd velocity(2 * points);
  for (int i = 0; i < velocity.size(); ++i) velocity[i] = uniform(*random);
  problem.rhs = A * velocity;
  return problem;
}

// All solutions, by trying every assignment of classes.
std::vector<Eigen::VectorXd> AllSolutions(const BoxedLcp& problem) {
  const int n = problem.size();
  std::vector<Eigen::VectorXd> solutions;
  for (long code = 0; code < std::pow(4, n); ++code) {
    // Equations: x = 0, w = 0, x = +-mu x_n.
    Eigen::MatrixXd equations = Eigen::MatrixXd::Zero(n, n);
    Eigen::VectorXd right = Eigen::VectorXd::Zero(n);
    bool possible = true;
    for (int i = 0; i < n; ++i) {
      const int c = (code >> (2 * i)) & 3;
      if (c >= 2 && problem.IsNormal(i)) possible = false;
      if (c == 1) {
        equations.row(i) = problem.matrix.row(i);
        right[i] = problem.rhs[i];
      } else {
        equations(i, i) = 1;
        if (c >= 2) equations(i, problem.normal[i]) = c == 2 ? -problem.friction[i] : problem.friction[i];
      }
    }
    if (!possible) continue;
    const Eigen::VectorXd x = LeastNormSolution(equations, right);
    if (LcpViolation(problem, x, 1e-9) < 1e-9) solutions.push_back(x);
  }
  return solutions;
}

TEST(LcpSolver, OneContact) {
  BoxedLcp problem;
  problem.matrix = Eigen::Vector2d(0.5, 0.5).asDiagonal();
  problem.normal = {0, 0};
  problem.friction = Eigen::Vector2d(0.3, 0.3);
  const auto solve = [&](double normal, double tangent) {
    problem.rhs = Eigen::Vector2d(normal, tangent);
    return SolveBoxedLcp(problem);
  };
  EXPECT_TRUE(solve(2, 0.1).x.isApprox(Eigen::Vector2d(4, 0.2), 1e-14));
  EXPECT_TRUE(solve(2, 3).x.isApprox(Eigen::Vector2d(4, 1.2), 1e-14));
  EXPECT_TRUE(solve(2, -3).x.isApprox(Eigen::Vector2d(4, -1.2), 1e-14));
  EXPECT_EQ(solve(2, -3).classes[1], LcpClass::kLowerBound);
  EXPECT_EQ(solve(2, 0).classes[1], LcpClass::kClamping);
  EXPECT_EQ(solve(-2, 3).x.norm(), 0);
  EXPECT_EQ(solve(4e-7, 3).x.norm(), 0);  // an impulse below 1e-6 is none
}

TEST(LcpSolver, FrictionlessAgainstEnumeration) {
  std::mt19937 random(1);
  for (int trial = 0; trial < 300; ++trial) {
    const BoxedLcp problem = RandomProblem(1 + trial % 6, 1 + trial % 3, 0, &random);
    const LcpSolution solution = SolveBoxedLcp(problem);
    EXPECT_EQ(solution.regularization, 0);
    EXPECT_LT(LcpViolation(problem, solution.x, 1e-9), 1e-5);
    const auto all = AllSolutions(problem);
    ASSERT_FALSE(all.empty());
    // Impulses need not be unique, velocities are; impulses below 1e-6 are left out.
    EXPECT_LT((problem.matrix * (solution.x - all[0])).norm(), 1e-5) << "trial " << trial;
  }
}

TEST(LcpSolver, FrictionAgainstEnumeration) {
  std::mt19937 random(2);
  int solvable = 0;
  for (int trial = 0; trial < 200; ++trial) {
    const BoxedLcp problem = RandomProblem(1 + trial % 3, 1 + trial % 3, trial % 2 ? 0.3 : 0.9, &random);
    const LcpSolution solution = SolveBoxedLcp(problem);
    ASSERT_TRUE(solution.x.allFinite());
    const auto all = AllSolutions(problem);
    if (all.empty()) continue;
    ++solvable;
    EXPECT_EQ(solution.regularization, 0) << "trial " << trial;
    EXPECT_LT(LcpViolation(problem, solution.x, 1e-5), 1e-5) << "trial " << trial;
    double nearest = 1e9;
    for (const Eigen::VectorXd& x : all) nearest = std::min(nearest, (problem.matrix * (solution.x - x)).norm());
    EXPECT_LT(nearest, 1e-5) << "trial " << trial;
  }
  EXPECT_GT(solvable, 150);
}

// Two opposite walls, one of which wants to be left: no solution. The regularised one pushes with both.
TEST(LcpSolver, NoSolution) {
  BoxedLcp problem;
  problem.matrix.resize(2, 2);
  problem.matrix << 1, -1, -1, 1;
  problem.rhs = Eigen::Vector2d(2, -1);
  problem.normal = {0, 1};
  const LcpSolution solution = SolveBoxedLcp(problem);
  EXPECT_EQ(solution.regularization, 1e-4);
  // (x_0 - x_1) (2 + 1e-4) = 3, so the velocity after is half way between what the two want.
  EXPECT_NEAR(solution.x[0] - solution.x[1], 1.5, 1e-3);
}

// Many redundant contacts: a point in a funnel of planes.
TEST(LcpSolver, ManyRedundantContacts) {
  std::mt19937 random(3);
  for (int trial = 0; trial < 20; ++trial) {
    const BoxedLcp problem = RandomProblem(40, 5, 0, &random);
    const LcpSolution solution = SolveBoxedLcp(problem);
    EXPECT_EQ(solution.regularization, 0);
    EXPECT_LT(LcpViolation(problem, solution.x, 1e-5), 1e-5);
  }
}

}  // namespace
}  // namespace saltus
