// The solver `auto` for scenes, and IPOPT on the transcription of discs.
#include <gmock/gmock.h>

#include <cmath>

#include "constrained_reference.h"
#include "saltus/solve/solver.h"
#include "solve/phases/interior_point.h"
#include "solve/solve_chain.h"
#include "test_scenes.h"

namespace saltus {
namespace {

using testing::HasSubstr;
using testing::StartsWith;

// A disc of mass 2 kg that is to be moved by 1 m within 2 s, from rest to rest, with forces on `steps` intervals.
Scene Moved(int steps) {
  Scene scene = ProblemScene("two_balls");
  scene.bodies.resize(1);
  scene.bodies[0].position = {0, 0};
  scene.bodies[0].velocity = {0, 0};
  scene.bodies[0].mass = 2;
  scene.duration = 2;
  scene.steps = steps;
  scene.control = {{0}, {{0.1, 0.2}}};
  scene.objective = {};
  scene.objective.effort = 0.3;
  TerminalTerm there{.body = 0, .quantity = TerminalTerm::Quantity::kPosition, .target = {1, 0}, .hard = true};
  TerminalTerm rest{.body = 0, .quantity = TerminalTerm::Quantity::kVelocity, .target = {0, 0}, .hard = true};
  scene.objective.terminal = {there, rest};
  return scene;
}

// Least sum of u^2 dt for which the sum of u (T - t) dt is m d and that of u dt is 0: (m d)^2 12 / (T^3 (1 - 1 / K^2)).
double LeastEffort(int steps) { return 0.3 * 4 * 12 / (8 * (1 - 1.0 / (steps * steps))); }

TEST(Automatic, TakesPhasesWithConstraintsAndSaysSo) {
  const SolveReport report = Solve("auto", {Moved(20), "event"}, {});
  ASSERT_EQ(report.termination, Termination::kConverged) << report.reason;
  EXPECT_EQ(report.solver, "ceres_phases");
  EXPECT_THAT(report.reason, StartsWith("auto used ceres_phases, as the scene has terminal equality constraints"));
  EXPECT_NEAR(report.solution.loss, LeastEffort(20), 1e-9);
  ASSERT_TRUE(report.certificate);
  EXPECT_TRUE(report.certificate->IsStationary()) << report.certificate->reason;
}

TEST(Automatic, FindsTheStrikeOfTwoBalls) {
  const SolveReport report = Solve("auto", {ProblemScene("two_balls"), "event"}, {});
  ASSERT_EQ(report.termination, Termination::kConverged) << report.reason;
  EXPECT_NEAR(report.solution.loss, 1.39654285, 5e-9);
}

// Without an impact the target stays where it is, and the loss is the square of its distance, 2.
TEST(Automatic, GoesOnFromAnOptimumThatHasLostTheContact) {
  const SolveRequest request{ProblemScene("two_balls"), "compliant_warp"};
  const SolveReport alone = Solve("ceres_lm", request, {});
  ASSERT_EQ(alone.termination, Termination::kConverged);
  EXPECT_NEAR(alone.solution.loss, 2, 1e-9);
  const SolveReport report = Solve("auto", request, {});
  EXPECT_EQ(report.termination, Termination::kConverged) << report.reason;
  EXPECT_NEAR(report.solution.loss, 1.3965, 5e-3);  // the optimum of exact contact, which the model approximates
  EXPECT_THAT(report.reason, HasSubstr("ceres_lm has converged, but no small change of its control changes a term"));
}

// Where the loss is least without a contact no other solver finds a lower one.
TEST(Automatic, ReturnsAnOptimumWithoutContactIfNoneIsLower) {
  Scene scene = ProblemScene("two_balls");
  scene.objective.effort = 10;  // a strike costs more than it gains
  const SolveReport report = Solve("auto", {scene, "event"}, {});
  EXPECT_EQ(report.termination, Termination::kConverged) << report.reason;
  EXPECT_NEAR(report.solution.loss, 2, 1e-9);
  EXPECT_THAT(report.reason, HasSubstr("has converged, but no small change"));
}

TEST(Automatic, ShootsUnderModelsAndFollowsASurrogateByDescent) {
  Scene scene = ProblemScene("two_balls");
  scene.steps = 48;
  const SolveReport model = Solve("auto", {scene, "direct_toi"}, {.limits = {.iterations = 20}});
  EXPECT_EQ(model.solver, "ceres_lm");
  const Surrogate zeroth{.kind = SurrogateKind::kSmoothedZeroth, .sigma = 0.01, .samples = 4};
  const SolveReport surrogate = Solve("auto", {scene, "event"}, {.limits = {.iterations = 1}, .surrogate = zeroth});
  EXPECT_EQ(surrogate.solver, "gd");
  EXPECT_THAT(surrogate.reason, HasSubstr("auto used gd, as a surrogate takes the place of the gradient"));
}

// A disc that lies on the floor has no phases: shooting goes on, and the iterations are those of all solves together.
TEST(Automatic, GoesOnWhereASolverDoesNotApply) {
  Scene scene = Moved(20);
  scene.gravity = {0, -10};
  scene.planes = {{.name = "floor", .point = {0, -scene.bodies[0].radius}, .normal = {0, 1}}};
  for (TerminalTerm& term : scene.objective.terminal) term.hard = false;
  const SolveReport report = Solve("auto", {scene, "event"}, {.limits = {.iterations = 30}});
  ASSERT_NE(report.termination, Termination::kNotApplicable) << report.reason;
  EXPECT_EQ(report.solver, "ceres_lm") << report.reason;
  EXPECT_THAT(report.reason, HasSubstr("ceres_phases does not apply: in the motion of the guess discs rest on"));
  EXPECT_LE(report.work.iterations, 30);
  EXPECT_EQ(report.history.losses.size(), static_cast<size_t>(report.work.iterations) + 1);
}

TEST(Automatic, SaysWhyNoSolverApplies) {
  Scene scene = Moved(20);
  scene.optimize = Optimize::kNone;
  const SolveReport report = Solve("auto", {scene, "event"}, {});
  EXPECT_EQ(report.termination, Termination::kNotApplicable);
  EXPECT_EQ(report.solver, "auto");
  EXPECT_THAT(report.reason, HasSubstr("leaves nothing to optimize"));
}

// The solvers that begin at the guess end without an optimum, as two of them here; the next one begins at the better
// end and, as it converges, is the last.
TEST(Automatic, RefinesTheBestEndWhereNoSolverHasConverged) {
  std::vector<std::string> starts;
  const auto solve = [&](std::string_view name, const SolverOptions&, const SolveReport* from) {
    starts.push_back(std::string(name) + (from == nullptr ? " from the guess" : " from " + from->solver));
    SolveReport report;
    report.solver = name;
    report.solution.loss = name == "far" ? 3 : name == "near" ? 2 : 1;
    report.history.losses = {5, report.solution.loss};
    report.solution.violation = 0;
    report.termination = name == "last" ? Termination::kConverged : Termination::kNoProgress;
    return report;
  };
  const SolveReport report = SolveInTurn({"near", "far"}, {"last", "never"}, "of a test", {}, solve);
  EXPECT_THAT(starts, testing::ElementsAre("near from the guess", "far from the guess", "last from near"));
  EXPECT_EQ(report.solver, "last");
  EXPECT_EQ(report.solution.loss, 1);
  EXPECT_EQ(report.work.iterations, 3) << "of all three solves";
  EXPECT_THAT(report.reason, HasSubstr("tried: near, then far, then last from the end of near"));
}

// An optimum whose loss is higher by far than that of a motion found before is not taken for it; one that is a little
// higher is.
TEST(Automatic, KeepsALossThatIsLowerByFar) {
  double optimum = 0;
  const auto solve = [&](std::string_view name, const SolverOptions&, const SolveReport*) {
    SolveReport report;
    report.solver = name;
    report.termination = name == "optimal" ? Termination::kConverged : Termination::kNoProgress;
    report.solution.loss = name == "optimal" ? optimum : 1;
    report.history.losses = {5, report.solution.loss};
    return report;
  };
  optimum = 1.5;
  const SolveReport far = SolveInTurn({"low", "optimal"}, {"low"}, "of a test", {}, solve);
  EXPECT_EQ(far.solver, "low");
  EXPECT_EQ(far.termination, Termination::kNoProgress);
  optimum = 1.001;
  const SolveReport near = SolveInTurn({"low", "optimal"}, {"low"}, "of a test", {}, solve);
  EXPECT_EQ(near.solver, "optimal");
  EXPECT_THAT(near.reason, HasSubstr("low ended at a lower loss"));
}

// Where a solve is interrupted, the best end of those before it is returned.
TEST(Automatic, KeepsTheBestEndWhenItIsInterrupted) {
  const auto solve = [&](std::string_view name, const SolverOptions&, const SolveReport*) {
    SolveReport report;
    report.solver = name;
    report.solution.loss = name == "first" ? 2 : 4;
    report.history.losses = {5, report.solution.loss};
    report.termination = name == "first" ? Termination::kNoProgress : Termination::kInterrupted;
    return report;
  };
  const SolveReport report = SolveInTurn({"first", "second"}, {"never"}, "of a test", {}, solve);
  EXPECT_EQ(report.solver, "first");
  EXPECT_EQ(report.solution.loss, 2);
  EXPECT_EQ(report.termination, Termination::kInterrupted);
}

TEST(InteriorPoint, FindsTheClosedFormOfAMovedDisc) {
  if (!HasInteriorPoint()) GTEST_SKIP() << "this build has no IPOPT";
  const SolveReport report = Solve("ipopt", {Moved(20), "event"}, {});
  ASSERT_EQ(report.termination, Termination::kConverged) << report.reason;
  EXPECT_EQ(report.solver, "ipopt");
  EXPECT_NEAR(report.solution.loss, LeastEffort(20), 1e-9);
  EXPECT_LE(report.solution.violation, kFeasible);
}

// With bounds, hard terms, running costs and a free final time, through an impact.
TEST(InteriorPoint, FindsTheConstrainedOptimaOfDiscs) {
  if (!HasInteriorPoint()) GTEST_SKIP() << "this build has no IPOPT";
  for (const Json& reference : References()) {
    SCOPED_TRACE(TestName(reference));
    const Scene scene = SceneOf(reference, 60);
    const SolveReport squares = Solve("ceres_phases", {scene, "event"}, FromGuess(scene));
    const SolveReport interior = Solve("ipopt", {scene, "event"}, {});
    if (squares.termination != Termination::kConverged) continue;
    ASSERT_EQ(interior.termination, Termination::kConverged) << interior.reason;
    EXPECT_NEAR(interior.solution.loss, squares.solution.loss, 1e-7 * squares.solution.loss);
    // A control on intervals is not better than the optimum in continuous time.
    EXPECT_GT(interior.solution.loss, reference["loss"].get<double>() - 1e-9);
  }
}

}  // namespace
}  // namespace saltus
