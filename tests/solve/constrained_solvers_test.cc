// Optima with bounds, hard terms, running costs and a free final time by every solver that takes them.
#include <gmock/gmock.h>

#include <algorithm>
#include <cmath>

#include "constrained_reference.h"
#include "saltus/simulate/exact_run.h"
#include "saltus/solve/solver.h"
#include "scene/units.h"
#include "solve/hmp.h"

namespace saltus {
namespace {

using testing::HasSubstr;

SolveReport SolveBy(const char* solver, const Scene& scene, int iterations = 1000) {
  SolverOptions options;
  options.limits.iterations = iterations;
  options.descent.learning_rate = 10.0 / 480;
  options.descent.rate_per_time = true;
  return Solve(solver, {scene, "event"}, options);
}

double LargestExcess(const Scene& scene, const SolveReport& report) {
  double excess = 0;
  for (size_t k = 0; k < report.solution.control.size(); k += 2) {
    const Vec2d u(report.solution.control[k], report.solution.control[k + 1]);
    if (!scene.control.max.empty()) excess = std::max(excess, u.cwiseAbs().maxCoeff() / scene.control.max[0] - 1);
    if (!scene.control.max_norm.empty()) excess = std::max(excess, u.norm() / scene.control.max_norm[0] - 1);
  }
  return excess;
}

// ---------------------------------------------------------------------------------------------------------------------
// The minimum principle in continuous time.

class ConstrainedHmp : public testing::TestWithParam<Json> {};

TEST_P(ConstrainedHmp, FindsTheOptimumInContinuousTimeWhateverTheGrid) {
  const Json& reference = GetParam();
  for (int steps : {60, 240}) {
    const Scene scene = SceneOf(reference, steps);
    const SolveReport report = SolveBy("hmp", scene);
    if (scene.objective.effort == 0) {
      EXPECT_EQ(report.termination, Termination::kNotApplicable);
      EXPECT_THAT(report.reason, HasSubstr("without a cost of effort"));
      return;
    }
    ASSERT_EQ(report.termination, Termination::kConverged) << report.reason;
    EXPECT_NEAR(report.solution.loss, reference["loss"].get<double>(), 1e-11) << steps;
    ASSERT_TRUE(report.certificate);
    EXPECT_TRUE(report.certificate->IsStationary()) << report.certificate->reason;
    ASSERT_TRUE(report.continuous);
    const Certificate& certificate = *report.continuous;
    EXPECT_EQ(certificate.verdict, Certificate::Verdict::kStationary) << certificate.reason;
    ASSERT_EQ(certificate.impacts.size(), 1u);
    EXPECT_NEAR(certificate.impacts[0].time, reference["impact_time"].get<double>(), 1e-11);
    if (reference["name"] == "hard_target") {
      EXPECT_NEAR(certificate.constraints[0].multiplier[0], -1.2626901100608278905, 1e-10);
      EXPECT_NEAR(certificate.constraints[0].multiplier[1], -1.2626901100608278905, 1e-10);
    }
    // The control that it hands back is one on the grid, and no better than possible.
    const ExactRun exact =
        SimulateExactly(scene, report.solution.initial_state, report.solution.control, report.solution.durations);
    ASSERT_TRUE(exact.ok) << exact.reason;
    EXPECT_GT(exact.loss, report.solution.loss - 1e-9);
    EXPECT_LT(exact.loss, report.solution.loss + 0.3 / (steps * steps));
  }
}

TEST_P(ConstrainedHmp, HasTheAnalyticForces) {
  const Json& reference = GetParam();
  if (!reference.contains("force_unbounded")) return;
  Scene scene = SceneOf(reference, 120);
  const SolveReport start = Solve("ceres_phases", {scene, "event"}, FromGuess(scene));
  const auto optimum = FindContinuousOptimum(scene, start, 100);
  ASSERT_TRUE(optimum);
  const double impact = reference["impact_time"];
  const Vec2d from = VectorOf(reference["force_unbounded"][0]), to = VectorOf(reference["force_unbounded"][1]);
  for (double t = 0; t < impact; t += 0.05) {
    Vec2d u = from + t / impact * (to - from);
    if (!scene.control.max.empty()) u = u.cwiseMin(scene.control.max[0]);
    if (!scene.control.max_norm.empty()) u *= std::min(1.0, scene.control.max_norm[0] / u.norm());
    const Vec2d found = optimum->shooting.ForceAt(optimum->legs, 0, t);
    EXPECT_NEAR(found[0], u[0], 1e-8) << t;
    EXPECT_NEAR(found[1], u[1], 1e-8) << t;
  }
}

INSTANTIATE_TEST_SUITE_P(All, ConstrainedHmp, testing::ValuesIn(References()),
                         [](const auto& test) { return TestName(test.param); });

TEST(ConstrainedHmp, SaysWhatItCannotTake) {
  Scene scene = SceneOf(Reference("running"), 60);
  scene.control.max = {3.5};
  const SolveReport report = SolveBy("hmp", scene);
  EXPECT_EQ(report.termination, Termination::kNotApplicable);
  EXPECT_THAT(report.reason, HasSubstr("running costs of a disc with a bounded force are not supported"));
  Scene apart = SceneOf(Reference("running"), 60);
  apart.no_contact = {{.a = 0, .b = 1}};
  EXPECT_THAT(SolveBy("hmp", apart).reason, HasSubstr("pairs that must not touch (no_contact) are not supported"));
}

// Two impacts, and a bound that holds at first.
TEST(ConstrainedHmp, TakesSeveralImpacts) {
  Scene scene = ProblemScene("multiple_collisions");
  scene.steps = 160;
  SolverOptions options;
  ASSERT_EQ(ParseContactSequence(scene, "striker-target,target-ceiling", &options.sequences.given.emplace()), "");
  const SolveReport free = Solve("hmp", {scene, "event"}, options);
  ASSERT_EQ(free.termination, Termination::kConverged) << free.reason;
  double largest = 0;
  for (double u : free.solution.control) largest = std::max(largest, std::abs(u));
  // A bound that does not hold changes nothing.
  scene.control.max = {1.5 * largest};
  const SolveReport loose = Solve("hmp", {scene, "event"}, options);
  ASSERT_EQ(loose.termination, Termination::kConverged) << loose.reason;
  EXPECT_NEAR(loose.solution.loss, free.solution.loss, 1e-11 * free.solution.loss);
  ASSERT_EQ(loose.continuous->impacts.size(), 2u);
  for (int k = 0; k < 2; ++k) {
    const ImpactCertificate &a = loose.continuous->impacts[k], &b = free.continuous->impacts[k];
    EXPECT_NEAR(a.multiplier, b.multiplier, 1e-8 * std::abs(b.multiplier));
  }
  scene.control.max = {0.8 * largest};
  const SolveReport bound = Solve("hmp", {scene, "event"}, options);
  ASSERT_EQ(bound.termination, Termination::kConverged) << bound.reason;
  EXPECT_GT(bound.solution.loss, free.solution.loss * (1 + 1e-6));
  EXPECT_LE(LargestExcess(scene, bound), 1e-12);
  EXPECT_TRUE(
      Certify(scene, bound.solution.initial_state, bound.solution.control, bound.solution.durations).IsStationary());
}

// Via terms, soft and hard: the optimum in continuous time is what finer grids tend to, with second order.
TEST(ConstrainedHmp, TakesViaTerms) {
  for (bool hard : {false, true}) {
    Scene scene = ProblemScene("two_balls");
    scene.objective.via = {{.body = 0, .time = 0.4, .target = {-1.6, -1.7}, .weight = 10, .hard = hard}};
    std::vector<double> gaps;
    double optimum = 0;
    for (int steps : {60, 240}) {
      scene.steps = steps;
      const SolveReport direct = Solve("ceres_phases", {scene, "event"}, {});
      ASSERT_EQ(direct.termination, Termination::kConverged) << direct.reason;
      const SolveReport indirect = SolveBy("hmp", scene);
      ASSERT_EQ(indirect.termination, Termination::kConverged) << indirect.reason;
      if (!gaps.empty()) {
        EXPECT_NEAR(indirect.solution.loss, optimum, 1e-11);
      }
      optimum = indirect.solution.loss;
      gaps.push_back(direct.solution.loss - optimum);
      EXPECT_GT(gaps.back(), 0);
    }
    EXPECT_NEAR(std::log(gaps[0] / gaps[1]) / std::log(4.0), 2, 0.2) << hard;
  }
}

// ---------------------------------------------------------------------------------------------------------------------
// Single shooting, on a grid that does not move: never better than the optimum, and near it.

struct Shot {
  const char* solver;
  const char* reference;
  int iterations;
  double most;  // above the optimum
};

class ConstrainedShooting : public testing::TestWithParam<Shot> {};

TEST_P(ConstrainedShooting, EndsNearTheOptimumWithinItsBounds) {
  const Shot& shot = GetParam();
  const Json reference = Reference(shot.reference);
  const Scene scene = SceneOf(reference, 60);
  const SolveReport report = SolveBy(shot.solver, scene, shot.iterations);
  ASSERT_FALSE(report.history.losses.empty()) << report.reason;
  EXPECT_LE(LargestExcess(scene, report), 1e-12);
  const ExactRun exact =
      SimulateExactly(scene, report.solution.initial_state, report.solution.control, report.solution.durations);
  ASSERT_TRUE(exact.ok) << exact.reason;
  EXPECT_NEAR(exact.loss, report.solution.loss, 1e-9);
  const double gap = exact.loss - reference["loss"].get<double>();
  EXPECT_GT(gap, 0);
  EXPECT_LT(gap, shot.most);
}

INSTANTIATE_TEST_SUITE_P(
    All, ConstrainedShooting,
    testing::Values(Shot{"gd", "max_3.5", 2000, 5e-3}, Shot{"gd", "off_diagonal_norm_4", 2000, 2e-2},
                    Shot{"gd", "running", 2000, 5e-3}, Shot{"gd", "free_time", 4000, 2e-2},
                    Shot{"ceres_lm", "max_3.5", 200, 5e-3}, Shot{"ceres_lm", "max_3.2", 200, 5e-3},
                    Shot{"ceres_lm", "running", 200, 5e-3}, Shot{"ceres_lm", "free_time", 200, 5e-3},
                    Shot{"ceres_lbfgs", "running", 200, 5e-3}, Shot{"ceres_lbfgs", "free_time", 200, 1e-2}),
    [](const auto& test) {
      std::string name = std::string(test.param.solver) + "_" + test.param.reference;
      std::replace(name.begin(), name.end(), '.', '_');
      return name;
    });

// Without a collision in the way there is no kink, and they find the very optimum of the grid.
TEST(ConstrainedShooting, SolvesATrackingProblemWithBounds) {
  Scene scene = ProblemScene("two_balls");
  scene.steps = 40;
  scene.bodies[1].position = {3, 3};  // out of the way
  scene.objective.terminal = {{.body = 0, .target = {-1.5, -2.5}, .weight = 3}};
  scene.objective.running = {
      {.body = 0, .times = {0, 0.5, 1}, .targets = {{-2, -2}, {-1.6, -1.9}, {-1.5, -2.4}}, .weight = 5}};
  scene.objective.via = {{.body = 0, .time = 0.5, .target = {-1.6, -1.95}, .weight = 4}};
  scene.control.max = {2.5};
  scene.objective.effort = 0.02;
  const SolveReport direct = Solve("ceres_phases", {scene, "event"}, {});
  ASSERT_EQ(direct.termination, Termination::kConverged) << direct.reason;
  const SolveReport gd = SolveBy("gd", scene, 20000);
  EXPECT_NEAR(gd.solution.loss, direct.solution.loss, 1e-8 * direct.solution.loss);
  const Certificate certificate = Certify(scene, gd.solution.initial_state, gd.solution.control);
  EXPECT_TRUE(certificate.IsStationary()) << certificate.reason;
  EXPECT_GT(std::count_if(
                gd.solution.control.begin(), gd.solution.control.end(), [](double u) { return std::abs(u) > 2.49999; }),
            3);
  // Projected steps of Ceres may end early, and then say so.
  const SolveReport lm = SolveBy("ceres_lm", scene, 300);
  EXPECT_NEAR(lm.solution.loss, direct.solution.loss, 1e-2 * direct.solution.loss);
  EXPECT_GT(lm.solution.loss, direct.solution.loss - 1e-9);
}

TEST(ConstrainedShooting, TakesRunningTermsUnderOtherModelsByTheirOwnSteps) {
  const Json reference = Reference("running");
  const Scene scene = SceneOf(reference, 240);
  for (const char* solver : {"ceres_lbfgs", "ceres_lm"}) {
    SolverOptions options;
    options.limits.iterations = solver == std::string("ceres_lm") ? 10 : 100;
    const SolveReport report = Solve(solver, {scene, "toi_velocity"}, options);
    ASSERT_FALSE(report.history.losses.empty()) << report.reason;
    EXPECT_LT(report.solution.loss, report.guess.loss);
    EXPECT_NEAR(report.solution.loss, reference["loss"].get<double>(), 0.02) << solver;
  }
}

TEST(ConstrainedSolvers, GiveTheSameInOtherUnits) {
  const Units units{.length = 0x1p-10, .time = 0x1p5, .mass = 0x1p5, .loss = 0x1p-20};
  for (const char* name : {"max_3.5", "hard_target", "free_time", "running"}) {
    for (const char* solver : {"ceres_lbfgs", "ceres_lm", "ceres_phases", "hmp"}) {
      const Scene scene = SceneOf(Reference(name), 60);
      Scene rescaled = ToUnits(scene, units);
      rescaled.units = {};
      SolverOptions options;
      options.limits.iterations = 50;
      const SolveReport one = Solve(solver, {scene, "event"}, options);
      const SolveReport other = Solve(solver, {rescaled, "event"}, options);
      EXPECT_EQ(one.termination, other.termination) << name << " " << solver;
      EXPECT_EQ(one.work.iterations, other.work.iterations) << name << " " << solver;
      EXPECT_EQ(one.solution.loss, other.solution.loss * units.loss) << name << " " << solver;
    }
  }
}

TEST(ConstrainedShooting, RefusesAFreeDurationWhereStepsHaveNoDerivativeByTheirLength) {
  const SolveReport report = Solve("gd", {SceneOf(Reference("free_time"), 60), "direct_toi"}, {});
  EXPECT_EQ(report.termination, Termination::kNotApplicable);
  EXPECT_THAT(report.reason, HasSubstr("by their length"));
}

// Few intervals, and a running target whose rate jumps within one: the solution is polished, and keeps the hard term.
TEST(Constrained, PolishingKeepsHardTerms) {
  Scene scene = ProblemScene("two_balls");
  scene.steps = 12;
  scene.objective.terminal[0].target = {0, 0.1};
  scene.objective.terminal[0].hard = true;
  scene.objective.effort = 0.01;
  scene.objective.running = {{.body = 0,
                              .quantity = TerminalTerm::Quantity::kVelocity,
                              .times = {0, 0.3},
                              .targets = {{-2, -2}, {-1.5, -1.4}},
                              .weight = 0.2}};
  for (const char* solver : {"ceres_phases", "ipopt"}) {
    const SolveReport report = Solve(solver, {scene, "event"}, FromGuess(scene));
    if (report.termination == Termination::kNotApplicable) continue;  // this build has no IPOPT
    EXPECT_EQ(report.termination, Termination::kConverged) << report.reason;
    const ExactRun exact =
        SimulateExactly(scene, report.solution.initial_state, report.solution.control, report.solution.durations);
    EXPECT_NEAR(exact.end[4], 0, 1e-8) << solver;
    EXPECT_NEAR(exact.end[5], 0.1, 1e-8) << solver;
  }
}

}  // namespace
}  // namespace saltus
