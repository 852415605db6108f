// The loss and its derivatives against values by hand.
#include "saltus/control/objective.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <vector>

namespace saltus {
namespace {

using testing::DoubleEq;
using testing::ElementsAre;
using testing::Pointwise;

// Two discs, whose states have a number of rotation; two terms of the first, one of them linear too.
constexpr int kBodySize = 5;
const std::vector<double> kState = {1, 2, 3, 4, 100, -1, -2, 0.5, 0.25, 200};

Objective ThreeTerms() {
  using Quantity = TerminalTerm::Quantity;
  Objective objective;
  objective.terminal = {{.body = 0, .quantity = Quantity::kPosition, .target = {0, 4}, .weight = 3},
                        {.body = 0, .quantity = Quantity::kPosition, .target = {2, 2}, .weight = 0.5},
                        {.body = 1, .quantity = Quantity::kVelocity, .target = {0.5, 0}, .weight = 2}};
  return objective;
}

TEST(Objective, TermsOfOneDiscAddUp) {
  const Objective objective = ThreeTerms();
  EXPECT_DOUBLE_EQ(TerminalLoss(objective, kState, kBodySize), 3 * (1 + 4) + 0.5 * 1 + 2 * 0.0625);
  std::vector<double> gradient(kState.size(), -7);
  TerminalGradient(objective, kState, kBodySize, gradient);
  EXPECT_THAT(gradient, ElementsAre(2 * 3 * 1 - 2 * 0.5 * 1, 2 * 3 * -2, 0, 0, 0, 0, 0, 0, 2 * 2 * 0.25, 0));
}

TEST(Objective, ALinearTermHasAConstantGradient) {
  Objective objective = ThreeTerms();
  objective.terminal.push_back(
      {.body = 0, .quantity = TerminalTerm::Quantity::kVelocity, .component = 1, .weight = -3});
  EXPECT_FALSE(objective.IsSumOfSquares());
  EXPECT_DOUBLE_EQ(TerminalLoss(objective, kState, kBodySize), TerminalLoss(ThreeTerms(), kState, kBodySize) - 12);
  std::vector<double> gradient(kState.size());
  TerminalGradient(objective, kState, kBodySize, gradient);
  EXPECT_EQ(gradient[3], -3);
}

// The least squares are the same loss: |r|^2, and 2 J^T r.
TEST(Objective, ResidualsAreThoseOfTheLoss) {
  const Objective objective = ThreeTerms();
  std::vector<double> residuals(NumTerminalResiduals(objective)), gradient(kState.size());
  TerminalResiduals(objective, kState, kBodySize, residuals);
  const Eigen::Map<const Eigen::VectorXd> r(residuals.data(), residuals.size());
  EXPECT_DOUBLE_EQ(r.squaredNorm(), TerminalLoss(objective, kState, kBodySize));
  TerminalGradient(objective, kState, kBodySize, gradient);
  const Eigen::VectorXd by_residuals =
      2 * TerminalJacobian(objective, static_cast<int>(kState.size()), kBodySize).transpose() * r;
  for (size_t i = 0; i < gradient.size(); ++i) EXPECT_NEAR(by_residuals[i], gradient[i], 1e-14) << i;
}

// Whatever the number of forces: they are summed in lanes of four.
TEST(Objective, EffortCountsEveryForce) {
  Objective objective;
  objective.effort = 0.5;
  std::vector<double> control;
  double squares = 0;
  for (int n = 1; n <= 11; ++n) {
    control.push_back(n);
    squares += n * n;
    EXPECT_DOUBLE_EQ(EffortLoss(objective, control, 0.1), 0.5 * 0.1 * squares) << n;
    std::vector<double> gradient(control.size(), 10), expected;
    AddEffortGradient(objective, control, 0.1, gradient);
    for (const double u : control) expected.push_back(10 + 2 * 0.5 * 0.1 * u);
    EXPECT_THAT(gradient, Pointwise(DoubleEq(), expected)) << n;
  }
}

}  // namespace
}  // namespace saltus
