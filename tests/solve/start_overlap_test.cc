// Positions that are optimized stay those of discs that do not overlap, whatever the solver.
#include <gmock/gmock.h>

#include <algorithm>
#include <cmath>

#include "saltus/control/batch.h"
#include "saltus/control/single_shooting.h"
#include "saltus/simulate/exact_run.h"
#include "saltus/simulate/registry.h"
#include "saltus/solve/solver.h"

namespace saltus {
namespace {

using testing::HasSubstr;

// The first disc pushes the second: the nearer it starts, the further the second gets.
Scene Pushed(double target) {
  Scene scene;
  scene.name = "overlap";
  scene.duration = 1;
  scene.steps = 10;
  scene.bodies.resize(2);
  scene.bodies[0] = {.name = "a", .radius = 0.2, .mass = 1};
  scene.bodies[0].position = {0.3, 0};
  scene.bodies[0].velocity = {1, 0};
  scene.bodies[1] = {.name = "b", .radius = 0.2, .mass = 1};
  scene.bodies[1].position = {1, 0};
  scene.objective.terminal = {{.body = 1, .target = {target, 0}}};
  scene.optimize = Optimize::kPosition;
  scene.free = {0};
  return scene;
}

// A disc that would start below the floor to end at its target.
Scene Falling() {
  Scene scene;
  scene.name = "floor";
  scene.duration = 0.5;
  scene.steps = 10;
  scene.gravity = {0, -1};
  scene.bodies.resize(1);
  scene.bodies[0] = {.name = "a", .radius = 0.1, .mass = 1};
  scene.bodies[0].position = {0, 1};
  scene.bodies[0].velocity = {0, 1};
  scene.planes = {{"floor", {0, 0}, {0, 1}}};
  scene.objective.terminal = {{.body = 0, .target = {0, 0.2}}};
  scene.optimize = Optimize::kPosition;
  scene.free = {0};
  return scene;
}

double GapAtStart(const Scene& scene, const std::vector<double>& initial) {
  const Vec2d a(initial[0], initial[1]);
  if (scene.bodies.size() == 1) return a[1] - scene.bodies[0].radius;
  return (a - Vec2d(initial[4], initial[5])).norm() - scene.bodies[0].radius - scene.bodies[1].radius;
}

TEST(StartOverlap, NoSolverEndsWithDiscsThatOverlap) {
  int tried = 0;
  for (const Scene& scene : {Pushed(2.3), Pushed(1.7), Falling()}) {
    for (const SolverEntry& solver : AllSolvers()) {
      SolverOptions options;
      options.limits.iterations = 100;
      options.descent.learning_rate = 0.1;
      const SolveReport report = Solve(solver.name, {scene, "event"}, options);
      if (report.termination == Termination::kNotApplicable) continue;
      ++tried;
      EXPECT_GT(GapAtStart(scene, report.solution.initial_state), -1e-7) << solver.name << " " << scene.name;
      const ExactRun run =
          SimulateExactly(scene, report.solution.initial_state, report.solution.control, report.solution.durations);
      EXPECT_TRUE(run.ok) << solver.name << " " << scene.name << ": " << run.reason;
    }
  }
  EXPECT_GE(tried, 12);
}

TEST(StartOverlap, LossesAndExactRunsRefuseThem) {
  const Scene scene = Pushed(2.3);
  SingleShooting shooting(MakeSimulator("event", scene, Precision::kDouble), SingleShooting::Variables::kOptimized);
  double loss = 0;
  EXPECT_TRUE(shooting.Evaluate(std::vector<double>{0.5, 0}, &loss, nullptr));
  EXPECT_FALSE(shooting.Evaluate(std::vector<double>{0.7, 0}, &loss, nullptr));
  EXPECT_THAT(shooting.FailureReason(), testing::ContainsRegex("overlap of 0\\.(1|0999)[0-9]* m with bodies.0."));
  Batch batch("event", scene, Precision::kDouble, 1);
  std::vector<double> losses(2);
  batch.Evaluate(std::vector<double>{0.5, 0, 0.7, 0}, losses, {});
  EXPECT_TRUE(std::isfinite(losses[0]));
  EXPECT_TRUE(std::isnan(losses[1]));
  std::vector<double> initial = InitialState(scene);
  initial[0] = 0.7;
  const ExactRun run = SimulateExactly(scene, initial, {}, {});
  EXPECT_FALSE(run.ok);
  EXPECT_THAT(run.reason, HasSubstr("overlap"));
}

}  // namespace
}  // namespace saltus
