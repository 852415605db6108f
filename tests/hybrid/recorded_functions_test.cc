// Systems from expression graphs beside the same systems as templates.
#include "hybrid/recorded_functions.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <memory>
#include <random>

#include "problems/hybrid_systems.h"

namespace saltus {
namespace {

using Node = ExpressionGraph::Node;
using enum Operation;

// x^2 sin(y) + where(x < y, y, x / y), and x y.
ExpressionGraph Example() {
  return {.num_inputs = 2,
          .nodes = {{kInput, 0},
                    {kInput, 1},
                    {.operation = kConstant, .value = 2},
                    {kPower, 0, 2},
                    {kSin, 1},
                    {kMultiply, 3, 4},
                    {kLess, 0, 1},
                    {kDivide, 0, 1},
                    {kWhere, 6, 1, 7},
                    {kAdd, 5, 8},
                    {kMultiply, 0, 1}},
          .outputs = {9, 10}};
}

TEST(RecordedFunction, HasValuesAndDerivatives) {
  const RecordedFunction function(Example());
  for (const bool less : {true, false}) {
    const double x = 0.7, y = less ? 1.1 : 0.4;
    double values[2], jacobian[4], again[2];
    const RecordedFunction::Part inputs[] = {{&x, 1}, {&y, 1}};
    function.Linearize(inputs, 2, values, jacobian);
    EXPECT_DOUBLE_EQ(values[0], x * x * std::sin(y) + (less ? y : x / y));
    EXPECT_DOUBLE_EQ(values[1], x * y);
    EXPECT_DOUBLE_EQ(jacobian[0], 2 * x * std::sin(y) + (less ? 0 : 1 / y));
    EXPECT_DOUBLE_EQ(jacobian[1], x * x * std::cos(y) + (less ? 1 : -x / (y * y)));
    EXPECT_DOUBLE_EQ(jacobian[2], y);
    EXPECT_DOUBLE_EQ(jacobian[3], x);
    function.Evaluate(inputs, again);
    EXPECT_EQ(again[0], values[0]);
    EXPECT_EQ(again[1], values[1]);
  }
}

TEST(RecordedFunction, BadRecordingsAreRefused) {
  ExpressionGraph recording = Example();
  recording.nodes[3].b = 3;
  EXPECT_THAT(Validate(recording), testing::HasSubstr("node 3: found operand 3"));
  recording = Example();
  recording.nodes[1].a = 2;
  EXPECT_THAT(Validate(recording), testing::HasSubstr("found input 2, expected 0 to 1"));
  recording = Example();
  recording.outputs = {11};
  EXPECT_THAT(Validate(recording), testing::HasSubstr("found output 11"));
}

TEST(RecordedFunction, BoundsHoldTheValuesOfAllOperations) {
  std::mt19937_64 random(1);
  std::uniform_real_distribution<double> at(0, 1);
  constexpr double kInfinity = std::numeric_limits<double>::infinity();
  int finite = 0, narrow = 0, all = 0;
  for (int number = static_cast<int>(kAdd); number <= static_cast<int>(kErf); ++number) {
    const auto operation = static_cast<Operation>(number);
    for (int trial = 0; trial < 500; ++trial) {
      const auto draw = [&](bool whole) {
        const double low = std::round((8 * at(random) - 4) * 4) / (whole ? 2 : 4), width = 2 * at(random) * at(random);
        return Bounds{low, trial % 3 == 0 || whole ? low : low + width};
      };
      const Bounds a = draw(false), b = draw(operation == kPower && trial % 2 == 0), c = draw(false);
      const Bounds bounds = ApplyToBounds(operation, a, b, c);
      for (int point = 0; point < 20; ++point) {
        const auto within = [&](Bounds of) { return of.low + (of.high - of.low) * at(random); };
        const double value = Apply(operation, within(a), within(b), within(c));
        if (!std::isfinite(value)) continue;
        const double rounding = 1e-14 * std::abs(value);
        EXPECT_LE(bounds.low, value + rounding) << NameOf(operation) << " of " << a.low << " to " << a.high;
        EXPECT_GE(bounds.high, value - rounding) << NameOf(operation) << " of " << a.low << " to " << a.high;
      }
      ++all;
      finite += bounds.low > -kInfinity && bounds.high < kInfinity ? 1 : 0;
      narrow += bounds.high - bounds.low < 1 ? 1 : 0;
    }
  }
  EXPECT_GT(finite, all * 3 / 4);
  EXPECT_GT(narrow, all / 3);
}

TEST(RecordedCost, FillsTheJacobiansOfItsBlocks) {
  const RecordedCost cost(RecordedFunction(Example()), {1, 1});
  const double x = 0.7, y = 1.1;
  const double* blocks[] = {&x, &y};
  double residuals[2], by_y[2];
  double* jacobians[] = {nullptr, by_y};
  ASSERT_TRUE(cost.Evaluate(blocks, residuals, jacobians));
  EXPECT_DOUBLE_EQ(by_y[0], x * x * std::cos(y) + 1);
  EXPECT_DOUBLE_EQ(by_y[1], x);
}

// [y v t g e f] and the bouncing ball's functions.
HybridSystem RecordedBall() {
  const std::vector<Node> inputs = {{kInput, 0}, {kInput, 1}, {kInput, 2}, {kInput, 3}, {kInput, 4}};
  ExpressionGraph flow{.num_inputs = 6, .nodes = inputs, .outputs = {1, 6}};
  flow.nodes.push_back({kInput, 5});
  flow.nodes.push_back({kSubtract, 5, 3});
  const ExpressionGraph guard{.num_inputs = 5, .nodes = inputs, .outputs = {0}};
  ExpressionGraph reset{.num_inputs = 5, .nodes = inputs, .outputs = {5, 7}};
  reset.nodes.push_back({kConstant});
  reset.nodes.push_back({kNegate, 4});
  reset.nodes.push_back({kMultiply, 6, 1});
  RecordedSystem::Mode mode{RecordedFunction(flow), {}};
  mode.transitions.push_back({RecordedFunction(guard), RecordedFunction(reset), 0});
  HybridLayout layout{.num_controls = 1, .num_parameters = 2, .state_sizes = {2}, .num_guards = {1}};
  return HybridSystem(std::make_shared<RecordedSystem>(layout, std::vector<RecordedSystem::Mode>{mode}));
}

TEST(RecordedSystem, MovesAsTheTemplateDoes) {
  const HybridInput input{
      .initial = {1.3, 0.4}, .parameters = {9.81, 0.8}, .duration = 2, .num_intervals = 3, .control = {0.5, -0.4, 0.2}};
  HybridSimulator recorded(RecordedBall()), written{HybridSystem(BouncingBall())};
  ASSERT_TRUE(recorded.Rollout(input)) << recorded.FailureReason();
  ASSERT_TRUE(written.Rollout(input));
  const HybridSensitivity a = recorded.Sensitivity(), b = written.Sensitivity();
  for (int i = 0; i < 2; ++i) EXPECT_NEAR(recorded.final_state()[i], written.final_state()[i], 1e-14);
  for (std::size_t i = 0; i < b.final_state.size(); ++i) EXPECT_NEAR(a.final_state[i], b.final_state[i], 1e-12);
  const std::vector<double> cotangent = {0.3, -0.7};
  const HybridGradient c = recorded.Adjoint(cotangent), d = written.Adjoint(cotangent);
  for (int i = 0; i < 3; ++i) EXPECT_NEAR(c.control[i], d.control[i], 1e-12);
  for (int i = 0; i < 2; ++i) EXPECT_NEAR(c.parameters[i], d.parameters[i], 1e-12);
}

// x' = 1 for 40 states, and a guard x_37 - t p that reads few of them.
TEST(RecordedSystem, AGuardOfManyStatesHasTheDerivativesOfWhatItReads) {
  constexpr int kStates = 40, kRead = 37, kTime = kStates, kParameter = kStates + 1;
  ExpressionGraph flow{.num_inputs = kStates + 2, .nodes = {{.operation = kConstant, .value = 1}}};
  flow.outputs.assign(kStates, 0);
  const ExpressionGraph guard{
      .num_inputs = kStates + 2,
      .nodes = {{kInput, kRead}, {kInput, kTime}, {kInput, kParameter}, {kMultiply, 1, 2}, {kSubtract, 0, 3}},
      .outputs = {4}};
  ExpressionGraph reset{.num_inputs = kStates + 2};
  for (int i = 0; i < kStates; ++i) {
    reset.nodes.push_back({kInput, i});
    reset.outputs.push_back(i);
  }
  RecordedSystem::Mode mode{RecordedFunction(flow), {}};
  mode.transitions.push_back({RecordedFunction(guard), RecordedFunction(reset), 0});
  const RecordedSystem system(HybridLayout{.num_parameters = 1, .state_sizes = {kStates}, .num_guards = {1}}, {mode});
  std::vector<double> x(kStates), xdot(kStates, 1.0), gradient(kStates + 2);
  for (int i = 0; i < kStates; ++i) x[i] = 100 + i;
  const double t = 3, p = 7;
  const ModePoint at{.mode = 0, .t = t, .x = x.data(), .p = &p};
  EXPECT_EQ(system.Guard(at, 0), 137 - 21);
  double rate = 0;
  EXPECT_EQ(system.GuardRate(at, 0, xdot.data(), &rate), 137 - 21);
  EXPECT_EQ(rate, 1 - 7);
  system.GuardGradient(at, 0, gradient.data());
  for (int i = 0; i < kStates + 2; ++i) {
    EXPECT_EQ(gradient[i], i == kRead ? 1 : i == kTime ? -7 : i == kParameter ? -3 : 0) << i;
  }
  std::vector<GuardTerm> terms;
  std::vector<std::size_t> ends;
  system.AppendAllGuardTerms(at, &terms, &ends);
  ASSERT_EQ(terms.size(), 3u);
  EXPECT_EQ(ends, std::vector<std::size_t>{3});
  EXPECT_EQ(terms[0].input, kTime);
  EXPECT_EQ(terms[1].input, kRead);
  EXPECT_EQ(terms[2].input, kParameter);
  for (const GuardTerm& term : terms) EXPECT_EQ(term.derivative, gradient[term.input]);
}

}  // namespace
}  // namespace saltus
