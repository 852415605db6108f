// A search ends by a count of work, so that its answer does not depend on the machine, its load or the threads.
#include <gmock/gmock.h>

#include <algorithm>
#include <cmath>

#include "constrained_reference.h"
#include "saltus/solve/solver.h"
#include "scene/control_problems.h"
#include "searched_scenes.h"
#include "test_scenes.h"

namespace saltus {
namespace {

using testing::HasSubstr;

SolverOptions Limited(double work, int threads) {
  SolverOptions options;
  options.sequences.limits.work = work;
  options.sequences.limits.seconds = 0;
  options.threads = threads;
  return options;
}

void ExpectSame(const SolveReport& one, const SolveReport& other, const std::string& what) {
  EXPECT_EQ(one.termination, other.termination) << what;
  EXPECT_EQ(one.reason, other.reason) << what;
  EXPECT_EQ(one.solution.loss, other.solution.loss) << what;
  EXPECT_EQ(one.history.losses, other.history.losses) << what;
  EXPECT_EQ(one.solution.control, other.solution.control) << what;
  EXPECT_EQ(one.work.evaluations, other.work.evaluations) << what;
  ASSERT_EQ(one.optima.size(), other.optima.size()) << what;
  for (size_t i = 0; i < one.optima.size(); ++i) EXPECT_EQ(one.optima[i].loss, other.optima[i].loss) << what;
}

// Scenes of both kinds of search, at limits that cut it early and late.
TEST(SearchWork, TheAnswerIsTheSameForAnyNumberOfThreads) {
  Scene crowd = ControlProblem(122);
  crowd.steps = 60;
  const Scene scenes[] = {crowd, ProblemScene("multiple_collisions"), SceneOf(Reference("running"), 60)};
  for (const Scene& scene : scenes) {
    for (const double work : {1.0, 3e3, 1e4}) {
      const SolveReport one = Solve("mode_search", {scene, "event"}, Limited(work, 1));
      EXPECT_THAT(one.reason, HasSubstr("the limit of work")) << scene.name << " " << work;
      ASSERT_TRUE(one.searched);
      EXPECT_FALSE(one.searched->complete);
      for (const int threads : {1, 2, 5}) {
        const SolveReport other = Solve("mode_search", {scene, "event"}, Limited(work, threads));
        ExpectSame(one, other, scene.name + " " + std::to_string(work) + " on " + std::to_string(threads));
      }
    }
  }
}

TEST(SearchWork, MoreWorkIsNoWorseAndWithoutALimitNoneIsNamed) {
  const Scene scene = ProblemScene("multiple_collisions");
  double last = HUGE_VAL;
  for (const double work : {1e3, 1e4, 1e5}) {
    const SolveReport report = Solve("mode_search", {scene, "event"}, Limited(work, 2));
    EXPECT_LE(report.solution.loss, last * (1 + 1e-9));
    last = report.solution.loss;
  }
  const SolveReport whole = Solve("mode_search", {scene, "event"}, Limited(0, 2));
  EXPECT_LE(whole.solution.loss, last * (1 + 1e-9));
  EXPECT_THAT(whole.reason, testing::Not(HasSubstr("limit of work")));
}

// A ball that bounces 37 times in a box: arcs leave its optimum off the condition of the Hamiltonian, and a solve that
// ends nearer by, with the same loss, does not. Each solve takes long, and the search ends by itself, as it has found
// no improvement in most of its work.
TEST(SearchWork, TheBestOptimumMeetsItsConditionsWhereSolvesTakeLong) {
  Scene scene;
  scene.name = "box_37_bounces";
  scene.duration = 4;
  scene.steps = 2000;
  scene.bodies = {{.name = "ball", .radius = 0.1, .position = {0.2, 0.3}, .velocity = {4.5, 2.7}}};
  scene.planes = {{"left", {-0.5, 0}, {1, 0}},
                  {"right", {0.5, 0}, {-1, 0}},
                  {"floor", {0, -0.5}, {0, 1}},
                  {"roof", {0, 0.5}, {0, -1}}};
  scene.contact.restitution = 1;
  scene.control = {{0}, {{0, 0}}};
  scene.objective.terminal = {{.body = 0, .target = {0.1, -0.2}}};
  scene.objective.effort = 1e-3;
  scene.optimize = Optimize::kControl;
  const SolveReport report = Solve("mode_search", {scene, "event"}, Limited(0, 2));
  EXPECT_THAT(report.reason, HasSubstr("no improvement in most of the work"));
  ASSERT_TRUE(report.searched);
  EXPECT_FALSE(report.searched->complete);
  EXPECT_LT(report.searched->work, 0.5 * SearchOptions().work);
  EXPECT_EQ(report.termination, Termination::kConverged) << report.reason;
  ASSERT_TRUE(report.certificate);
  EXPECT_EQ(report.certificate->verdict, Certificate::Verdict::kStationary) << report.certificate->reason;
  EXPECT_NEAR(report.solution.loss, 9.374561153842e-07, 9e-16);  // of ceres_phases, which finds it too, to 1e-9
}

// A long solve is cut as well: one limit of iterations alone would let it go on.
TEST(SearchWork, NoSolveTakesMoreThanWhatWasLeftWhenItWasDrawn) {
  const Scene scene = ProblemScene("two_balls");
  SolverOptions options = Limited(5000, 1);
  options.limits.iterations = 100000;  // of gd too, which never stops by itself
  options.descent.learning_rate = 1e-6;
  const SolveReport report = Solve("mode_search", {scene, "event"}, options);
  EXPECT_LT(report.work.evaluations, 10000);
  ASSERT_TRUE(report.searched);
  EXPECT_LT(report.searched->work, 10 * 5000);
  EXPECT_THAT(report.reason, HasSubstr("the limit of work"));
}

TEST(SearchWork, ImpossibleLimitsAreRefusedByName) {
  for (const double wrong : {-1.0, HUGE_VAL, std::nan("")}) {
    const SolveReport report = Solve("mode_search", {ProblemScene("two_balls"), "event"}, Limited(wrong, 1));
    EXPECT_EQ(report.termination, Termination::kNotApplicable);
    EXPECT_THAT(report.reason, HasSubstr("search_work"));
  }
}

// The count of searched sequences includes those that solves have ended with.
TEST(SearchWords, NoFewerSequencesThanOptimaAlongDifferentOnes) {
  const Scene scene = SceneOf(Reference("running"), 60);
  const SolveReport report = Solve("mode_search", {scene, "event"}, Counted(12, 3));
  ASSERT_TRUE(report.searched);
  std::vector<ContactSequence> along;
  for (const LocalOptimum& optimum : report.optima) {
    if (std::find(along.begin(), along.end(), optimum.sequence) == along.end()) along.push_back(optimum.sequence);
  }
  ASSERT_FALSE(along.empty());
  EXPECT_GE(report.searched->sequences, static_cast<int>(along.size()));
  ASSERT_TRUE(report.certificate);
  EXPECT_EQ(report.certificate->sequences_searched, report.searched->sequences);
}

TEST(SearchWords, OneOptimumIsNotTheBestOfSeveral) {
  SolverOptions options = Counted();
  options.sequences.search = false;
  const SolveReport report = Solve("mode_search", {ProblemScene("two_balls"), "event"}, options);
  ASSERT_EQ(report.optima.size(), 1u);
  EXPECT_THAT(report.reason, HasSubstr("the only optimum found"));
}

}  // namespace
}  // namespace saltus
