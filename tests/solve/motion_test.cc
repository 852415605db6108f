// Motions under contact models and in exact dynamics, and controls on another time grid, against motion by hand.
#include <gmock/gmock.h>

#include <algorithm>
#include <cmath>

#include "saltus/simulate/registry.h"
#include "scene/scene_generators.h"
#include "solve/checked_run.h"
#include "solve/control_guess.h"
#include "test_scenes.h"

namespace saltus {
namespace {

using testing::HasSubstr;

// One ball that falls on the ground and bounces with e = 1/2: t = sqrt(2 h / g) and the arcs are known.
Scene FallingBall() {
  Scene scene;
  scene.name = "falls";
  scene.duration = 1;
  scene.steps = 7;
  scene.gravity = {0, -8};
  scene.bodies = {{.name = "ball", .radius = 0.25, .mass = 2, .position = {0, 1.25}, .velocity = {3, 0}}};
  scene.planes = {{.name = "ground", .point = {0, 0}, .normal = {0, 1}}};
  scene.contact = {.restitution = 0.5, .friction = 0};
  scene.optimize = Optimize::kNone;
  return scene;
}

// The cubic through two states, as replays draw it.
double CubicAt(double t, double t0, double p0, double v0, double t1, double p1, double v1) {
  const double h = t1 - t0, s = (t - t0) / h;
  return (1 + 2 * s) * (1 - s) * (1 - s) * p0 + s * (1 - s) * (1 - s) * h * v0 + s * s * (3 - 2 * s) * p1 +
         s * s * (s - 1) * h * v1;
}

TEST(Motion, ExactMotionHasEachImpactTwiceAndArcsBetween) {
  const Scene scene = FallingBall();
  const Motion motion = SimulateExactMotion(scene, {InitialState(scene), {}, {}});
  ASSERT_EQ(motion.failure, "");
  ASSERT_TRUE(motion.arcs);
  // Falls 1 m in 0.5 s; the bounce at 2 m/s lasts 0.5 s, to the end.
  ASSERT_GE(motion.touches.size(), 1u);
  EXPECT_NEAR(motion.touches[0].begin, 0.5, 1e-12);
  EXPECT_NEAR(motion.touches[0].impulse[1], 2 * (4 + 2), 1e-5);
  EXPECT_NEAR(motion.touches[0].impulse[0], 0, 1e-12);
  const auto instant =
      std::find_if(motion.times.begin(), motion.times.end(), [](double time) { return std::abs(time - 0.5) < 1e-9; });
  ASSERT_LT(instant + 1, motion.times.end());
  const size_t row = instant - motion.times.begin();
  EXPECT_EQ(motion.times[row], motion.times[row + 1]);
  EXPECT_NEAR(motion.states[4 * row + 3], -4, 1e-9);
  EXPECT_NEAR(motion.states[4 * row + 7], 2, 1e-5);
  EXPECT_EQ(motion.states[4 * row + 1], motion.states[4 * row + 5]);
  for (size_t k = 0; k + 1 < motion.times.size(); ++k) {
    const double t0 = motion.times[k], t1 = motion.times[k + 1], t = 0.3 * t0 + 0.7 * t1;
    if (t1 == t0) continue;
    const double* x = &motion.states[4 * k];
    const double exact = t < 0.5 ? 1.25 - 4 * t * t : 0.25 + 2 * (t - 0.5) - 4 * (t - 0.5) * (t - 0.5);
    EXPECT_NEAR(CubicAt(t, t0, x[1], x[3], t1, x[5], x[7]), exact, 1e-6) << t;
    EXPECT_NEAR(CubicAt(t, t0, x[0], x[2], t1, x[4], x[6]), 3 * t, 1e-12) << t;
  }
}

// With v' = g - k v, v(t) = -(g / k) (1 - e^{-k t}) from rest, so that the speeds before and after the impact follow
// from its time, and the height from their integral. A paddle far away moves all along.
TEST(Motion, ImpactsBesideForcesAndPathsHaveTheStateBeforeThem) {
  Scene scene = FallingBall();
  const double k = 0.6, g = 8;
  scene.forces = {Drag{.body = 0, .linear = k * scene.bodies[0].mass}};
  for (const bool has_path : {false, true}) {
    if (has_path) {
      scene.bodies.push_back({.name = "paddle", .radius = 0.1, .fixed = true, .position = {9, 9}});
      scene.bodies[1].path = PrescribedMotion{.times = {0, 0.5, 1}, .positions = {{9, 9}, {9.5, 9}, {9, 9}}};
    }
    const size_t width = 4 * scene.bodies.size();
    const Motion motion = SimulateExactMotion(scene, {InitialState(scene), {}, {}});
    ASSERT_EQ(motion.failure, "");
    ASSERT_FALSE(motion.touches.empty());
    const double time = motion.touches[0].begin, speed = g / k * (1 - std::exp(-k * time));
    EXPECT_NEAR(g / k * time - speed / k, 1, 1e-9);  // it falls by 1 m
    EXPECT_NEAR(motion.touches[0].impulse[1], 2 * 1.5 * speed, 1e-5);
    const size_t row = std::ranges::lower_bound(motion.times, time - 1e-9) - motion.times.begin();
    ASSERT_EQ(motion.times[row], motion.times[row + 1]);
    EXPECT_NEAR(motion.states[width * row + 1], 0.25, 1e-12);
    EXPECT_NEAR(motion.states[width * row + 3], -speed, 1e-9);
    EXPECT_NEAR(motion.states[width * (row + 1) + 3], 0.5 * speed, 1e-5);
  }
}

// Only discs that touch are flown to an instant with contacts: the others, pushed ones too, must be where one step of
// the whole scene to that time takes them.
TEST(Motion, ManyDiscsAreWhereTheWholeSceneHasThem) {
  Scene scene = GasInABox({.discs = 25, .restitution = 0.9, .duration = 0.5, .steps = 8}, 3);
  scene.gravity = {0.5, -2};
  for (int i = 0; i < 25; ++i) scene.bodies[i].mass = 0.5 + 0.1 * i;
  scene.control = {{4, 11}, {{1, 2}, {-3, 0.5}}};
  const MotionInput input{InitialState(scene), InitialControl(scene, scene.steps), {}};
  const Motion motion = SimulateExactMotion(scene, input);
  ASSERT_EQ(motion.failure, "");
  const size_t width = 4 * scene.bodies.size();
  std::vector<double> end(width);
  int instants = 0;
  for (size_t k = 0; k + 1 < motion.times.size(); ++k) {
    if (motion.times[k] != motion.times[k + 1]) continue;
    ++instants;
    Scene until = scene;
    until.steps = 1;
    until.duration = motion.times[k];
    const std::unique_ptr<Simulator> whole = MakeSimulator("event", until, Precision::kDouble);
    ASSERT_TRUE(whole->Rollout(input.initial, InitialControl(until, 1))) << whole->FailureReason();
    whole->GetState(1, end);
    for (size_t i = 0; i < width; ++i) {
      ASSERT_NEAR(motion.states[k * width + i], end[i], 1e-8) << motion.times[k] << " s, entry " << i;
    }
  }
  EXPECT_GT(instants, 20);
}

// Symplectic Euler by hand, and the contact's impulse: the sum of what is not gravity.
TEST(Motion, MotionUnderAModelIsItsSteps) {
  Scene scene = FallingBall();
  scene.steps = 100;
  const Motion motion = SimulateMotion(scene, "direct", {InitialState(scene), {}, {}});
  ASSERT_EQ(motion.times.size(), 101u);
  EXPECT_FALSE(motion.arcs);
  double y = 1.25, v = 0;
  for (int k = 1; k <= 40; ++k) {
    v += 0.01 * -8;
    y += 0.01 * v;
    EXPECT_NEAR(motion.states[4 * k + 1], y, 1e-12);
    EXPECT_NEAR(motion.times[k], 0.01 * k, 1e-15);
  }
  ASSERT_GE(motion.touches.size(), 1u);
  const double gained = 2 * (motion.states[4 * 100 + 3] + 8);
  double impulse = 0;
  for (const TouchSpan& touch : motion.touches) impulse += touch.impulse[1];
  EXPECT_NEAR(impulse, gained, 1e-9);
}

TEST(Motion, LongMotionsAreThinnedAndKeepTheirEnds) {
  const Scene scene = FallingBall();
  Scene fine = scene;
  fine.steps = 1000;
  const Motion all = SimulateExactMotion(fine, {InitialState(fine), {}, {}});
  const Motion few = SimulateExactMotion(fine, {InitialState(fine), {}, {}}, {.most_nodes = 11});
  EXPECT_LE(few.times.size(), 14u);
  EXPECT_EQ(few.times.back(), all.times.back());
  EXPECT_TRUE(std::equal(few.states.end() - 4, few.states.end(), all.states.end() - 4));
  const Motion none = SimulateExactMotion(fine, {InitialState(fine), {}, {}}, {.most_bytes = 1000});
  EXPECT_THAT(none.failure, HasSubstr("limit"));
}

TEST(Motion, MeansOverStepsKeepImpulses) {
  const ControlGuess thirds{{1, 0, 4, 0, -2, 0}, {}};
  EXPECT_EQ(MeanOverSteps(thirds, 2, 3), thirds.control);
  const std::vector<double> halves = MeanOverSteps(thirds, 2, 2);
  EXPECT_NEAR(halves[0], (1 * 2 + 4) / 3.0, 1e-15);
  EXPECT_NEAR(halves[2], (4 - 2 * 2) / 3.0, 1e-15);
  EXPECT_THAT(MeanOverSteps(thirds, 2, 6), testing::ElementsAre(1, 0, 1, 0, 4, 0, 4, 0, -2, 0, -2, 0));
  const ControlGuess uneven{{1, 0, 4, 0, 7, 7}, {0.25, 0.75, 0}};
  EXPECT_THAT(MeanOverSteps(uneven, 2, 4), testing::ElementsAre(1, 0, 4, 0, 4, 0, 4, 0));
}

// Angular velocities are variables of solvers, of which there are none here.
TEST(SimulateAndCheck, TakesScenesWhoseSpinIsFree) {
  const Scene scene = ProblemScene("ground_wall_spin");
  ASSERT_FALSE(scene.free_spin.empty());
  for (const char* contact : {"direct", "event", "compliant_warp"}) {
    if (!ReasonNotApplicable(contact, scene).empty()) continue;
    const CheckedRun run = SimulateAndCheck({scene, contact}, std::nullopt, nullptr);
    EXPECT_TRUE(run.simulated) << contact << ": " << run.report.reason;
  }
}

}  // namespace
}  // namespace saltus
