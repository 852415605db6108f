// Feedback of scenes whose events, intervals or states are unusual: phases of one node, contacts that last, impacts at
// the same time, near misses, intervals of different lengths, models with states of their own.
#include <gtest/gtest.h>

#include <Eigen/Core>
#include <cmath>
#include <numbers>
#include <string>
#include <vector>

#include "saltus/feedback/closed_loop.h"
#include "saltus/feedback/covariance.h"
#include "saltus/simulate/exact_run.h"
#include "saltus/simulate/registry.h"
#include "test_scenes.h"

namespace saltus {
namespace {

using Eigen::MatrixXd;
using Eigen::VectorXd;

// A disc that flies to and fro between two walls, 0.4 m of free way, without forces and losses.
Scene BetweenWalls(double speed) {
  Scene scene;
  scene.name = "walls";
  scene.duration = 1;
  scene.steps = 10;
  scene.bodies = {{.name = "disc", .radius = 0.1, .mass = 1, .position = {-0.19, 0}, .velocity = {speed, 0}}};
  scene.planes = {{.name = "right", .point = {0.3, 0}, .normal = {-1, 0}},
                  {.name = "left", .point = {-0.3, 0}, .normal = {1, 0}}};
  scene.contact.restitution = 1;
  scene.optimize = Optimize::kNone;
  return scene;
}

// A disc on the ground that is pushed along it, or falls onto it.
Scene OnTheGround(double height, double speed) {
  Scene scene;
  scene.name = "ground";
  scene.duration = 1;
  scene.steps = 20;
  scene.gravity = Vec2d(0, -9.8);
  scene.bodies = {{.name = "disc", .radius = 0.1, .mass = 1, .position = {0, 0.1 + height}, .velocity = {speed, 0}}};
  scene.planes = {{.name = "ground", .point = {0, 0}, .normal = {0, 1}}};
  scene.contact.restitution = 0.5;
  scene.control = {{0}, {{0, 0}}};
  scene.objective.terminal = {{.body = 0, .target = {1, 0.1}}};
  scene.optimize = Optimize::kControl;
  return scene;
}

ScenePlan PlanOf(const Scene& scene) {
  const int width = scene.control_width();
  return PlanScene(scene, InitialState(scene), width > 0 ? InitialControl(scene, scene.steps) : std::vector<double>());
}

ClosedLoopRun UndisturbedRun(const Scene& scene, const ScenePlan& planned, const Regulator* regulator = nullptr,
                             const std::string& model = "event") {
  const auto plant = MakePlant(Contact(model), scene, planned.lengths);
  return RunClosedLoop(planned.plan, regulator ? regulator->gains : std::vector<MatrixXd>(), {}, 1, 0, plant.get());
}

Regulator Regulate(const ScenePlan& planned) {
  const Eigen::Index n = planned.plan.states[0].size(), m = planned.plan.num_controls;
  return Track(planned.linear,
               {.Q = {MatrixXd::Identity(n, n)}, .R = 0.01 * MatrixXd::Identity(m, m), .QT = MatrixXd::Identity(n, n)});
}

// Impacts every 0.21, 0.15 and 0.08 s, with 0.1 s between nodes: phases of two nodes, of one and of none.
TEST(SceneFeedback, ImpactsInNeighbouringIntervals) {
  for (const double speed : {1.9, 2.7, 5.0}) {
    const Scene scene = BetweenWalls(speed);
    const ScenePlan planned = PlanOf(scene);
    ASSERT_EQ(planned.reason, "");
    const ClosedLoopRun run = UndisturbedRun(scene, planned);
    EXPECT_TRUE(run.ok && run.as_planned);
    EXPECT_LE((run.final_state - planned.plan.states.back()).norm(), 1e-12);
    // A disc that is late goes on beyond the wall; one that is early comes from behind it.
    for (std::size_t e = 0; e < planned.plan.events.size(); ++e) {
      const double sign = e % 2 == 0 ? 1 : -1, at = (0.39 + 0.4 * static_cast<double>(e)) / speed;
      const Plan::Branch &late = planned.plan.late[e], &early = planned.plan.early[e];
      for (std::size_t i = 0; i < late.states.size(); ++i) {
        const double t = 0.1 * (late.first + static_cast<double>(i)) - at;
        EXPECT_NEAR(late.states[i][0], sign * (0.2 + speed * t), 1e-12);
        EXPECT_NEAR(late.states[i][2], sign * speed, 1e-12);
      }
      for (std::size_t i = 0; i < early.states.size(); ++i) {
        const double t = 0.1 * (early.first + static_cast<double>(i)) - at;
        EXPECT_NEAR(early.states[i][0], sign * (0.2 - speed * t), 1e-12);
        EXPECT_NEAR(early.states[i][2], -sign * speed, 1e-12);
      }
    }
    // The end is x(1) = +-(... speed), so that errors of the speed grow with time: v moves it by t, x by 1.
    const Covariance covariance = Propagate(planned.linear, {.initial = 1e-6 * MatrixXd::Identity(4, 4)});
    EXPECT_NEAR(covariance.nodes.back()(0, 0), 2e-6, 1e-17);
    // Each impact, at (0.39 + 0.4 e - dx) / (speed + dv).
    ASSERT_EQ(covariance.event_times.size(), planned.plan.events.size());
    for (std::size_t e = 0; e < planned.plan.events.size(); ++e) {
      const double way = 0.39 + 0.4 * static_cast<double>(e);
      EXPECT_NEAR(covariance.event_times[e], 1e-3 * std::hypot(1, way / speed) / speed, 1e-12) << e;
    }
  }
}

TEST(SceneFeedback, ImpactInTheFirstInterval) {
  Scene scene = BetweenWalls(1);
  scene.bodies[0].position[0] = 0.15;
  const ScenePlan planned = PlanOf(scene);
  ASSERT_EQ(planned.reason, "");
  ASSERT_EQ(planned.plan.early[0].states.size(), 1u);
  EXPECT_NEAR(planned.plan.early[0].states[0][0], 0.25, 1e-12);
  EXPECT_TRUE(UndisturbedRun(scene, planned).as_planned);
}

// A disc that lies or slides on the ground, or bounces until it lies: noise makes it bounce more or less often, which
// does not keep the regulator from acting.
TEST(SceneFeedback, DiscsThatComeToRest) {
  for (const double height : {0.0, 0.3}) {
    const Scene scene = OnTheGround(height, 1);
    const ScenePlan planned = PlanOf(scene);
    ASSERT_EQ(planned.reason, "");
    EXPECT_EQ(planned.remark.empty(), height > 0) << planned.remark;
    const Regulator regulator = Regulate(planned);
    const ClosedLoopRun undisturbed = UndisturbedRun(scene, planned, &regulator);
    EXPECT_TRUE(undisturbed.ok && undisturbed.as_planned) << height;
    EXPECT_LE((undisturbed.final_state - planned.plan.states.back()).norm(), 1e-9);
    const Noise noise{.initial = Eigen::Vector4d(1e-6, 1e-8, 1e-6, 1e-6).asDiagonal()};
    const auto plant = [&] { return MakePlant(Contact("event"), scene, planned.lengths); };
    const MonteCarlo open = RunMonteCarlo(planned.plan, {}, noise, plant, {.samples = 400, .threads = 2});
    const MonteCarlo closed =
        RunMonteCarlo(planned.plan, regulator.gains, noise, plant, {.samples = 400, .threads = 2});
    EXPECT_EQ(open.failed + closed.failed, 0);
    // Along the ground x moves by dx + dv, to first order and in the runs, and feedback takes most of it away.
    const Covariance in_open = Propagate(planned.linear, noise),
                     in_closed = Propagate(planned.linear, noise, &regulator);
    EXPECT_NEAR(in_open.nodes.back()(0, 0), 2e-6, 1e-15);
    EXPECT_NEAR(open.covariance(0, 0), 2e-6, 4 * 2e-6 * std::sqrt(2.0 / 400));
    EXPECT_NEAR(
        closed.covariance(0, 0), in_closed.nodes.back()(0, 0), 4 * in_closed.nodes.back()(0, 0) * std::sqrt(2.0 / 400));
    EXPECT_LT(closed.covariance(0, 0), 0.3 * open.covariance(0, 0));
  }
}

// A disc lies on the ground from the start and is struck within the first interval: its contact from the start is no
// event, in the plan and in a run.
TEST(SceneFeedback, ContactsFromTheStartThatAreStruck) {
  Scene scene = OnTheGround(0, 0);
  scene.control.initial = {{0, 0}};
  scene.bodies.push_back({.name = "striker", .radius = 0.1, .mass = 1, .position = {0.02, 0.32}, .velocity = {0, -2}});
  const ScenePlan planned = PlanOf(scene);
  ASSERT_EQ(planned.reason, "");
  ASSERT_FALSE(planned.plan.events.empty());
  EXPECT_EQ(planned.plan.events[0].interval, 0);
  EXPECT_NE(planned.plan.events[0].c, 1) << "the first event is the impact of the two discs";
  const Regulator regulator = Regulate(planned);
  for (const Regulator* with : {static_cast<const Regulator*>(nullptr), &regulator}) {
    const ClosedLoopRun run = UndisturbedRun(scene, planned, with);
    EXPECT_TRUE(run.ok && run.as_planned) << (with != nullptr);
    EXPECT_LE((run.final_state - planned.plan.states.back()).norm(), 1e-9);
  }
}

// A disc in a corner, with another that falls onto it: all contacts come to rest together, and an error of 1e-8 leads
// to another motion than the linearization has. A single disc that bounces until it lies has no remark
// (DiscsThatComeToRest).
TEST(SceneFeedback, ContactsThatRestTogether) {
  Scene scene;
  scene.name = "corner";
  scene.duration = 0.6;
  scene.steps = 28;
  scene.gravity = Vec2d(0, -9.8);
  scene.bodies = {{.name = "low", .radius = 0.13, .mass = 1.3, .position = {0, 0.312}, .velocity = {0.1, -1.2}},
                  {.name = "high", .radius = 0.13, .mass = 1, .position = {0, 0.6}}};
  const double s = std::sqrt(0.5);
  scene.planes = {{.name = "right", .point = {0, 0}, .normal = {-s, s}},
                  {.name = "left", .point = {0, 0}, .normal = {s, s}}};
  scene.contact = {.restitution = 0.66, .friction = 0.9};
  scene.optimize = Optimize::kNone;
  const ScenePlan planned = PlanOf(scene);
  ASSERT_EQ(planned.reason, "");
  EXPECT_NE(planned.remark.find("come to rest together"), std::string::npos) << planned.remark;
  VectorXd change = VectorXd::Zero(planned.plan.states[0].size());
  change.head(4) << 1, -0.5, 0.7, 0.3;
  change *= 1e-8;
  Plan moved = planned.plan;
  moved.states[0] += change;
  const auto plant = MakePlant(Contact("event"), scene, planned.lengths);
  const ClosedLoopRun run = RunClosedLoop(moved, {}, {}, 1, 0, plant.get());
  for (const LinearInterval& interval : planned.linear.intervals) change = interval.A * change;
  EXPECT_GT((run.final_state - planned.plan.states.back() - change).norm(), 1e-3 * change.norm());
}

// A disc strikes two at once: any error decides which is first.
TEST(SceneFeedback, ImpactsAtTheSameTime) {
  Scene scene;
  scene.name = "tie";
  scene.duration = 1;
  scene.steps = 20;
  scene.bodies = {{.name = "s", .radius = 0.1, .mass = 1, .position = {-0.5, 0}, .velocity = {1, 0}},
                  {.name = "a", .radius = 0.1, .mass = 1, .position = {0, 0.1}},
                  {.name = "b", .radius = 0.1, .mass = 1, .position = {0, -0.1}}};
  scene.contact.restitution = 1;
  scene.optimize = Optimize::kNone;
  const ScenePlan planned = PlanOf(scene);
  ASSERT_EQ(planned.reason, "");
  EXPECT_NE(planned.remark.find("the order of the impacts of s, a and b"), std::string::npos) << planned.remark;
  const Covariance covariance = Propagate(planned.linear, {.initial = 1e-6 * MatrixXd::Identity(12, 12)});
  EXPECT_GE(covariance.change_probability, 0.5);
  EXPECT_NE(covariance.Warning(), "");
  ASSERT_FALSE(covariance.risks.empty());
  EXPECT_NEAR(covariance.risks[0].probability, 0.5, 1e-6);
}

// A row of discs that touch is struck: the impacts follow from each other, and nothing comes before another, unless an
// error of the row itself pushes its discs into each other.
TEST(SceneFeedback, ImpactsThatFollowFromEachOther) {
  Scene scene;
  scene.name = "row";
  scene.duration = 1;
  scene.steps = 20;
  scene.bodies = {{.name = "s", .radius = 0.1, .mass = 1, .position = {-0.75, 0}, .velocity = {1, 0}},
                  {.name = "a", .radius = 0.1, .mass = 1, .position = {-0.2, 0}},
                  {.name = "b", .radius = 0.1, .mass = 1, .position = {0, 0}}};
  scene.contact.restitution = 1;
  scene.optimize = Optimize::kNone;
  const ScenePlan planned = PlanOf(scene);
  ASSERT_EQ(planned.plan.events.size(), 2u);
  MatrixXd initial = MatrixXd::Zero(12, 12);
  initial.diagonal().head(4).setConstant(1e-8);
  EXPECT_LT(Propagate(planned.linear, {.initial = initial}).change_probability, 1e-6);
  const Covariance of_all = Propagate(planned.linear, {.initial = 1e-8 * MatrixXd::Identity(12, 12)});
  // The gap of the row is negative at the start, or when the row is struck: two normal numbers with this correlation.
  const double struck = 0.35, correlation = 1 / std::sqrt(1 + struck * struck);
  EXPECT_GE(of_all.change_probability, 0.5 + std::acos(correlation) / (2 * std::numbers::pi));
  EXPECT_NE(of_all.Warning().find("the gap of a and b falls below zero"), std::string::npos) << of_all.Warning();
}

// Discs whose impacts have nothing to do with each other, at about the same time: which is first does not matter.
TEST(SceneFeedback, ImpactsOfOthersMayChangePlaces) {
  Scene scene = BetweenWalls(1);
  scene.planes[0].point = Vec2d(0.4, 0);
  scene.bodies.push_back({.name = "other", .radius = 0.1, .mass = 1, .position = {-0.19, 1}, .velocity = {1, 0}});
  const ScenePlan planned = PlanOf(scene);
  const Noise noise{.initial = 1e-6 * MatrixXd::Identity(8, 8)};
  EXPECT_LT(Propagate(planned.linear, noise).change_probability, 1e-9);
  const auto plant = [&] { return MakePlant(Contact("event"), scene, planned.lengths); };
  const MonteCarlo runs = RunMonteCarlo(planned.plan, {}, noise, plant, {.samples = 100});
  EXPECT_EQ(runs.off_plan, 0);
}

// A disc passes another with a gap of 5 mm, at 0.6 s: it strikes it if errors across are larger.
TEST(SceneFeedback, NearMissesAndGrazes) {
  for (const double gap : {0.005, 0.0}) {
    Scene scene;
    scene.name = "pass";
    scene.duration = 1;
    scene.steps = 25;
    scene.bodies = {{.name = "a", .radius = 0.1, .mass = 1, .position = {-0.6, 0.2 + gap}, .velocity = {1, 0}},
                    {.name = "post", .radius = 0.1, .fixed = true, .position = {0, 0}}};
    scene.optimize = Optimize::kNone;
    const ScenePlan planned = PlanOf(scene);
    ASSERT_EQ(planned.reason, "");
    const Noise noise{.initial = Eigen::Matrix<double, 8, 1>{9e-6, 9e-6, 4e-6, 4e-6, 0, 0, 0, 0}.asDiagonal()};
    const double deviation = std::sqrt(9e-6 + 0.36 * 4e-6);
    const double expected = 0.5 * std::erfc(gap / deviation / std::numbers::sqrt2);
    const Covariance covariance = Propagate(planned.linear, noise);
    EXPECT_NEAR(covariance.change_probability, expected, 1e-3 * expected) << gap;
    EXPECT_NE(covariance.Warning().find("the gap of a and post falls below zero"), std::string::npos)
        << covariance.Warning();
    const auto plant = [&] { return MakePlant(Contact("event"), scene, planned.lengths); };
    const MonteCarlo runs = RunMonteCarlo(planned.plan, {}, noise, plant, {.samples = 2000, .threads = 2});
    EXPECT_NEAR(runs.off_plan / 2000.0, expected, 4 * std::sqrt(expected / 2000)) << gap;
  }
}

// The plan is the solution's motion on its own intervals: its loss is the exact loss, and its derivatives those of the
// exact motion.
TEST(SceneFeedback, IntervalsOfDifferentLengths) {
  const Scene scene = ProblemScene("two_balls");
  const std::vector<double> durations = {0.1, 0.25, 0, 0.15, 0.2, 0.3};
  std::vector<double> control;
  for (int k = 0; k < 6; ++k) control.insert(control.end(), {3.0 - k, 2.5 - 0.5 * k});
  const std::vector<double> initial = InitialState(scene);
  const ScenePlan planned = PlanScene(scene, initial, control, durations);
  ASSERT_EQ(planned.reason, "");
  const ExactRun exact = SimulateExactly(scene, initial, control, durations);
  ASSERT_TRUE(exact.ok) << exact.reason;
  ASSERT_EQ(planned.plan.num_intervals(), 6);
  ASSERT_EQ(planned.plan.events.size(), exact.events.size());
  for (int i = 0; i < 8; ++i) EXPECT_NEAR(planned.plan.states.back()[i], exact.end[i], 1e-12);
  const ClosedLoopRun run = UndisturbedRun(scene, planned);
  EXPECT_TRUE(run.as_planned);
  EXPECT_LE((run.final_state - planned.plan.states.back()).norm(), 1e-12);
  MatrixXd transition = MatrixXd::Identity(8, 8), by_first = MatrixXd::Zero(8, 2);
  for (std::size_t k = 0; k < 6; ++k) {
    const LinearInterval& at = planned.linear.intervals[k];
    transition = at.A * transition;
    by_first = k == 0 ? at.B : MatrixXd(at.A * by_first);
  }
  const auto end = [&](const std::vector<double>& x, const std::vector<double>& u) {
    const ExactRun moved = SimulateExactly(scene, x, u, durations);
    return VectorXd(Eigen::Map<const VectorXd>(moved.end.data(), 8));
  };
  for (int j = 0; j < 8; ++j) {
    std::vector<double> low = initial, high = initial;
    low[j] -= 1e-6;
    high[j] += 1e-6;
    EXPECT_LE((transition.col(j) - (end(high, control) - end(low, control)) / 2e-6).norm(), 1e-7) << j;
  }
  for (int j = 0; j < 2; ++j) {
    std::vector<double> low = control, high = control;
    low[j] -= 1e-5;
    high[j] += 1e-5;
    EXPECT_LE((by_first.col(j) - (end(initial, high) - end(initial, low)) / 2e-5).norm(), 1e-7) << j;
  }
  // The weights per unit of time of a regulator: an interval without length has no gain, and the same motion on other
  // intervals has about the same cost to go.
  const TrackingCost cost{.Q = {MatrixXd::Identity(8, 8)},
                          .R = 0.1 * MatrixXd::Identity(2, 2),
                          .QT = MatrixXd::Identity(8, 8),
                          .per_time = true};
  const Regulator regulator = Track(planned.linear, cost);
  EXPECT_EQ(regulator.gains[2].norm(), 0);
  EXPECT_TRUE(UndisturbedRun(scene, planned, &regulator).as_planned);
}

// Models that keep numbers of their own beside the state: their runs are those of their rollout.
TEST(SceneFeedback, PlantsWithLargerStates) {
  Scene scene = ProblemScene("two_balls");
  scene.steps = 60;
  const std::vector<double> initial = InitialState(scene), control = InitialControl(scene, scene.steps);
  const ScenePlan planned = PlanScene(scene, initial, control);
  const Regulator regulator = Regulate(planned);
  for (const char* model : {"pbd_brax", "compliant_brax", "pbd_warp", "lcp"}) {
    Scene steps = scene;  // one step of the model for each interval
    steps.steps *= FindContactModel({model})->grid_steps;
    const auto simulator = MakeSimulator({model}, steps, Precision::kDouble);
    ASSERT_TRUE(simulator->Rollout(initial, control)) << model;
    std::vector<double> end(simulator->state_size());
    simulator->GetState(60, end);
    const ClosedLoopRun open = UndisturbedRun(scene, planned, nullptr, model);
    ASSERT_TRUE(open.ok) << model;
    ASSERT_EQ(open.final_state.size(), 8) << model;
    for (int i = 0; i < 8; ++i) {
      EXPECT_EQ(open.final_state[i], end[i / 4 * simulator->body_size() + i % 4]) << model << ", " << i;
    }
    EXPECT_TRUE(UndisturbedRun(scene, planned, &regulator, model).ok) << model;
  }
}

// The scenes of the repository: their motions are planned, or refused with a reason.
TEST(SceneFeedback, ScenesOfTheProblems) {
  for (const char* name : {"back_spin",
                           "bank_shot",
                           "bounce_once",
                           "carrom_gate",
                           "carrom_pot",
                           "ground_wall",
                           "ground_wall_spin",
                           "multiple_collisions",
                           "post_shot",
                           "single_collision",
                           "two_balls"}) {
    const Scene scene = ProblemScene(name);
    const ScenePlan planned = PlanOf(scene);
    ASSERT_EQ(planned.reason, "") << name;
    const ClosedLoopRun run = UndisturbedRun(scene, planned);
    EXPECT_TRUE(run.ok && run.as_planned) << name;
    EXPECT_LE((run.final_state - planned.plan.states.back()).norm(), 1e-9) << name;
    const Eigen::Index n = planned.plan.states[0].size();
    const Covariance covariance = Propagate(planned.linear, {.initial = 1e-12 * MatrixXd::Identity(n, n)});
    EXPECT_TRUE(covariance.nodes.back().allFinite()) << name;
  }
}

}  // namespace
}  // namespace saltus
