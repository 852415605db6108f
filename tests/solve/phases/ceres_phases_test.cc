// Ceres through collisions with a cost for every step, against optima in continuous time with bounds, hard constraints,
// free time and running costs; and what its sequences are mended to.
#include <gmock/gmock.h>

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <numeric>
#include <span>

#include "constrained_reference.h"
#include "parameter_name.h"
#include "saltus/optimality/certificate.h"
#include "saltus/simulate/exact_run.h"
#include "saltus/simulate/registry.h"
#include "saltus/solve/solver.h"
#include "scene/control_problems.h"
#include "test_scenes.h"

namespace saltus {
namespace {

using testing::HasSubstr;
using Vec4d = Eigen::Vector4d;

class ConstrainedOptimum : public testing::TestWithParam<Json> {};

// In two references the target is better left alone.
TEST_P(ConstrainedOptimum, IsReachedFromThePapersGuess) {
  const Json& reference = GetParam();
  const Scene scene = SceneOf(reference, 480);
  const SolveReport report = Solve("ceres_phases", {scene, "event"}, FromGuess(scene));
  ASSERT_EQ(report.termination, Termination::kConverged) << report.reason;
  const double optimum = reference["loss"];
  EXPECT_GT(report.solution.loss, optimum - 1e-9) << "below the optimum in continuous time";
  EXPECT_LT(report.solution.loss, optimum + 3e-6);
  if (reference.contains("loss_480")) {
    EXPECT_NEAR(report.solution.loss, reference["loss_480"].get<double>(), 1e-9);
  }

  const ExactRun exact =
      SimulateExactly(scene, report.solution.initial_state, report.solution.control, report.solution.durations);
  ASSERT_TRUE(exact.ok) << exact.reason;
  EXPECT_DOUBLE_EQ(exact.loss, report.solution.loss);
  ASSERT_EQ(exact.events.size(), 1u);
  EXPECT_NEAR(exact.events[0].time, reference["impact_time"].get<double>(), 2e-5);
  if (reference.contains("duration_found")) {
    const double duration = std::accumulate(report.solution.durations.begin(), report.solution.durations.end(), 0.0);
    EXPECT_NEAR(duration, reference["duration_found"].get<double>(), 2e-5);
  }
}

TEST_P(ConstrainedOptimum, KeepsBoundsAndConstraintsOnTheExactRollOut) {
  const Json& reference = GetParam();
  const Scene scene = SceneOf(reference, 240);
  const SolveReport report = Solve("ceres_phases", {scene, "event"}, {});
  ASSERT_EQ(report.termination, Termination::kConverged) << report.reason;
  for (size_t k = 0; k < report.solution.control.size(); k += 2) {
    const Vec2d u(report.solution.control[k], report.solution.control[k + 1]);
    if (!scene.control.max.empty()) {
      EXPECT_LE(u.cwiseAbs().maxCoeff(), scene.control.max[0] * (1 + 1e-12));
    }
    if (!scene.control.max_norm.empty()) {
      EXPECT_LE(u.norm(), scene.control.max_norm[0] * (1 + 1e-12));
    }
  }
  if (!scene.objective.terminal[0].hard) return;
  // The miss of the target is what its term would cost if it were soft.
  Scene soft = scene;
  soft.objective.terminal[0].hard = false;
  const double miss =
      SimulateExactly(soft, report.solution.initial_state, report.solution.control, report.solution.durations).loss -
      SimulateExactly(scene, report.solution.initial_state, report.solution.control, report.solution.durations).loss;
  EXPECT_LT(miss, 1e-18 + 4 * std::numeric_limits<double>::epsilon() * report.solution.loss);
}

// A control that is constant over each step is off by the square of the step.
TEST_P(ConstrainedOptimum, IsApproachedWithSecondOrder) {
  const Json& reference = GetParam();
  std::vector<double> gaps;
  for (const int steps : {30, 120, 480}) {
    const SolveReport report = Solve("ceres_phases", {SceneOf(reference, steps), "event"}, {});
    ASSERT_EQ(report.termination, Termination::kConverged) << steps << " steps: " << report.reason;
    gaps.push_back(report.solution.loss - reference["loss"].get<double>());
  }
  if (gaps[0] < 1e-9) return;  // the optimum is constant itself
  const double order = std::log(gaps[0] / gaps[2]) / std::log(16.0);
  EXPECT_NEAR(order, 2, 0.15);
}

INSTANTIATE_TEST_SUITE_P(All, ConstrainedOptimum, testing::ValuesIn(References()),
                         [](const auto& test) { return TestName(test.param); });

// The least loss with n equal forces before an impact at a free time s, and then none. On the diagonal, the least
// effort that brings the striker to the contact with speed v follows from the moments of its forces; the best v is a
// quotient.
double OptimumOfGrid(double n) {
  const double goal = std::sqrt(2.0), way = goal - 0.4, effort = 0.1;
  const auto loss = [&](double s) {
    const double a = s, b = s * s / 2, c = s * s * s / 3 * (1 - 0.25 / (n * n)), det = a * c - b * b, rest = 1 - s;
    const double v = (effort * b * way / det + goal * rest) / (effort * c / det + rest * rest);
    const double miss = v * rest - goal;
    return effort * (c * v * v - 2 * b * v * way + a * way * way) / det + miss * miss;
  };
  double low = 0.5, high = 0.9;
  for (int i = 0; i < 200; ++i) {
    const double x = low + (high - low) / 3, y = high - (high - low) / 3;
    (loss(x) < loss(y) ? high : low) = loss(x) < loss(y) ? y : x;
  }
  return loss(low);
}

// With as many iterations whatever the number of steps.
TEST(CeresPhases, TakesAtMostTwentyIterationsToTheOptimumOfTheGrid) {
  EXPECT_NEAR(OptimumOfGrid(331), 1.396542849742, 1e-12);
  EXPECT_NEAR(OptimumOfGrid(1e7), 1.396542160123197, 1e-12);
  for (const int steps : {480, 1000, 4800}) {
    Scene scene = ProblemScene("two_balls");
    scene.steps = steps;
    const SolveReport report = Solve("ceres_phases", {scene, "event"}, {});
    ASSERT_EQ(report.termination, Termination::kConverged) << report.reason;
    EXPECT_LE(report.work.iterations, 20) << steps;
    const auto same = [&](double h) { return std::abs(h - report.solution.durations[0]) < 1e-6 * h; };
    const auto n = std::find_if_not(report.solution.durations.begin(), report.solution.durations.end(), same) -
                   report.solution.durations.begin();
    EXPECT_NEAR(report.solution.loss, OptimumOfGrid(n), 1e-9) << n << " of " << steps;
  }
}

// The launch off ground and wall to a target, by velocity, and by where it starts; also as single shooting finds it.
TEST(CeresPhases, FindsWhereAndHowFastToStart) {
  for (const Optimize what : {Optimize::kVelocity, Optimize::kPosition}) {
    for (const double friction : {0.0, 0.1}) {
      SCOPED_TRACE(std::string(OptimizeToString(what)) + ", friction " + std::to_string(friction));
      Scene scene = ProblemScene("ground_wall");
      scene.optimize = what;
      scene.contact.friction = friction;
      // Near enough to the start for a position alone.
      if (what == Optimize::kPosition) scene.objective.terminal[0].target = {-0.5, 1.2};
      const SolveReport report = Solve("ceres_phases", {scene, "event"}, {});
      ASSERT_EQ(report.termination, Termination::kConverged) << report.reason;
      EXPECT_LT(report.solution.loss, 1e-16);
      const ExactRun exact =
          SimulateExactly(scene, report.solution.initial_state, report.solution.control, report.solution.durations);
      ASSERT_TRUE(exact.ok) << exact.reason;
      EXPECT_EQ(exact.loss, report.solution.loss);
      EXPECT_EQ(exact.events.size(), 2u);
      // The part of the initial state that is not optimised stays.
      const std::vector<double> given = InitialState(scene);
      const int held = what == Optimize::kVelocity ? 0 : 2;
      for (int j = held; j < held + 2; ++j) EXPECT_EQ(report.solution.initial_state[j], given[j]);
      const SolveReport shot = Solve("ceres_lm", {scene, "event"}, {});
      ASSERT_LT(shot.solution.loss, 1e-16) << shot.reason;
      for (int j = 0; j < 4; ++j) {
        EXPECT_NEAR(report.solution.initial_state[j], shot.solution.initial_state[j], 1e-6) << j;
      }
    }
  }
}

TEST(CeresPhases, ReachesTheOptimaOfTheFollowUp) {
  // In continuous time (data/exact_references.json), and the better of the known sequences of the second.
  const std::vector<std::pair<const char*, double>> problems = {{"single_collision", 0.31141687035847},
                                                                {"multiple_collisions", 0.3562800859}};
  for (const auto& [name, optimum] : problems) {
    const SolveReport report = Solve("ceres_phases", {ProblemScene(name), "event"}, {});
    ASSERT_EQ(report.termination, Termination::kConverged) << name << ": " << report.reason;
    EXPECT_GT(report.solution.loss, optimum - 1e-9) << name;
    EXPECT_LT(report.solution.loss, optimum + 1e-6) << name;
  }
}

// Where one disc flies by the model's own steps, under the forces from row `first` on.
Vec4d FlyBy(const std::string& model, const Body& disc, Vec4d x, std::span<const double> forces, double h) {
  Scene alone;
  alone.name = "alone";
  alone.bodies = {disc};
  alone.duration = h;
  alone.steps = FindContactModel(model)->grid_steps;
  alone.duration = h * alone.steps;  // a step of the model may cover several of the grid
  for (size_t k = 0; k < forces.size(); k += 2) {
    // Gravity is what has a force on a disc of 1 kg.
    alone.gravity = {forces[k], forces[k + 1]};
    const auto simulator = MakeSimulator(model, alone, Precision::kDouble);
    std::vector<double> full(simulator->state_size()), next(full.size());
    simulator->ExpandInitial(std::span(x.data(), 4), full);
    simulator->Step(full, std::vector<double>{0, 0}, next);
    x = Vec4d(next[0], next[1], next[2], next[3]);
  }
  return x;
}

class FlownByAModel : public testing::TestWithParam<std::string> {};

// The loss is that of the model's steps and an exact impact; with finer steps both go to the exact optimum.
TEST_P(FlownByAModel, HasTheLossOfItsStepsAndOfAnExactImpact) {
  const std::string& model = GetParam();
  std::vector<double> gaps;
  for (const int steps : {60, 240, 960}) {
    Scene scene = ProblemScene("two_balls");
    scene.steps = steps;
    const SolveReport report = Solve("ceres_phases", {scene, model}, {.limits = {.iterations = 1000}});
    ASSERT_EQ(report.termination, Termination::kConverged) << report.reason;
    EXPECT_THAT(report.reason, HasSubstr(model));
    gaps.push_back(std::abs(report.solution.loss - 1.3965421601));
    if (steps != 60) continue;

    // Steps are equal before the impact, and after it.
    const auto after = std::find_if(report.solution.durations.begin(), report.solution.durations.end(), [&](double h) {
      return std::abs(h - report.solution.durations[0]) > 1e-9 * h;
    });
    ASSERT_NE(after, report.solution.durations.end());
    const size_t before = after - report.solution.durations.begin();
    const std::vector<double>& u = report.solution.control;
    const auto length = [&](size_t k) { return report.solution.durations[k] / FindContactModel(model)->grid_steps; };
    Vec4d striker = FlyBy(model, scene.bodies[0], {-2, -2, 0, 0}, std::span(u).first(2 * before), length(0));
    const Vec2d normal = Vec2d(-1 - striker[0], -1 - striker[1]).normalized();
    EXPECT_NEAR((Vec2d(-1, -1) - striker.head<2>()).norm(), 0.4, 1e-9);
    Vec4d target(-1, -1, 0, 0);
    target.tail<2>() = normal * normal.dot(striker.tail<2>());
    const std::vector<double> none(2 * (report.solution.durations.size() - before), 0.0);
    target = FlyBy(model, scene.bodies[1], target, none, length(before));
    double loss = target.head<2>().squaredNorm();
    for (size_t k = 0; k < u.size(); ++k) loss += 0.1 * u[k] * u[k] * report.solution.durations[k / 2];
    EXPECT_NEAR(report.solution.loss, loss, 1e-9);
  }
  const double order = std::log(gaps[0] / gaps[2]) / std::log(16.0);
  EXPECT_GT(order, 0.9) << gaps[0] << " " << gaps[1] << " " << gaps[2];
}

INSTANTIATE_TEST_SUITE_P(Models, FlownByAModel,
                         testing::Values("direct_toi", "compliant_warp", "lcp", "pbd_brax", "smooth_compliant"),
                         ParameterName());

TEST(CeresPhases, LaunchesByAModelsSteps) {
  for (const int steps : {36, 288}) {
    Scene scene = ProblemScene("ground_wall");
    scene.steps = steps;
    const SolveReport report = Solve("ceres_phases", {scene, "direct_toi"}, {});
    ASSERT_EQ(report.termination, Termination::kConverged) << report.reason;
    EXPECT_LT(report.solution.loss, 1e-16);
    // Euler's steps under gravity are off by g T h / 2.
    const ExactRun exact =
        SimulateExactly(scene, report.solution.initial_state, report.solution.control, report.solution.durations);
    ASSERT_TRUE(exact.ok) << exact.reason;
    EXPECT_NEAR(std::sqrt(exact.loss), 9.8 * 0.6 * 0.3 / steps, 0.6 * 9.8 * 0.6 * 0.3 / steps);
  }
}

TEST(CeresPhases, SaysWhatItCannotTakeUnderAModel) {
  Scene scene = ProblemScene("two_balls");
  scene.objective.running = {{.body = 0, .times = {0}, .targets = {Vec2d(-1, -2)}, .weight = 1}};
  const SolveReport report = Solve("ceres_phases", {scene, "direct_toi"}, {});
  EXPECT_EQ(report.termination, Termination::kNotApplicable);
  EXPECT_THAT(report.reason, HasSubstr("running costs"));
}

// By hand: under full force the striker strikes earliest and fastest. At 1.2 N that is too late, and the target stays;
// at 1.5 N it strikes on the diagonal at s = sqrt(2 D / A), D = sqrt(2) - 0.4, A = 1.5 sqrt(2), and the target then has
// the speed A s. It takes 1.434 N to reach.
TEST(CeresPhases, SaysHowFarATargetIsOutOfReach) {
  const double way = std::sqrt(2.0) - 0.4, most = 1.5 * std::sqrt(2.0), impact = std::sqrt(2 * way / most);
  const std::vector<std::pair<double, double>> cases = {{1.2, std::sqrt(2.0)},
                                                        {1.5, std::sqrt(2.0) - most * impact * (1 - impact)}};
  for (const auto& [force, miss] : cases) {
    Scene scene = ProblemScene("two_balls");
    scene.objective.terminal[0].hard = true;
    scene.control.max = {force};
    const SolveReport report = Solve("ceres_phases", {scene, "event"}, {});
    EXPECT_NE(report.termination, Termination::kConverged);
    const std::string words = "the least violation is ";
    const size_t at = report.reason.find(words);
    ASSERT_NE(at, std::string::npos) << report.reason;
    EXPECT_THAT(report.reason, HasSubstr("no feasible motion with"));
    EXPECT_THAT(report.reason, HasSubstr("m, by target"));
    const double found = std::stod(report.reason.substr(at + words.size()));
    EXPECT_GT(found, miss * (1 - 1e-5)) << force;
    EXPECT_LT(found, miss * (1 + 1e-3)) << force;
  }
}

TEST(Solve, SaysWhichConstraintsASolverCannotTake) {
  const auto refusing = [](const Scene& scene, const std::string& what) {
    std::vector<std::string> names;
    for (const SolverEntry& solver : AllSolvers()) {
      SolverOptions options;
      options.limits.iterations = 1;
      const SolveReport report = Solve(solver.name, {scene, "event"}, options);
      if (report.termination != Termination::kNotApplicable) continue;
      EXPECT_THAT(report.reason, HasSubstr(what)) << solver.name;
      names.emplace_back(solver.name);
    }
    return names;
  };
  const std::vector<std::string> never = {"ceres_shooting", "ceres_lagrangian", "grid_optimum", "ceres_event"};
  const auto and_never = [&](std::vector<std::string> names) {
    names.insert(names.end(), never.begin(), never.end());
    return testing::UnorderedElementsAreArray(names);
  };
  Scene scene = ProblemScene("two_balls");
  scene.steps = 24;
  scene.control.max = {3.5};
  EXPECT_THAT(refusing(scene, "bounds on the control"), and_never({"ceres_lbfgs"}));
  scene.control.max.clear();
  scene.control.max_norm = {3.5};
  EXPECT_THAT(refusing(scene, "bounds on the control"), and_never({"ceres_lbfgs", "ceres_lm"}));
  scene.control.max_norm.clear();
  scene.objective.terminal[0].hard = true;
  EXPECT_THAT(refusing(scene, "terminal equality constraints"), and_never({"gd", "ceres_lbfgs", "ceres_lm"}));
  scene.objective.terminal[0].hard = false;
  scene.objective.duration = FreeDuration{0.5, 2, 0.1};
  EXPECT_THAT(refusing(scene, "a free duration"), and_never({}));
}

// A shot by way of a cushion in the least time, with the norm of the force at its bound nearly everywhere. Damped steps
// leave the conditions of first order open by more than the certificate takes.
TEST(CeresPhases, MeetsTheConditionsWhereBoundsOnNormsHold) {
  Scene scene;
  scene.name = "air_hockey";
  scene.duration = 1.5;
  scene.steps = 150;
  scene.bodies = {{.name = "striker", .radius = 0.08, .mass = 0.3, .position = {0.3, -0.2}},
                  {.name = "puck", .radius = 0.05, .mass = 0.1, .position = {0.9, 0.1}, .velocity = {-0.3, -0.1}},
                  {.name = "post", .radius = 0.12, .fixed = true, .position = {1.4, 0}}};
  scene.planes = {{"top", {0, 0.5}, {0, -1}}, {"bottom", {0, -0.5}, {0, 1}}, {"back", {0, 0}, {1, 0}}};
  scene.contact.restitution = 0.9;
  scene.control = {.bodies = {0}, .initial = {{1, 0.5}}, .max_norm = {4}};
  scene.objective.terminal = {
      {.body = 1, .target = {2, 0}, .hard = true},
      {.body = 0, .quantity = TerminalTerm::Quantity::kVelocity, .target = {0, 0}, .weight = 0.01}};
  scene.objective.effort = 0.01;
  scene.objective.duration = FreeDuration{0.3, 3, 1};
  scene.no_contact = {{1, 2}, {0, 2}};
  scene.optimize = Optimize::kControl;
  const SolveReport report = Solve("ceres_phases", {scene, "event"}, {});
  EXPECT_EQ(report.termination, Termination::kConverged) << report.reason;
  EXPECT_LT(report.solution.loss, 0.60203);
  EXPECT_LT(report.solution.violation, 1e-8);
  ASSERT_TRUE(report.certificate);
  EXPECT_EQ(report.certificate->verdict, Certificate::Verdict::kStationary) << report.certificate->reason;
}

// The only final time that its bounds allow, of which nothing is asked; its price is a constant of the loss.
TEST(FreeDuration, BetweenEqualBoundsIsAFixedOne) {
  Scene fixed = ProblemScene("two_balls");
  fixed.steps = 24;
  fixed.duration = 0.75;
  Scene equal = fixed;
  equal.duration = 1;
  equal.objective.duration = FreeDuration{0.75, 0.75, 2};
  for (const char* solver : {"ceres_phases", "ceres_event", "gd", "hmp", "ceres_lm"}) {
    SCOPED_TRACE(solver);
    std::vector<double> losses;
    SolverOptions options{.limits = {.iterations = 60}};
    options.monitor.callback = [&](int, double loss) {
      losses.push_back(loss);
      return true;
    };
    const SolveReport expected = Solve(solver, {fixed, "event"}, {.limits = {.iterations = 60}});
    const SolveReport report = Solve(solver, {equal, "event"}, options);
    ASSERT_EQ(report.termination, expected.termination) << report.reason;
    EXPECT_EQ(report.solution.control, expected.solution.control);
    EXPECT_DOUBLE_EQ(report.guess.loss, expected.guess.loss + 1.5);
    EXPECT_DOUBLE_EQ(report.solution.loss, expected.solution.loss + 1.5);
    ASSERT_EQ(report.history.losses.size(), expected.history.losses.size());
    if (solver == std::string("gd")) {
      EXPECT_EQ(losses, report.history.losses);
    }
    EXPECT_NEAR(std::accumulate(report.solution.durations.begin(), report.solution.durations.end(), 0.0), 0.75, 1e-12);
    // The scene that is asked about says the same of the solution.
    const ExactRun exact =
        SimulateExactly(equal, report.solution.initial_state, report.solution.control, report.solution.durations);
    ASSERT_TRUE(exact.ok) << exact.reason;
    const ExactRun of_fixed =
        SimulateExactly(fixed, expected.solution.initial_state, expected.solution.control, expected.solution.durations);
    EXPECT_NEAR(exact.loss, of_fixed.loss + 1.5, 1e-9);
    const Certificate certificate =
        Certify(equal, report.solution.initial_state, report.solution.control, report.solution.durations);
    const Certificate same =
        Certify(fixed, expected.solution.initial_state, expected.solution.control, expected.solution.durations);
    EXPECT_EQ(certificate.verdict, same.verdict);
    EXPECT_FALSE(certificate.final_time);
  }
}

// Returns a problem of that number with these waypoints, which are places beside the start of the pushed disc.
Scene WithWaypoints(int seed, const std::vector<ViaTerm>& via) {
  Scene scene = ControlProblem(seed);
  scene.steps = 40;
  const int pushed = scene.control.bodies[0];
  for (ViaTerm term : via) {
    term.body = pushed;
    term.time *= scene.duration;
    if (term.quantity == TerminalTerm::Quantity::kPosition) term.target += scene.bodies[pushed].position;
    scene.objective.via.push_back(term);
  }
  return scene;
}

// Two waypoints at one time are one: w_1 |q - r_1|^2 + w_2 |q - r_2|^2 is (w_1 + w_2) |q -
// r|^2 and a constant, with r their mean. So they are counted once.
TEST(Waypoints, AtOneTimeAreCountedOnceBySolversInPhases) {
  const ViaTerm first{.time = 0.3, .target = {0.1, 0.02}, .weight = 1},
      second{.time = 0.3, .target = {0.07, 0.08}, .weight = 2};
  const double weight = first.weight + second.weight;
  ViaTerm both{.time = 0.3, .weight = weight};
  both.target = (first.weight * first.target + second.weight * second.target) / weight;
  const double constant = first.weight * second.weight / weight * (first.target - second.target).squaredNorm();
  for (const int seed : {0, 1, 5, 7}) {
    const Scene one = WithWaypoints(seed, {both}), two = WithWaypoints(seed, {first, second});
    for (const char* solver : {"ceres_phases", "ipopt", "mode_search"}) {
      SolverOptions options;
      options.sequences.limits.starts = 1;
      options.sequences.limits.work = 3e5;
      const SolveReport expected = Solve(solver, {one, "event"}, options);
      if (expected.termination == Termination::kNotApplicable) continue;  // this build has no IPOPT
      const SolveReport report = Solve(solver, {two, "event"}, options);
      EXPECT_EQ(report.termination, expected.termination) << solver << " " << seed << " " << report.reason;
      EXPECT_NEAR(report.solution.loss, expected.solution.loss + constant, 1e-8 * report.solution.loss)
          << solver << " " << seed;
      const ExactRun exact =
          SimulateExactly(two, report.solution.initial_state, report.solution.control, report.solution.durations);
      EXPECT_NEAR(exact.loss, report.solution.loss, 1e-12 * exact.loss);
    }
  }
}

// Waypoints at several times, of which two are at one, with motions that get to their impacts before, between and
// behind them: every solver returns a motion with the loss that it reports, and a hard waypoint is met where a solve
// converges.
TEST(Waypoints, OfManyKindsLeadToMotions) {
  const std::vector<ViaTerm> via = {
      {.time = 0.3, .target = {0.05, 0.03}, .weight = 0.5},
      {.time = 0.3, .quantity = TerminalTerm::Quantity::kVelocity, .target = {0.3, 0.1}, .weight = 0.1},
      {.time = 0.7, .target = {0.2, 0.1}, .weight = 0.3},
      {.time = 0.15, .target = {0.02, 0.01}, .hard = true}};
  int converged = 0;
  for (const int seed : {2, 3, 4, 6, 8, 9, 14}) {
    const Scene scene = WithWaypoints(seed, via);
    for (const char* solver : {"ceres_phases", "ipopt", "mode_search"}) {
      SolverOptions options{.limits = {.iterations = 300}};
      options.sequences.limits.starts = 1;
      options.sequences.limits.work = 3e5;
      const SolveReport report = Solve(solver, {scene, "event"}, options);
      if (report.termination == Termination::kNotApplicable || report.solution.control.empty()) continue;
      const ExactRun exact =
          SimulateExactly(scene, report.solution.initial_state, report.solution.control, report.solution.durations);
      ASSERT_TRUE(exact.ok) << solver << " " << seed;
      EXPECT_NEAR(exact.loss, report.solution.loss, 1e-9 * exact.loss) << solver << " " << seed;
      if (report.termination != Termination::kConverged) continue;
      ++converged;
      EXPECT_LE(report.solution.violation, kFeasible) << solver << " " << seed;
    }
  }
  EXPECT_GE(converged, 8);
}

}  // namespace
}  // namespace saltus
