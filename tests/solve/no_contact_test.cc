// Optima of a disc that goes around a fixed one without touching it, at any number of intervals.
//
// With forces that change linearly in time on both sides of the touch, the least effort has a closed form but for two
// numbers, the time and the place of the touch: the place of least effort at the time of most, as the discs are to be
// apart at every time. Forces that are constant on K intervals cost T^2 / (12 K^2) times the integral of their rate
// squared more, to second order.
#include <gmock/gmock.h>

#include <cmath>

#include "saltus/control/contact_sequence.h"
#include "saltus/scene/scene_file.h"
#include "saltus/simulate/exact_run.h"
#include "saltus/solve/solver.h"

namespace saltus {
namespace {

constexpr double kDuration = 2, kDistance = 0.4;

Scene Around(int steps, double height, double radius = 0.3) {
  Scene scene;
  scene.name = "around";
  scene.duration = kDuration;
  scene.steps = steps;
  scene.bodies.resize(2);
  scene.bodies[0] = {.name = "ball", .radius = 0.1, .mass = 1};
  scene.bodies[0].position = {-1, height};
  scene.bodies[1] = {.name = "post", .radius = radius, .mass = 1, .fixed = true};
  scene.control = {.bodies = {0}, .initial = {Vec2d(0, 0)}, .max = {4}};
  scene.no_contact = {{.a = 0, .b = 1}};
  scene.objective.terminal = {{.body = 0, .target = {1, 0}, .hard = true},
                              {.body = 0, .quantity = TerminalTerm::Quantity::kVelocity, .hard = true}};
  scene.objective.effort = 1;
  scene.optimize = Optimize::kControl;
  return scene;
}

// Two cubics from rest at `from` over `via` at `time` to rest at `to`, with one velocity there: the integrals of the
// squares of acceleration and of its rate, the first as small as possible.
struct Effort {
  double force = 0, rate = 0;
};
Effort EffortOf(const Vec2d& from, const Vec2d& via, const Vec2d& to, double time) {
  Effort effort;
  for (int j = 0; j < 2; ++j) {
    const double h[2] = {time, kDuration - time}, d[2] = {via[j] - from[j], to[j] - via[j]};
    const double speed = 1.5 * (d[0] / (h[0] * h[0]) + d[1] / (h[1] * h[1])) / (1 / h[0] + 1 / h[1]);
    for (int i = 0; i < 2; ++i) {
      effort.force +=
          12 * d[i] * d[i] / std::pow(h[i], 3) - 12 * d[i] * speed / (h[i] * h[i]) + 4 * speed * speed / h[i];
      const double rate = 6 * speed / (h[i] * h[i]) - 12 * d[i] / std::pow(h[i], 3);
      effort.rate += h[i] * rate * rate;
    }
  }
  return effort;
}

// Below the post, by golden sections in each of the two numbers: a saddle.
Effort LeastEffort(double height) {
  const auto least = [](double begin, double end, const auto& of) {
    constexpr double kGolden = 0.6180339887498949;
    for (int i = 0; i < 80; ++i) {
      const double left = end - kGolden * (end - begin), right = begin + kGolden * (end - begin);
      (of(left) < of(right) ? end : begin) = of(left) < of(right) ? right : left;
    }
    return 0.5 * (begin + end);
  };
  const auto at = [&](double angle, double time) {
    return EffortOf({-1, height}, kDistance * Vec2d(std::sin(angle), -std::cos(angle)), {1, 0}, time);
  };
  const auto best_angle = [&](double time) {
    return least(-0.5, 0.5, [&](double angle) { return at(angle, time).force; });
  };
  const double time = least(0.9, 1.1, [&](double t) { return -at(best_angle(t), t).force; });
  return at(best_angle(time), time);
}

double LossOn(int steps, double height) {
  const Effort effort = LeastEffort(height);
  return effort.force + kDuration * kDuration / (12.0 * steps * steps) * effort.rate;
}

// The touch lies on a node of an even number of intervals, and inside an interval of an odd one.
TEST(NoContact, IsKeptAtAnyNumberOfIntervals) {
  for (const int steps : {15, 16, 20, 31, 59, 60, 75}) {
    const SolveReport report = Solve("ceres_phases", {Around(steps, -0.02), "event"}, {});
    EXPECT_EQ(report.termination, Termination::kConverged) << steps << ": " << report.reason;
    const double expected = LossOn(steps, -0.02), quadratic = expected - LeastEffort(-0.02).force;
    EXPECT_NEAR(report.solution.loss, expected, 0.1 * quadratic + 1e-6) << steps;
    EXPECT_LE(report.solution.violation, 1e-7) << steps;
  }
  // By another method, on 60 intervals (SLSQP).
  EXPECT_NEAR(LossOn(60, -0.02), 9.65673, 1e-3);
}

TEST(NoContact, TheOptimumIsRecognisedThoughThePairStaysAMarginApart) {
  const SolveReport report = Solve("ceres_phases", {Around(60, -0.1), "event"}, {});
  EXPECT_EQ(report.termination, Termination::kConverged) << report.reason;
  EXPECT_NEAR(report.solution.loss, 8.960996, 1e-4);
  ASSERT_TRUE(report.certificate);
  EXPECT_NE(report.certificate->verdict, Certificate::Verdict::kNotStationary) << report.certificate->reason;
}

// The optimum around a larger post is a guess that meets all constraints of the smaller one.
TEST(NoContact, AFeasibleGuessIsImproved) {
  for (const int steps : {30, 40}) {
    const SolveReport wide = Solve("ceres_phases", {Around(steps, -0.02, 0.4), "event"}, {});
    ASSERT_EQ(wide.termination, Termination::kConverged) << wide.reason;
    ASSERT_GT(wide.solution.loss, 11);
    SolverOptions options;
    options.guess = ControlGuess{wide.solution.control, wide.solution.durations};
    const SolveReport report = Solve("ceres_phases", {Around(steps, -0.02), "event"}, options);
    EXPECT_EQ(report.termination, Termination::kConverged) << steps << ": " << report.reason;
    EXPECT_NEAR(report.solution.loss, LossOn(steps, -0.02), 1e-2) << steps;
  }
}

}  // namespace
}  // namespace saltus
