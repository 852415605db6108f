// Steps of affine flows beside matrix exponentials of Eigen, and where recordings are recognised as affine.
#include "saltus/internal/linear_flow.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <Eigen/Core>
#include <cmath>
#include <memory>
#include <random>
#include <unsupported/Eigen/MatrixFunctions>

#include "hybrid/recorded_functions.h"

namespace saltus {
namespace {

using Eigen::MatrixXd;
using Eigen::VectorXd;
using RowMajor = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;
using enum Operation;

// xdot = [A b C B] [x t p u] + d.
struct Affine {
  MatrixXd by;  // n x (n + 1 + P + m)
  VectorXd d;

  int n() const { return static_cast<int>(by.rows()); }
  int columns() const { return static_cast<int>(by.cols()); }
  LinearFlow flow() const {
    std::vector<LinearFlow::Entry> entries;
    for (int i = 0; i < n(); ++i) {
      for (int j = 0; j < columns(); ++j) {
        if (by(i, j) != 0) entries.push_back({i, j, by(i, j)});
      }
    }
    return {n(), columns(), entries};
  }
  // The derivatives of the state after a step by [x t p u] and, in the last column, by d: of a system in which the time
  // rises and all else of [t p u 1] is held.
  MatrixXd Exact(double h) const {
    MatrixXd all = MatrixXd::Zero(columns() + 1, columns() + 1);
    all.topLeftCorner(n(), columns()) = by;
    all.topRightCorner(n(), 1) = d;
    all(n(), columns()) = 1;
    return (all * h).exp().topRows(n());
  }
};

Affine RandomFlow(int n, int others, std::mt19937* random) {
  std::normal_distribution<double> normal;
  Affine affine{MatrixXd::NullaryExpr(n, n + 1 + others, [&] { return normal(*random); }),
                VectorXd::NullaryExpr(n, [&] { return normal(*random); })};
  return affine;
}

void ExpectExact(const Affine& affine, double h, double tolerance) {
  const int n = affine.n(), columns = affine.columns(), num_parameters = (columns - n - 1) / 2;
  const LinearFlow flow = affine.flow();
  const MatrixXd exact = affine.Exact(h);
  const VectorXd z = VectorXd::LinSpaced(columns, -1.0, 1.3), slope = affine.by * z + affine.d;
  VectorXd one(columns + 1);
  one << z, 1;
  const VectorXd expected = exact * one;
  VectorXd after(n);
  flow.Step(h, z.data(), slope.data(), after.data());
  const double size = std::max(1.0, expected.cwiseAbs().maxCoeff());
  EXPECT_LE((after - expected).cwiseAbs().maxCoeff(), tolerance * size) << affine.by << "\nh = " << h;
  RowMajor jacobian(n, columns);
  flow.Jacobian(h, jacobian.data());
  const double entry = std::max(1.0, exact.cwiseAbs().maxCoeff());
  EXPECT_LE((jacobian - exact.leftCols(columns)).cwiseAbs().maxCoeff(), tolerance * entry) << "h = " << h;
  const VectorXd cotangent = VectorXd::LinSpaced(n, 0.7, -1.1);
  const VectorXd pulled = exact.leftCols(columns).transpose() * cotangent;
  VectorXd x(n), p = VectorXd::Zero(num_parameters), u = VectorXd::Zero(columns - n - 1 - num_parameters),
                 found(columns);
  StepCotangent out;
  out.x = x.data();
  out.p = p.data();
  out.u = u.data();
  flow.PullBack(h, cotangent.data(), num_parameters, &out);
  found << x, out.t, p, u;
  EXPECT_LE((found - pulled).cwiseAbs().maxCoeff(), tolerance * entry) << "h = " << h;
}

TEST(LinearFlow, AgreesWithMatrixExponentials) {
  std::mt19937 random(1);
  for (int n = 1; n <= 8; ++n) {
    for (const double h : {0.0, 1e-6, 0.1, 1.0, 3.0}) ExpectExact(RandomFlow(n, 4, &random), h, 2e-13);
  }
  ExpectExact(RandomFlow(40, 6, &random), 0.7, 1e-12);
}

TEST(LinearFlow, TakesChainsOfIntegratorsExactly) {
  Affine chain{MatrixXd::Zero(4, 6), VectorXd::Zero(4)};
  for (int i = 0; i < 3; ++i) chain.by(i, i + 1) = 1;
  chain.by(3, 5) = 1;
  ExpectExact(chain, 100, 1e-14);
  double x[4] = {}, after[4];
  const double slope[4] = {0, 0, 0, 24};
  chain.flow().Step(2, x, slope, after);
  EXPECT_THAT(after, testing::ElementsAre(16, 32, 48, 48));  // t^4, 4 t^3, 12 t^2, 24 t
}

TEST(LinearFlow, TakesStiffAndFastFlows) {
  Affine stiff{MatrixXd::Zero(2, 4), VectorXd::Ones(2)};
  stiff.by.leftCols(2) << -1e6, 2e5, 0, -1;
  stiff.by(1, 3) = 1;
  ExpectExact(stiff, 0.5, 1e-9);
  // cos and sin of the angle that is left of 1000 turns and a quarter.
  Affine circle{MatrixXd::Zero(2, 3), VectorXd::Zero(2)};
  circle.by.leftCols(2) << 0, -1, 1, 0;
  const double x[2] = {1, 0}, slope[2] = {0, 1}, h = (1000 + 0.25) * 2 * M_PI;
  double after[2];
  circle.flow().Step(h, x, slope, after);
  EXPECT_NEAR(after[0], std::cos(h), 1e-9);
  EXPECT_NEAR(after[1], std::sin(h), 1e-9);
}

// A unit in which an entry is large does not make the parts of a step short: a turn by 1.5, in meters and nanometers.
TEST(LinearFlow, BalancesUnits) {
  constexpr double kUnit = 1e9, kAngle = 1.5;
  const LinearFlow flow(2, 3, {{0, 1, kUnit}, {1, 0, -1 / kUnit}});
  const double x[2] = {0.5, 2 / kUnit}, slope[2] = {2, -0.5 / kUnit}, c = std::cos(kAngle), s = std::sin(kAngle);
  double after[2], jacobian[6];
  flow.Step(kAngle, x, slope, after);
  EXPECT_NEAR(after[0], c * 0.5 + s * 2, 1e-14);
  EXPECT_NEAR(after[1] * kUnit, -s * 0.5 + c * 2, 1e-14);
  flow.Jacobian(kAngle, jacobian);
  const double expected[6] = {c, s * kUnit, 0, -s / kUnit, c, 0};
  for (int i = 0; i < 6; ++i) EXPECT_NEAR(jacobian[i], expected[i], 1e-13 * std::abs(expected[i])) << i;
}

// [x v t u floor] or what else is there.
ExpressionGraph GraphOf(std::vector<ExpressionGraph::Node> nodes, std::vector<int> outputs) {
  std::vector<ExpressionGraph::Node> all = {{kInput, 0}, {kInput, 1}, {kInput, 2}, {kInput, 3}, {kInput, 4}};
  all.push_back({.operation = kConstant, .value = 3});
  all.insert(all.end(), nodes.begin(), nodes.end());
  return {.num_inputs = 5, .nodes = std::move(all), .outputs = std::move(outputs)};
}

TEST(AffineDerivatives, AreFoundInTheRecording) {
  // v; -3 x + v / 3 - t + (u - x) + exp(3) and what is a number to a piece, its integer part.
  const ExpressionGraph graph = GraphOf({{kMultiply, 5, 0},
                                         {kNegate, 6},
                                         {kDivide, 1, 5},
                                         {kAdd, 7, 8},
                                         {kSubtract, 9, 2},
                                         {kSubtract, 3, 0},
                                         {kAdd, 10, 11},
                                         {kExp, 5},
                                         {kAdd, 12, 13},
                                         {kSin, 4},
                                         {kAdd, 14, 15}},
                                        {1, 16});
  const auto found = AffineDerivatives(graph, 4);
  ASSERT_TRUE(found.has_value());
  MatrixXd by = MatrixXd::Zero(2, 4), expected(2, 4);
  for (const LinearFlow::Entry& entry : *found) by(entry.row, entry.column) = entry.value;
  expected << 0, 1, 0, 0, -4, 1.0 / 3, -1, 1;
  EXPECT_EQ(by, expected);
}

TEST(AffineDerivatives, AreNotFoundWhereAFunctionBends) {
  using Nodes = std::vector<ExpressionGraph::Node>;
  for (const Nodes& nodes : {Nodes{{kMultiply, 0, 3}},                               // a product of inputs
                             Nodes{{kDivide, 5, 1}},                                 //
                             Nodes{{kFloor, 0}},                                     // whose derivative is zero
                             Nodes{{kSign, 1}},                                      //
                             Nodes{{kAbs, 3}},                                       //
                             Nodes{{kLess, 0, 5}, {kAdd, 0, 5}, {kWhere, 6, 0, 7}},  // one derivative, with a jump
                             Nodes{{kMultiply, 4, 0}},                               // a factor that a piece changes
                             Nodes{{kPower, 0, 5}},
                             Nodes{{kSin, 2}}}) {
    const int last = 5 + static_cast<int>(nodes.size());
    EXPECT_FALSE(AffineDerivatives(GraphOf(nodes, {1, last}), 4).has_value()) << NameOf(nodes.back().operation);
  }
}

}  // namespace
}  // namespace saltus
