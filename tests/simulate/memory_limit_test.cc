// Rollouts that are not kept in full have the bits of those that are.
#include <gtest/gtest.h>
#include <sys/resource.h>

#include <algorithm>
#include <cmath>
#include <numeric>

#include "saltus/control/single_shooting.h"
#include "saltus/simulate/registry.h"
#include "simulate/trajectory.h"
#include "test_scenes.h"

namespace saltus {
namespace {

TEST(WindowLength, KeepsShortRolloutsWhole) {
  EXPECT_EQ(WindowLength(480, 64, std::size_t{1} << 30), 480);
  EXPECT_EQ(WindowLength(1, 1 << 20, std::size_t{1} << 30), 1);
}

TEST(WindowLength, StaysWithinTheLimitWhereItCan) {
  constexpr std::size_t kState = 64;
  for (int steps : {1000, 480000, 1000000, 10000000}) {
    const int balanced = static_cast<int>(std::ceil(std::sqrt(steps)));
    const std::size_t least = 2 * (balanced + 1) * kState;
    for (std::size_t limit : {std::size_t{0}, least, 4 * least, std::size_t{1} << 30}) {
      const int length = WindowLength(steps, kState, limit);
      ASSERT_GE(length, 1);
      ASSERT_LE(length, steps);
      const std::size_t bytes = (length + (steps + length - 1) / length) * kState;
      EXPECT_LE(bytes, std::max(limit, least)) << steps << " steps, limit " << limit;
    }
  }
}

struct Evaluation {
  bool ok = false;
  double loss = 0;
  Sensitivity gradient;
  std::vector<std::vector<double>> states;
  size_t touches = 0;
  std::size_t least_memory = 0;
};

Evaluation Evaluate(const std::string& model, const Scene& scene, std::size_t limit) {
  auto simulator = MakeSimulator(model, scene, Precision::kDouble);
  if (limit > 0) simulator->set_memory_limit(limit);
  Evaluation result;
  result.least_memory = simulator->LeastMemory();
  result.ok = simulator->Rollout(InitialState(scene), InitialControl(scene, simulator->num_steps()));
  std::vector<double> x(simulator->state_size()), cotangent(x.size());
  simulator->GetState(simulator->num_steps(), x);
  for (size_t i = 0; i < x.size(); ++i) cotangent[i] = x[i] + 0.1 * std::cos(i);
  simulator->Adjoint(cotangent, /*with_parameters=*/true, &result.gradient);
  // Again, after another part of the trajectory has been looked at.
  for (int k = 0; k <= simulator->num_steps(); k += 37) {
    simulator->GetState(k, x);
    result.states.push_back(x);
  }
  Sensitivity again;
  simulator->Adjoint(cotangent, /*with_parameters=*/true, &again);
  EXPECT_EQ(again.initial, result.gradient.initial);
  EXPECT_EQ(again.control, result.gradient.control);
  result.touches = simulator->touches().size();
  return result;
}

class MemoryLimitOf : public testing::TestWithParam<std::string> {};

TEST_P(MemoryLimitOf, ChangesNoBit) {
  const ModelTraits& model = *FindContactModel(GetParam());
  // Models that act at any distance solve a system of equations in every step.
  Scene scene = std::isinf(model.push_gap) ? BounceOffTheGrid() : FourDiscs(model.friction ? 0.3 : 0);
  scene.steps = std::isinf(model.push_gap) ? 480 : 3000;
  const Evaluation whole = Evaluate(GetParam(), scene, 0);
  ASSERT_TRUE(whole.ok);
  ASSERT_GT(whole.touches, 2u);
  for (std::size_t limit : {whole.least_memory, whole.least_memory + 1000, 4 * whole.least_memory}) {
    const Evaluation limited = Evaluate(GetParam(), scene, limit);
    EXPECT_EQ(limited.states, whole.states);
    EXPECT_EQ(limited.gradient.initial, whole.gradient.initial);
    EXPECT_EQ(limited.gradient.control, whole.gradient.control);
    const ParameterGradient &a = limited.gradient.parameters, &b = whole.gradient.parameters;
    EXPECT_EQ(a.restitution, b.restitution);
    EXPECT_EQ(a.stiffness, b.stiffness);
    EXPECT_EQ(a.friction, b.friction);
    EXPECT_EQ(a.mass, b.mass);
    EXPECT_EQ(a.gravity, b.gravity);
  }
}

std::vector<std::string> AllNames() {
  std::vector<std::string> names;
  for (const ModelTraits& model : AllContactModels()) names.emplace_back(model.name);
  return names;
}

INSTANTIATE_TEST_SUITE_P(AllModels, MemoryLimitOf, testing::ValuesIn(AllNames()),
                         [](const auto& test) { return test.param; });

// A disc that rests on the ground touches in every step: the record of its contacts does not fit.
TEST(MemoryLimit, RecordsOfContactsAreLetGo) {
  Scene scene;
  scene.duration = 10;
  scene.steps = 20000;
  scene.gravity = {0, -10};
  scene.bodies = {{.name = "a", .radius = 0.1, .position = {0, 0.0995}, .velocity = {0.1, 0}}};
  scene.planes = {{"ground", {0, 0}, {0, 1}}};
  scene.contact = {.restitution = 0, .stiffness = 2e4, .damping = 50};
  scene.control = {{0}, {Vec2d(0.1, 0.2)}};
  const Evaluation whole = Evaluate("compliant_warp", scene, 0);
  ASSERT_GT(whole.touches, 19000u);
  const Evaluation limited = Evaluate("compliant_warp", scene, std::size_t{1} << 17);
  EXPECT_EQ(limited.gradient.initial, whole.gradient.initial);
  EXPECT_EQ(limited.gradient.control, whole.gradient.control);
  EXPECT_EQ(limited.states, whole.states);
}

std::size_t LargestMemorySoFar() {
  rusage usage;
  getrusage(RUSAGE_SELF, &usage);
  return static_cast<std::size_t>(usage.ru_maxrss) << 10;
}

// The derivative of the loss by a factor on the control, which hardly depends on the number of steps.
double DerivativeByScale(const std::string& model, int steps, std::size_t limit) {
  Scene scene = ProblemScene("two_balls");
  scene.steps = steps;
  SingleShooting shooting(MakeSimulator(model, scene, Precision::kDouble));
  shooting.set_memory_limit(limit);
  const std::vector<double>& z = shooting.initial_guess();
  std::vector<double> gradient(z.size());
  double loss = 0;
  EXPECT_TRUE(shooting.Evaluate(z, &loss, gradient.data()));
  return std::inner_product(z.begin(), z.end(), gradient.begin(), 0.0);
}

// 16 bytes a step for each of guess, control and gradient, and hardly any for states.
TEST(MemoryLimit, AMillionStepsTakeLittle) {
  for (const char* model : {"direct_toi", "event"}) {
    const double expected = DerivativeByScale(model, 48000, std::size_t{1} << 30);
    const std::size_t before = LargestMemorySoFar();
    const double derivative = DerivativeByScale(model, 1000000, std::size_t{1} << 30);
    EXPECT_NEAR(derivative, expected, 1e-3 * std::abs(expected)) << model;
    EXPECT_LT(LargestMemorySoFar() - before, std::size_t{80} << 20) << model;
    // The least there is.
    EXPECT_EQ(DerivativeByScale(model, 1000000, 0), derivative) << model;
  }
}

}  // namespace
}  // namespace saltus
