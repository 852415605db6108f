// Steps as costs of Ceres: their Jacobians against those that Ceres finds by differences, for all models in free
// flight and in contact.
#include "saltus/control/step_cost.h"

#include <ceres/gradient_checker.h>
#include <gmock/gmock.h>

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <string>

#include "control/scene_constraints.h"
#include "saltus/simulate/registry.h"
#include "test_scenes.h"

namespace saltus {
namespace {

using testing::ElementsAre;

// Blocks of a step, contiguous.
struct Blocks {
  std::vector<double> x, control, next;

  std::vector<const double*> Pointers() const {
    std::vector<const double*> pointers{x.data()};
    if (!control.empty()) pointers.push_back(control.data());
    pointers.push_back(next.data());
    return pointers;
  }
};

// Steps of a rollout: one in which nothing touches, and for each pair that touches, one amid its first contact.
std::vector<int> InterestingSteps(const Simulator& simulator) {
  std::vector<int> steps{1};
  const std::vector<StepTouch>& touches = simulator.touches();
  std::vector<Candidate> seen;
  for (const StepTouch& first : touches) {
    const Candidate& pair = first.touch.candidate;
    if (std::find(seen.begin(), seen.end(), pair) != seen.end()) continue;
    seen.push_back(pair);
    int last = first.step;
    for (const StepTouch& touch : touches) {
      if (touch.touch.candidate == pair && touch.step == last + 1) last = touch.step;
    }
    steps.push_back((first.step + last) / 2);
  }
  return steps;
}

Blocks BlocksAt(const Simulator& simulator, std::span<const double> control, int k) {
  const int size = simulator.state_size(), control_size = 2 * simulator.num_controlled();
  Blocks blocks{std::vector<double>(size), {}, std::vector<double>(size)};
  simulator.GetState(k, blocks.x);
  simulator.GetState(k + 1, blocks.next);
  blocks.control.assign(control.begin() + k * control_size, control.begin() + (k + 1) * control_size);
  for (size_t i = 0; i < blocks.next.size(); ++i) blocks.next[i] += 0.01 * std::sin(1.0 + i);
  return blocks;
}

// The motion of a part of a hybrid system. Blocks: its state, its control if it has any, and the length of the step.
class MoveOfPart final : public ceres::CostFunction {
 public:
  MoveOfPart(const HybridFunctions& functions, int part) : functions_(functions), part_(part) {
    const StatePart of = functions.Parts(0)[part];
    const int n = static_cast<int>(of.states.size()), m = static_cast<int>(of.controls.size());
    set_num_residuals(n);
    *mutable_parameter_block_sizes() = m > 0 ? std::vector{n, m, 1} : std::vector{n, 1};
  }
  bool Evaluate(double const* const* blocks, double* after, double** jacobians) const override {
    const std::vector<int>& sizes = parameter_block_sizes();
    const int n = sizes[0], m = sizes.size() == 3 ? sizes[1] : 0, columns = n + 1 + m + 1;
    std::vector<double> by(n * columns);
    functions_.MovePart(
        part_, {{0, 0, blocks[0], m > 0 ? blocks[1] : nullptr, nullptr}, *blocks[sizes.size() - 1]}, after, by.data());
    const std::vector<int> first = m > 0 ? std::vector{0, n + 1, columns - 1} : std::vector{0, columns - 1};
    for (size_t block = 0; jacobians != nullptr && block < sizes.size(); ++block) {
      for (int i = 0; jacobians[block] != nullptr && i < n * sizes[block]; ++i) {
        jacobians[block][i] = by[i / sizes[block] * columns + first[block] + i % sizes[block]];
      }
    }
    return true;
  }

 private:
  const HybridFunctions& functions_;
  const int part_;
};

// By ceres::GradientChecker; its own verdict is relative even to entries that are zero up to rounding.
bool GradientsAgree(const ceres::CostFunction& cost, const std::vector<const double*>& blocks, double width,
                    std::string* error) {
  ceres::NumericDiffOptions options;
  options.ridders_relative_initial_step_size = width / 32;  // its first differences are so much wider
  ceres::GradientChecker checker(&cost, static_cast<const std::vector<const ceres::Manifold*>*>(nullptr), options);
  ceres::GradientChecker::ProbeResults results;
  checker.Probe(blocks.data(), 1e-6, &results);
  *error = results.error_log;
  if (!results.return_value) return false;
  for (size_t i = 0; i < results.jacobians.size(); ++i) {
    const double scale = std::max(1.0, results.jacobians[i].cwiseAbs().maxCoeff());
    if ((results.jacobians[i] - results.numeric_jacobians[i]).cwiseAbs().maxCoeff() > 1e-6 * scale) return false;
  }
  return true;
}

// Impacts in substeps show in narrow differences only. What Newton's method leaves of a stiff barrier blurs these.
double WidthFor(std::string_view model) { return model == "ipc_barrier" ? 1e-4 : 3e-7; }

class StepCostOf : public testing::TestWithParam<std::string> {};

TEST_P(StepCostOf, HasTheJacobianOfTheStep) {
  const std::string model = GetParam();
  const double width = WidthFor(model);
  bool touched = false;
  for (Scene scene : {FourDiscs(0), FourDiscs(0.3), BounceOffTheGrid(), LaunchOffTheGrid()}) {
    if (!ReasonNotApplicable(model, scene).empty()) continue;
    std::shared_ptr<Simulator> simulator = MakeSimulator(model, scene, Precision::kDouble);
    const std::vector<double> control = InitialControl(scene, simulator->num_steps());
    ASSERT_TRUE(simulator->Rollout(InitialState(scene), control));
    const StepCost cost(simulator);
    for (int k : InterestingSteps(*simulator)) {
      std::string error;
      EXPECT_TRUE(GradientsAgree(cost, BlocksAt(*simulator, control, k).Pointers(), width, &error))
          << scene.name << " step " << k << "\n"
          << error;
      touched = touched || k > 1;
    }
  }
  EXPECT_TRUE(touched);
}

// The free flight of a step of any length, as a cost of a phase: the model's own step, and its derivatives.
TEST_P(StepCostOf, HasItsFreeFlightOverAnyLength) {
  Scene scene;
  scene.name = "alone";
  scene.duration = 1;
  scene.steps = 480;
  scene.gravity = {0.3, -1.1};
  scene.bodies = {{.name = "disc", .radius = 0.2, .mass = 2, .position = {-2, -2}, .velocity = {0.7, -0.4}}};
  std::shared_ptr<Simulator> simulator = MakeSimulator(GetParam(), scene, Precision::kDouble);
  std::vector<double> x(simulator->state_size()), next(x.size());
  simulator->ExpandInitial(InitialState(scene), x);
  for (const bool pushed : {true, false}) {
    const std::vector<double> force = pushed ? std::vector{1.3, -0.6} : std::vector{0.0, 0.0};
    simulator->Step(x, force, next);
    if (pushed) scene.control = {{0}, {Vec2d::Zero()}};
    if (!pushed) scene.control = {};
    const HybridSystem system = SceneSystemOf(scene, SceneParameters::kNone, simulator.get());
    const MoveOfPart move(system.functions(), 0);
    const double length = simulator->step();
    std::vector<const double*> blocks{x.data(), &length};
    if (pushed) blocks.insert(blocks.begin() + 1, force.data());
    std::vector<double> after(4);
    ASSERT_TRUE(move.Evaluate(blocks.data(), after.data(), nullptr));
    for (int r = 0; r < 4; ++r) EXPECT_NEAR(after[r], next[r], 1e-12) << r;
    std::string error;
    EXPECT_TRUE(GradientsAgree(move, blocks, 1e-3, &error)) << error;
  }
}

std::vector<std::string> Models(bool published_jacobian) {
  std::vector<std::string> names;
  for (const ModelTraits& model : AllContactModels()) {
    if (model.published_jacobian == published_jacobian) names.emplace_back(model.name);
  }
  return names;
}

std::string NameOf(const testing::TestParamInfo<std::string>& info) { return info.param; }

INSTANTIATE_TEST_SUITE_P(Derived, StepCostOf, testing::ValuesIn(Models(false)), NameOf);

// A published Jacobian is that of the step in free flight. In contact it leaves out what its source leaves out (the
// convex models: that the normal of two discs turns; the LCP: see its header), so the check fails there.
class PublishedStepCostOf : public testing::TestWithParam<std::string> {};

TEST_P(PublishedStepCostOf, DiffersFromTheStepInContactOnly) {
  const Scene scene = FourDiscs(0);
  std::shared_ptr<Simulator> simulator = MakeSimulator(GetParam(), scene, Precision::kDouble);
  const std::vector<double> control = InitialControl(scene, simulator->num_steps());
  ASSERT_TRUE(simulator->Rollout(InitialState(scene), control));
  const StepCost cost(simulator);
  int differs = 0;
  for (int k : InterestingSteps(*simulator)) {
    std::string error;
    const bool agrees = GradientsAgree(cost, BlocksAt(*simulator, control, k).Pointers(), WidthFor(GetParam()), &error);
    EXPECT_TRUE(agrees || k > 1) << error;
    if (!agrees) ++differs;
  }
  EXPECT_GT(differs, 0);
}

INSTANTIATE_TEST_SUITE_P(Published, PublishedStepCostOf, testing::ValuesIn(Models(true)), NameOf);

// One entry of the Jacobian by x is off by a part in a thousand.
class WrongCost final : public ceres::CostFunction {
 public:
  explicit WrongCost(std::shared_ptr<const Simulator> simulator) : cost_(std::move(simulator)) {
    set_num_residuals(cost_.num_residuals());
    *mutable_parameter_block_sizes() = cost_.parameter_block_sizes();
  }
  bool Evaluate(double const* const* parameters, double* residuals, double** jacobians) const override {
    if (!cost_.Evaluate(parameters, residuals, jacobians)) return false;
    if (jacobians != nullptr && jacobians[0] != nullptr) jacobians[0][0] *= 1.001;
    return true;
  }

 private:
  StepCost cost_;
};

TEST(StepCost, TheCheckCanFail) {
  const Scene scene = FourDiscs(0);
  std::shared_ptr<Simulator> simulator = MakeSimulator("direct_toi", scene, Precision::kDouble);
  const std::vector<double> control = InitialControl(scene, simulator->num_steps());
  ASSERT_TRUE(simulator->Rollout(InitialState(scene), control));
  const Blocks blocks = BlocksAt(*simulator, control, 1);
  std::string error;
  EXPECT_TRUE(GradientsAgree(StepCost(simulator), blocks.Pointers(), WidthFor("direct_toi"), &error)) << error;
  EXPECT_FALSE(GradientsAgree(WrongCost(simulator), blocks.Pointers(), WidthFor("direct_toi"), &error));
}

TEST(StepCost, IsZeroAlongARollout) {
  const Scene scene = FourDiscs(0);
  std::shared_ptr<Simulator> simulator = MakeSimulator("direct_toi", scene, Precision::kDouble);
  const std::vector<double> control = InitialControl(scene, simulator->num_steps());
  ASSERT_TRUE(simulator->Rollout(InitialState(scene), control));
  const StepCost cost(simulator);
  std::vector<double> residuals(simulator->state_size());
  for (int k = 0; k < simulator->num_steps(); ++k) {
    Blocks blocks = BlocksAt(*simulator, control, k);
    simulator->GetState(k + 1, blocks.next);
    ASSERT_TRUE(cost.Evaluate(blocks.Pointers().data(), residuals.data(), nullptr));
    EXPECT_THAT(residuals, testing::Each(0.0)) << k;
  }
}

TEST(StepCost, HasOneBlockLessWithoutControl) {
  const StepCost pushed(MakeSimulator("direct", FourDiscs(0), Precision::kDouble));
  EXPECT_THAT(pushed.parameter_block_sizes(), ElementsAre(16, 4, 16));
  const StepCost free(MakeSimulator("direct", ProblemScene("ground_wall"), Precision::kDouble));
  EXPECT_THAT(free.parameter_block_sizes(), ElementsAre(4, 4));
}

TEST(StepCost, RefusesWhatIsNotFinite) {
  std::shared_ptr<Simulator> simulator = MakeSimulator("direct", ProblemScene("ground_wall"), Precision::kDouble);
  const Blocks blocks{{0, 1, std::nan(""), 0}, {}, {0, 0, 0, 0}};
  std::vector<double> residuals(4);
  EXPECT_FALSE(StepCost(simulator).Evaluate(blocks.Pointers().data(), residuals.data(), nullptr));
}

}  // namespace
}  // namespace saltus
