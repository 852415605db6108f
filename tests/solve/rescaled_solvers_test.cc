// Every solver takes the same way, and says the same, whatever the units of a scene and wherever its origin is.
#include <gmock/gmock.h>

#include <string>

#include "box_scene.h"
#include "rescaled_scene.h"
#include "saltus/simulate/registry.h"
#include "saltus/solve/solver.h"
#include "test_scenes.h"

namespace saltus {

void PrintTo(const Scene& scene, std::ostream* out) { *out << scene.name; }

namespace {

Scene TwoBalls() {
  Scene scene = ProblemScene("two_balls");
  scene.steps = 48;
  return scene;
}

// With gravity, planes, damping, three discs and friction; the velocity of one is free.
Scene Launch() {
  Scene scene = FourDiscs(0);
  scene.optimize = Optimize::kVelocity;
  scene.free = {0};
  return scene;
}

// Returns the unit of the decision variables.
double UnitOf(const Scene& scene, const Rescaling& by) {
  if (scene.optimize == Optimize::kControl) return by.force();
  return scene.optimize == Optimize::kVelocity ? by.speed() : by.length;
}

SolveReport SolveRescaled(std::string_view solver, const std::string& contact, const Scene& scene, const Rescaling& by,
                          double rate = 1) {
  SolverOptions options;
  options.limits.iterations = solver == "gd" ? 40 : solver == "ceres_phases" ? 1000 : 100;
  const double unit = UnitOf(scene, by);
  options.descent.learning_rate = rate * unit * unit / by.loss;
  options.keep_iterates = true;
  const Scene rescaled = Rescaled(scene, by);
  EXPECT_FALSE(Validate(rescaled)) << Validate(rescaled)->key << ": " << Validate(rescaled)->message;
  return Solve(solver, {rescaled, contact}, options);
}

// Checks that the results have the same bits.
void ExpectSame(const SolveReport& own, const SolveReport& rescaled, const Scene& scene, const Rescaling& by) {
  EXPECT_EQ(rescaled.termination, own.termination) << own.reason << " / " << rescaled.reason;
  EXPECT_EQ(rescaled.work.iterations, own.work.iterations);
  EXPECT_EQ(rescaled.work.evaluations, own.work.evaluations);
  EXPECT_EQ(rescaled.solution.loss, own.solution.loss * by.loss);
  ASSERT_EQ(rescaled.history.losses.size(), own.history.losses.size());
  for (size_t i = 0; i < own.history.losses.size(); ++i) {
    ASSERT_EQ(rescaled.history.losses[i], own.history.losses[i] * by.loss) << i;
  }
  ASSERT_EQ(rescaled.history.iterates.size(), own.history.iterates.size());
  for (size_t i = 0; i < own.history.iterates.size(); ++i) {
    for (size_t j = 0; j < own.history.iterates[i].size(); ++j) {
      ASSERT_EQ(rescaled.history.iterates[i][j], own.history.iterates[i][j] * UnitOf(scene, by)) << i << " " << j;
    }
  }
  ASSERT_EQ(rescaled.solution.control.size(), own.solution.control.size());
  for (size_t i = 0; i < own.solution.control.size(); ++i) {
    ASSERT_EQ(rescaled.solution.control[i], own.solution.control[i] * by.force()) << i;
  }
  ASSERT_EQ(rescaled.solution.initial_state.size(), own.solution.initial_state.size());
  for (size_t i = 0; i < own.solution.initial_state.size(); ++i) {
    ASSERT_EQ(rescaled.solution.initial_state[i], own.solution.initial_state[i] * (i % 4 < 2 ? by.length : by.speed()))
        << i;
  }
  ASSERT_EQ(rescaled.solution.durations.size(), own.solution.durations.size());
  for (size_t i = 0; i < own.solution.durations.size(); ++i) {
    ASSERT_EQ(rescaled.solution.durations[i], own.solution.durations[i] * by.time);
  }
  EXPECT_EQ(rescaled.history.defects, own.history.defects);
  ASSERT_EQ(rescaled.optima.size(), own.optima.size());
  for (size_t i = 0; i < own.optima.size(); ++i) {
    EXPECT_EQ(rescaled.optima[i].loss, own.optima[i].loss * by.loss);
    EXPECT_EQ(rescaled.optima[i].sequence, own.optima[i].sequence);
  }
  ASSERT_EQ(rescaled.certificate.has_value(), own.certificate.has_value());
  if (!own.certificate) return;
  EXPECT_EQ(rescaled.certificate->verdict, own.certificate->verdict);
  EXPECT_EQ(rescaled.certificate->hamiltonian, own.certificate->hamiltonian);
  ASSERT_EQ(rescaled.certificate->impacts.size(), own.certificate->impacts.size());
  for (size_t i = 0; i < own.certificate->impacts.size(); ++i) {
    const ImpactCertificate &a = own.certificate->impacts[i], &b = rescaled.certificate->impacts[i];
    EXPECT_EQ(b.time, a.time * by.time);
    EXPECT_EQ(b.speed, a.speed * by.speed());
    EXPECT_EQ(b.multiplier, a.multiplier * by.loss / by.length);
  }
}

std::string NameOf(const testing::TestParamInfo<std::string>& info) { return info.param; }

std::vector<std::string> Solvers() {
  std::vector<std::string> names;
  for (const SolverEntry& solver : AllSolvers()) names.emplace_back(solver.name);
  return names;
}

class EverySolver : public testing::TestWithParam<std::string> {};

TEST_P(EverySolver, TakesTheSameStepsInAnyUnits) {
  const Scene scene = TwoBalls();
  const SolveReport own = SolveRescaled(GetParam(), "event", scene, {});
  ASSERT_NE(own.termination, Termination::kNotApplicable) << own.reason;
  ASSERT_GT(own.work.iterations, 0);
  std::vector<Rescaling> all = UnitRescalings();
  for (const Rescaling& by : LossRescalings()) all.push_back(by);
  for (const Rescaling& by : all) {
    SCOPED_TRACE(by.name);
    ExpectSame(own, SolveRescaled(GetParam(), "event", scene, by), scene, by);
  }
}

TEST_P(EverySolver, TakesTheSameStepsFarFromTheOrigin) {
  const Scene scene = TwoBalls();
  const SolveReport own = SolveRescaled(GetParam(), "event", scene, {});
  // A million radii, and some that are a multiple of the natural length: then no bit is lost.
  const SolveReport exact = SolveRescaled(GetParam(), "event", scene, {.name = "", .shift = {Power(18), -Power(19)}});
  EXPECT_EQ(exact.termination, own.termination) << own.reason << " / " << exact.reason;
  EXPECT_EQ(exact.history.losses, own.history.losses);
  EXPECT_EQ(exact.solution.control, own.solution.control);
  const SolveReport near = SolveRescaled(GetParam(), "event", scene, {.name = "", .shift = {2e5, -3e5}});
  EXPECT_EQ(near.termination, own.termination) << own.reason << " / " << near.reason;
  EXPECT_NEAR(near.solution.loss, own.solution.loss, 1e-6 * own.solution.loss);
  ASSERT_FALSE(near.history.losses.empty());
  EXPECT_NEAR(near.history.losses[0], own.history.losses[0], 1e-14 * own.history.losses[0]);
  const size_t first = std::min<size_t>({4, near.history.losses.size(), own.history.losses.size()});
  for (size_t i = 0; i < first; ++i) {
    EXPECT_NEAR(near.history.losses[i], own.history.losses[i], 1e-9 * own.history.losses[0]) << i;
  }
}

INSTANTIATE_TEST_SUITE_P(Solvers, EverySolver, testing::ValuesIn(Solvers()), NameOf);

// Returns scenes that only ceres_phases can solve.
std::vector<Scene> Constrained() {
  Scene bounds = TwoBalls();
  bounds.name = "bounds";
  bounds.control.max = {3.2};
  bounds.objective.running = {{.body = 0, .times = {0, 1}, .targets = {{-2, -2}, {-1, -1}}, .weight = 0.3}};
  Scene hard = TwoBalls();
  hard.name = "hard";
  hard.objective.terminal[0].hard = true;
  hard.control.max_norm = {8};
  hard.objective.duration = FreeDuration{0.2, 5, 0.5};
  Scene out_of_reach = TwoBalls();
  out_of_reach.name = "out_of_reach";
  out_of_reach.objective.terminal[0].hard = true;
  out_of_reach.control.max = {3};
  Scene via = TwoBalls();
  via.name = "via";
  via.objective.via = {{.body = 0, .time = 0.25, .target = {-1.9, -1.85}, .hard = true}};
  via.bodies.push_back({.name = "post", .radius = 0.1, .fixed = true, .position = {-1.4, -1.7}});
  via.no_contact = {{0, 2, false}};
  return {bounds, hard, out_of_reach, via};
}

class ByPhases : public testing::TestWithParam<Scene> {};

TEST_P(ByPhases, TheSameStepsAndVerdictsInAnyUnits) {
  const Scene& scene = GetParam();
  const SolveReport own = SolveRescaled("ceres_phases", "event", scene, {});
  EXPECT_EQ(own.termination == Termination::kConverged, scene.name != "out_of_reach") << own.reason;
  ASSERT_GT(own.work.iterations, 0);
  std::vector<Rescaling> all = UnitRescalings();
  for (const Rescaling& by : LossRescalings()) all.push_back(by);
  for (const Rescaling& by : all) {
    SCOPED_TRACE(by.name);
    ExpectSame(own, SolveRescaled("ceres_phases", "event", scene, by), scene, by);
  }
}

std::vector<Scene> PhaseScenes() {
  std::vector<Scene> scenes = Constrained();
  scenes.push_back(BallInBox(1, 100));
  return scenes;
}

INSTANTIATE_TEST_SUITE_P(Scenes, ByPhases, testing::ValuesIn(PhaseScenes()),
                         [](const auto& at) { return at.param.name; });

// Solvers that take any contact model.
std::vector<std::string> ShootingSolvers() {
  std::vector<std::string> names;
  for (const SolverEntry& solver : AllSolvers()) {
    if (!solver.exact_only) names.emplace_back(solver.name);
  }
  return names;
}

class EveryModel : public testing::TestWithParam<std::string> {};

// Whatever constants a model has, none of them is of the loss.
TEST_P(EveryModel, SolversTakeTheSameStepsForAnyUnitOfTheLoss) {
  const Scene scene = Launch();
  if (!ReasonNotApplicable(GetParam(), scene).empty()) GTEST_SKIP() << ReasonNotApplicable(GetParam(), scene);
  for (const std::string solver : {"gd", "ceres_lm", "ceres_lbfgs"}) {
    const SolveReport own = SolveRescaled(solver, GetParam(), scene, {}, 0.01);
    for (const Rescaling& by : LossRescalings()) {
      SCOPED_TRACE(solver + " " + by.name);
      ExpectSame(own, SolveRescaled(solver, GetParam(), scene, by, 0.01), scene, by);
    }
  }
}

std::vector<std::string> Models() {
  std::vector<std::string> names;
  for (const ModelTraits& model : AllContactModels()) names.emplace_back(model.name);
  return names;
}
INSTANTIATE_TEST_SUITE_P(Models, EveryModel, testing::ValuesIn(Models()), NameOf);

// Models whose step has no constant with a unit.
class ModelWithoutUnits : public testing::TestWithParam<std::string> {};

TEST_P(ModelWithoutUnits, SolversTakeTheSameStepsInAnyUnits) {
  for (const Scene& scene : {TwoBalls(), Launch()}) {
    for (const std::string& solver : ShootingSolvers()) {
      if (solver == "ceres_lagrangian" || solver == "ceres_shooting") continue;  // take long, and are above
      const double rate = scene.optimize == Optimize::kControl ? 1 : 0.01;
      const SolveReport own = SolveRescaled(solver, GetParam(), scene, {}, rate);
      for (const Rescaling& by : UnitRescalings()) {
        SCOPED_TRACE(scene.name + " " + solver + " " + by.name);
        ExpectSame(own, SolveRescaled(solver, GetParam(), scene, by, rate), scene, by);
      }
    }
  }
}

INSTANTIATE_TEST_SUITE_P(Models, ModelWithoutUnits, testing::Values("event", "direct", "convex"), NameOf);

// A loss that was small by its unit once met the tolerances of Ceres at the start.
TEST(Rescaled, ASmallLossIsNotASolvedProblem) {
  Scene scene = ProblemScene("two_balls");
  for (TerminalTerm& term : scene.objective.terminal) term.weight *= 1e-8;
  scene.objective.effort *= 1e-8;
  for (const std::string solver : {"ceres_lm", "ceres_lbfgs", "ceres_shooting"}) {
    const SolveReport report = Solve(solver, {scene, "event"}, {});
    EXPECT_LT(report.solution.loss, 1.3996e-8) << solver;
    EXPECT_GT(report.work.iterations, 5) << solver;
  }
}

TEST(Rescaled, RemarksAreOurs) {
  for (const SolverEntry& solver : AllSolvers()) {
    const SolveReport report = SolveRescaled(solver.name, "event", TwoBalls(), {});
    EXPECT_THAT(report.reason, testing::Not(testing::ContainsRegex("[Tt]olerance|[Tt]erminat|trust region|Maximum")))
        << solver.name;
  }
}

}  // namespace
}  // namespace saltus
