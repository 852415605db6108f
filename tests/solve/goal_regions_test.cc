// Goal regions and limits of the speed by every solver that takes them: optima in closed form, their multipliers, and
// what certificates make of them.
#include <gmock/gmock.h>

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>
#include <string>
#include <vector>

#include "saltus/optimality/certificate.h"
#include "saltus/simulate/exact_run.h"
#include "saltus/solve/solver.h"
#include "test_scenes.h"

namespace saltus {
namespace {

using testing::HasSubstr;

constexpr double kNone = std::numeric_limits<double>::infinity();
constexpr double kMass = 2, kEffort = 0.1, kDuration = 1.5;
constexpr int kSteps = 30;

// A disc at rest at the origin, and a force on it.
Scene PushedDisc() {
  Scene scene;
  scene.name = "pushed";
  scene.duration = kDuration;
  scene.steps = kSteps;
  scene.bodies = {{.name = "disc", .radius = 0.1, .mass = kMass}};
  scene.control = {.bodies = {0}, .initial = {{0.1, 0.1}}};
  scene.objective.effort = kEffort;
  scene.optimize = Optimize::kControl;
  return scene;
}

TerminalTerm GoalOf(const Vec2d& min, const Vec2d& max) {
  TerminalTerm term{.hard = true};
  term.region = TerminalTerm::Region{min, max};
  return term;
}

// The matrix G such that the least integral of |u|^2 dt with a change of position d and of velocity w, of one
// component, is [d w] G^-1 [d w]^T.
Eigen::Matrix2d Reach() {
  const double h = kDuration / kSteps;
  Eigen::Matrix2d sum = Eigen::Matrix2d::Zero();
  for (int k = 0; k < kSteps; ++k) {
    const Eigen::Vector2d gain = Eigen::Vector2d(kDuration - (k + 0.5) * h, 1) / kMass;
    sum += h * gain * gain.transpose();
  }
  return sum;
}

class GoalRegions : public testing::TestWithParam<const char*> {
  void SetUp() override {
    Scene scene = PushedDisc();
    scene.objective.terminal = {GoalOf({1.5, -kNone}, {2, -0.5})};
    SolverOptions options;
    options.limits.iterations = 1;
    const SolveReport report = Solve(GetParam(), {scene, "event"}, options);
    if (report.termination == Termination::kNotApplicable && GetParam() == std::string("ipopt")) {
      GTEST_SKIP() << report.reason;
    }
  }
};

TEST_P(GoalRegions, AreReachedAtTheNearestPoint) {
  Scene scene = PushedDisc();
  scene.objective.terminal = {GoalOf({1.5, -kNone}, {2, -0.5})};
  const SolveReport report = Solve(GetParam(), {scene, "event"}, {});
  ASSERT_EQ(report.termination, Termination::kConverged) << report.reason;
  const double per_square = kEffort / Reach()(0, 0);
  EXPECT_NEAR(report.solution.loss, per_square * (1.5 * 1.5 + 0.5 * 0.5), 1e-8 * report.solution.loss);
  const ExactRun run =
      SimulateExactly(scene, report.solution.initial_state, report.solution.control, report.solution.durations);
  EXPECT_NEAR(run.end[0], 1.5, 1e-8);
  EXPECT_NEAR(run.end[1], -0.5, 1e-8);
  EXPECT_LE(report.solution.violation, kFeasible);

  ASSERT_TRUE(report.certificate);
  const Certificate& certificate = *report.certificate;
  EXPECT_TRUE(certificate.IsStationary()) << certificate.reason;
  ASSERT_TRUE(certificate.curvature) << certificate.reason;
  EXPECT_EQ(certificate.curvature->kind, Curvature::Kind::kMinimum);
  ASSERT_EQ(certificate.constraints.size(), 1u);
  EXPECT_NEAR(certificate.constraints[0].multiplier[0], -2 * per_square * 1.5, 1e-6);
  EXPECT_NEAR(certificate.constraints[0].multiplier[1], 2 * per_square * 0.5, 1e-6);
}

TEST_P(GoalRegions, HoldOneComponentAlone) {
  Scene scene = PushedDisc();
  scene.bodies[0].velocity = {0, 0.2};
  scene.objective.terminal = {GoalOf({-kNone, -kNone}, {kNone, kNone})};
  scene.objective.terminal[0].region->min[0] = scene.objective.terminal[0].region->max[0] = -1;
  const SolveReport report = Solve(GetParam(), {scene, "event"}, {});
  ASSERT_EQ(report.termination, Termination::kConverged) << report.reason;
  EXPECT_NEAR(report.solution.loss, kEffort / Reach()(0, 0), 1e-8);
  const ExactRun run =
      SimulateExactly(scene, report.solution.initial_state, report.solution.control, report.solution.durations);
  EXPECT_NEAR(run.end[0], -1, 1e-8);
  EXPECT_NEAR(run.end[1], 0.2 * kDuration, 1e-6);
}

// The least torque that leads to an angular velocity is constant; the effort counts it as a force at the rim.
TEST_P(GoalRegions, BoundAnAngularVelocity) {
  Scene scene = PushedDisc();
  scene.bodies[0].inertia.kind = Inertia::Kind::kSolid;
  scene.control.torque_bodies = {0};
  scene.control.initial_torque = {0.01};
  scene.objective.terminal = {GoalOf({3, -kNone}, {5, kNone})};
  scene.objective.terminal[0].quantity = TerminalTerm::Quantity::kAngularVelocity;
  const SolveReport report = Solve(GetParam(), {scene, "event"}, {});
  ASSERT_EQ(report.termination, Termination::kConverged) << report.reason;
  const double radius = 0.1, rim = 0.5 * kMass * radius * 3 / kDuration;  // N, I w / (T r)
  EXPECT_NEAR(report.solution.loss, kEffort * kDuration * rim * rim, 1e-8 * report.solution.loss);
  ASSERT_TRUE(report.certificate);
  EXPECT_TRUE(report.certificate->IsStationary()) << report.certificate->reason;
  ASSERT_EQ(report.certificate->constraints.size(), 1u);
  EXPECT_NEAR(report.certificate->constraints[0].multiplier[0], -2 * report.solution.loss / 3, 1e-6);
}

TEST_P(GoalRegions, ChangeNothingAroundAFreeOptimum) {
  Scene scene = PushedDisc();
  scene.objective.terminal = {{.target = {1, 0.5}, .weight = 2}};
  const SolveReport free = Solve("ceres_phases", {scene, "event"}, {});
  ASSERT_EQ(free.termination, Termination::kConverged) << free.reason;
  scene.objective.terminal.push_back(GoalOf({0, 0}, {2, 2}));
  scene.objective.limits = {{.body = 0, .max = 10, .at = SpeedLimit::Timing::kAlways}};
  const SolveReport report = Solve(GetParam(), {scene, "event"}, {});
  ASSERT_EQ(report.termination, Termination::kConverged) << report.reason;
  EXPECT_NEAR(report.solution.loss, free.solution.loss, 1e-8 * free.solution.loss);
  ASSERT_TRUE(report.certificate);
  EXPECT_TRUE(report.certificate->IsStationary()) << report.certificate->reason;
  ASSERT_EQ(report.certificate->constraints.size(), 1u);
  EXPECT_EQ(report.certificate->constraints[0].multiplier, Vec2d(0, 0));
}

// The disc ends at a given place, no faster than 0.8 m/s, where the least effort alone would make it faster.
TEST_P(GoalRegions, LimitTheSpeedAtTheEnd) {
  constexpr double kMost = 0.8;
  Scene scene = PushedDisc();
  const Vec2d way(0.6, 0.8);
  scene.objective.terminal = {{.target = way, .hard = true}};
  scene.objective.limits = {{.body = 0, .max = kMost, .at = SpeedLimit::Timing::kEnd}};
  const SolveReport report = Solve(GetParam(), {scene, "event"}, {});
  ASSERT_EQ(report.termination, Termination::kConverged) << report.reason;
  const Eigen::Vector2d changes(1, kMost), slopes = Reach().inverse() * changes;
  EXPECT_NEAR(report.solution.loss, kEffort * changes.dot(slopes), 1e-8 * report.solution.loss);
  const ExactRun run =
      SimulateExactly(scene, report.solution.initial_state, report.solution.control, report.solution.durations);
  EXPECT_NEAR(std::hypot(run.end[2], run.end[3]), kMost, 1e-8);

  ASSERT_TRUE(report.certificate);
  const Certificate& certificate = *report.certificate;
  EXPECT_TRUE(certificate.IsStationary()) << certificate.reason;
  ASSERT_TRUE(certificate.curvature) << certificate.reason;
  EXPECT_EQ(certificate.curvature->kind, Curvature::Kind::kMinimum);
  ASSERT_EQ(certificate.constraints.size(), 2u);
  EXPECT_NEAR(certificate.constraints[0].multiplier[0], -2 * kEffort * slopes[0] * way[0], 1e-6);
  EXPECT_NEAR(certificate.constraints[0].multiplier[1], -2 * kEffort * slopes[0] * way[1], 1e-6);
  EXPECT_EQ(certificate.constraints[1].speed_limit, kMost);
  EXPECT_NEAR(certificate.constraints[1].multiplier[0], -2 * kEffort * slopes[1], 1e-6);
  EXPECT_GT(certificate.constraints[1].multiplier[0], 0.1);
}

// If the limit moves by d, the optimum changes by d times the sum of the multipliers, as those of other limits show.
TEST_P(GoalRegions, LimitTheSpeedAlways) {
  constexpr double kMost = 0.8, kStep = 1e-4;
  const auto solve = [](double most, Scene* scene) {
    *scene = PushedDisc();
    scene->objective.terminal = {{.target = {0.6, 0.8}, .hard = true}};
    scene->objective.limits = {{.body = 0, .max = most, .at = SpeedLimit::Timing::kAlways}};
    const SolveReport report = Solve(GetParam(), {*scene, "event"}, {});
    EXPECT_EQ(report.termination, Termination::kConverged) << report.reason;
    return report;
  };
  Scene scene, other;
  const SolveReport report = solve(kMost, &scene);
  const double slope =
      (solve(kMost + kStep, &other).solution.loss - solve(kMost - kStep, &other).solution.loss) / (2 * kStep);

  Vec2d v = Vec2d::Zero();
  double fastest = 0;
  for (int k = 0; k < kSteps; ++k) {
    const double h = report.solution.durations.empty() ? kDuration / kSteps : report.solution.durations[k];
    v += h / kMass * Vec2d(report.solution.control[2 * k], report.solution.control[2 * k + 1]);
    fastest = std::max(fastest, v.norm());
  }
  EXPECT_NEAR(fastest, kMost, 1e-7);

  ASSERT_TRUE(report.certificate);
  const Certificate& certificate = *report.certificate;
  EXPECT_TRUE(certificate.IsStationary()) << certificate.reason;
  ASSERT_TRUE(certificate.curvature);
  EXPECT_EQ(certificate.curvature->kind, Curvature::Kind::kMinimum);
  ASSERT_GT(certificate.constraints.size(), 3u);
  double sum = 0, last = 0;
  for (size_t i = 1; i < certificate.constraints.size(); ++i) {
    const ConstraintCertificate& limit = certificate.constraints[i];
    ASSERT_TRUE(limit.time);
    EXPECT_GT(*limit.time, last);
    EXPECT_GE(limit.multiplier[0], -1e-6);
    last = *limit.time;
    sum += limit.multiplier[0];
  }
  EXPECT_DOUBLE_EQ(last, kDuration);
  EXPECT_NEAR(sum, -slope, 1e-4 * std::abs(slope));

  std::vector<double> changed = report.solution.control;
  changed[4] *= 1.01;
  EXPECT_EQ(Certify(scene, report.solution.initial_state, changed, report.solution.durations).verdict,
            Certificate::Verdict::kNotStationary);
}

INSTANTIATE_TEST_SUITE_P(All, GoalRegions, testing::Values("ceres_phases", "ipopt", "mode_search"),
                         [](const auto& test) { return test.param; });

// The limit of the striker is active on the way to its impact and just before it, and not after it.
TEST(SpeedLimit, HasMultipliersUpToAnImpact) {
  constexpr double kMost = 2.6, kStep = 1e-4;
  const auto solve = [](double most, Scene* scene) {
    *scene = ProblemScene("two_balls");
    scene->steps = 60;
    scene->objective.terminal = {GoalOf({0, -kNone}, {0.5, 0.5})};
    scene->objective.terminal[0].body = 1;
    scene->objective.limits = {{.body = 0, .max = most, .at = SpeedLimit::Timing::kAlways}};
    const SolveReport report = Solve("ceres_phases", {*scene, "event"}, {});
    EXPECT_EQ(report.termination, Termination::kConverged) << report.reason;
    return report;
  };
  Scene scene, other;
  const SolveReport report = solve(kMost, &scene);
  const double slope =
      (solve(kMost + kStep, &other).solution.loss - solve(kMost - kStep, &other).solution.loss) / (2 * kStep);
  ASSERT_TRUE(report.certificate);
  const Certificate& certificate = *report.certificate;
  EXPECT_EQ(certificate.verdict, Certificate::Verdict::kStationary) << certificate.reason;
  ASSERT_EQ(certificate.impacts.size(), 1u);
  ASSERT_GT(certificate.constraints.size(), 3u);
  double sum = 0, last = 0;
  for (size_t i = 1; i < certificate.constraints.size(); ++i) {
    ASSERT_TRUE(certificate.constraints[i].time);
    last = *certificate.constraints[i].time;
    sum += certificate.constraints[i].multiplier[0];
  }
  EXPECT_NEAR(last, certificate.impacts[0].time, 1e-9);
  EXPECT_NEAR(sum, -slope, 1e-4 * std::abs(slope));
}

// A mass is chosen along with the control: given masses beside the best one lead to greater losses.
TEST(GoalRegion, LeavesAMassToBeChosen) {
  Scene scene = ProblemScene("two_balls");
  scene.steps = 60;
  scene.objective.terminal = {GoalOf({0, -kNone}, {0.5, 0.5})};
  scene.objective.terminal[0].body = 1;
  scene.objective.limits = {{.body = 1, .max = 2.5, .at = SpeedLimit::Timing::kEnd}};
  Scene designed = scene;
  designed.design = {{.parameter = {.kind = SceneParameter::Kind::kMass, .body = 1}, .min = 0.5, .max = 2}};
  const SolveReport report = Solve("ceres_phases", {designed, "event"}, {});
  ASSERT_EQ(report.termination, Termination::kConverged) << report.reason;
  ASSERT_TRUE(report.certificate);
  EXPECT_TRUE(report.certificate->IsStationary()) << report.certificate->reason;
  EXPECT_GT(report.certificate->constraints.at(1).multiplier[0], 0.1);
  for (const double beside : {-0.01, 0.01}) {
    scene.bodies[1].mass = report.solution.parameters.at(0) + beside;
    const SolveReport other = Solve("ceres_phases", {scene, "event"}, {});
    ASSERT_EQ(other.termination, Termination::kConverged) << other.reason;
    EXPECT_GT(other.solution.loss, report.solution.loss + 1e-5);
  }
}

// Under a limit that always holds: an interval ends at a speed that the mass under design gives it. The mass of the
// disc that is limited trades the speed that it keeps against the force that it takes.
TEST(GoalRegion, LeavesAMassUnderALimitToBeChosen) {
  Scene scene = ProblemScene("two_balls");
  scene.steps = 60;
  scene.objective.limits = {{.body = 0, .max = 2.2, .at = SpeedLimit::Timing::kAlways}};
  Scene designed = scene;
  designed.design = {{.parameter = {.kind = SceneParameter::Kind::kMass, .body = 0}, .min = 0.2, .max = 3}};
  const SolveReport report = Solve("ceres_phases", {designed, "event"}, {});
  ASSERT_EQ(report.termination, Termination::kConverged) << report.reason;
  ASSERT_TRUE(report.certificate);
  EXPECT_TRUE(report.certificate->IsStationary()) << report.certificate->reason;
  EXPECT_LE(report.solution.violation, 1e-8);
  ASSERT_EQ(report.solution.parameters.size(), 1u);
  EXPECT_GT(report.solution.parameters[0], 0.2);
  EXPECT_LT(report.solution.parameters[0], 3);
  for (const double beside : {-0.05, 0.05}) {
    scene.bodies[0].mass = report.solution.parameters[0] + beside;
    const SolveReport other = Solve("ceres_phases", {scene, "event"}, {});
    ASSERT_EQ(other.termination, Termination::kConverged) << other.reason;
    EXPECT_GT(other.solution.loss, report.solution.loss);
  }
}

// A game of air hockey: the puck ends anywhere in its goal, and the striker at 0.3 m/s or less, as soon as possible.
Scene AirHockey(double duration, int steps, const Vec2d& force) {
  Scene scene;
  scene.name = "air_hockey";
  scene.duration = duration;
  scene.steps = steps;
  scene.bodies = {{.name = "striker", .radius = 0.08, .mass = 0.3, .position = {0.3, -0.2}},
                  {.name = "puck", .radius = 0.05, .mass = 0.1, .position = {0.9, 0.1}, .velocity = {-0.3, -0.1}},
                  {.name = "post", .radius = 0.12, .fixed = true, .position = {1.4, 0}}};
  scene.planes = {{"top", {0, 0.5}, {0, -1}}, {"bottom", {0, -0.5}, {0, 1}}, {"back", {0, 0}, {1, 0}}};
  scene.contact.restitution = 0.9;
  scene.control = {.bodies = {0}, .initial = {force}, .max = {4}};
  TerminalTerm goal = GoalOf({2, -0.15}, {kNone, 0.15});
  goal.body = 1;
  scene.objective = {.terminal = {goal},
                     .effort = 0.01,
                     .limits = {{.body = 0, .max = 0.3, .at = SpeedLimit::Timing::kEnd}},
                     .duration = FreeDuration{0.3, 3, 1}};
  scene.no_contact = {{1, 2}, {0, 2}};
  scene.optimize = Optimize::kControl;
  return scene;
}

void ExpectTheOptimum(const Scene& scene, const SolveReport& report) {
  ASSERT_EQ(report.termination, Termination::kConverged) << report.reason;
  // A hybrid system in Python of this game has this optimum on 40 intervals.
  EXPECT_NEAR(report.solution.loss, 0.556028, 6e-6);
  EXPECT_NEAR(std::accumulate(report.solution.durations.begin(), report.solution.durations.end(), 0.0), 0.48805, 2e-5);
  const ExactRun run =
      SimulateExactly(scene, report.solution.initial_state, report.solution.control, report.solution.durations);
  EXPECT_NEAR(run.end[4], 2, 1e-7);
  EXPECT_NEAR(run.end[5], 0.15, 1e-7);
  EXPECT_NEAR(std::hypot(run.end[2], run.end[3]), 0.3, 1e-7);
  ASSERT_EQ(run.contacts.size(), 2u);
  ASSERT_TRUE(report.certificate);
  EXPECT_EQ(report.certificate->verdict, Certificate::Verdict::kStationary) << report.certificate->reason;
  ASSERT_TRUE(report.certificate->curvature) << report.certificate->reason;
  EXPECT_EQ(report.certificate->curvature->kind, Curvature::Kind::kMinimum);
  const std::vector<ConstraintCertificate>& constraints = report.certificate->constraints;
  ASSERT_EQ(constraints.size(), 2u);
  EXPECT_LT(constraints[0].multiplier[0], -0.01);
  EXPECT_GT(constraints[0].multiplier[1], 0.01);
  EXPECT_GT(constraints[1].multiplier[0], 0.001);
}

TEST_P(GoalRegions, AreReachedByWayOfACushion) {
  const Scene scene = AirHockey(0.5, 40, {3, 1});
  ExpectTheOptimum(scene, Solve(GetParam(), {scene, "event"}, {}));
}

// In the motion of this guess the puck comes back from the other cushion.
TEST(GoalRegion, IsReachedFromAGuessOfOtherImpacts) {
  const Scene scene = AirHockey(1.5, 150, {1, 0.5});
  ExpectTheOptimum(scene, Solve("ceres_phases", {scene, "event"}, {}));
}

// At the bound of a region from which the loss falls inwards.
TEST(GoalRegion, IsNotLeftByACertificate) {
  Scene scene = PushedDisc();
  scene.objective.terminal = {{.target = {1.5, 0}, .hard = true}};
  const SolveReport report = Solve("ceres_phases", {scene, "event"}, {});
  ASSERT_EQ(report.termination, Termination::kConverged) << report.reason;
  scene.objective.terminal = {GoalOf({1.5, -kNone}, {2, kNone})};
  EXPECT_TRUE(
      Certify(scene, report.solution.initial_state, report.solution.control, report.solution.durations).IsStationary());
  scene.objective.terminal = {GoalOf({1, -kNone}, {1.5, kNone})};
  EXPECT_EQ(Certify(scene, report.solution.initial_state, report.solution.control, report.solution.durations).verdict,
            Certificate::Verdict::kNotStationary);
}

TEST(GoalRegion, IsRefusedByOtherSolvers) {
  Scene region = PushedDisc(), limit = PushedDisc();
  region.objective.terminal = {GoalOf({1.5, -kNone}, {2, kNone})};
  limit.objective.terminal = {{.target = {1, 0}}};
  limit.objective.limits = {{.body = 0, .max = 1}};
  for (const char* solver : {"gd", "ceres_lbfgs", "ceres_lm", "ceres_shooting", "ceres_event", "hmp"}) {
    for (const Scene* scene : {&region, &limit}) {
      const SolveReport report = Solve(solver, {*scene, "event"}, {});
      EXPECT_EQ(report.termination, Termination::kNotApplicable) << solver;
      EXPECT_THAT(report.reason, HasSubstr(scene == &region ? "goal regions" : "limits of the speed")) << solver;
      EXPECT_THAT(report.reason, HasSubstr("ceres_phases")) << solver;
    }
  }
}

}  // namespace
}  // namespace saltus
