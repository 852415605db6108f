// Time from a scene to its solution on one core, problem construction included: task 3 on 480 steps along its collision
// sequence, beside the 1000 gradient steps of the paper. gap: exact loss less the optimum over all controls.
#include <benchmark/benchmark.h>
#include <glog/logging.h>

#include "saltus/scene/scene_file.h"
#include "saltus/simulate/exact_run.h"
#include "saltus/solve/solver.h"

namespace saltus {
namespace {

constexpr double kOptimum = 1.396542160123197;  // data/exact_references.json

void TimeToSolution(benchmark::State& state, const char* solver, int steps) {
  Scene scene = std::get<Scene>(LoadSceneFile(SALTUS_SOURCE_DIR "/problems/two_balls.yaml"));
  scene.steps = steps;
  SolveReport report;
  for (auto _ : state) report = Solve(solver, {scene, "event"}, {.iterations = 1000, .learning_rate = 10});
  CHECK(!report.losses.empty()) << report.reason;
  const ExactRun exact = SimulateExactly(scene, report.initial_state, report.control, report.durations);
  state.counters["iterations_needed"] = report.iterations;
  state.counters["gap"] = exact.loss - kOptimum;
}

BENCHMARK_CAPTURE(TimeToSolution, hmp / 480, "hmp", 480)->Unit(benchmark::kMillisecond);
BENCHMARK_CAPTURE(TimeToSolution, ceres_event / 480, "ceres_event", 480)->Unit(benchmark::kMillisecond);
BENCHMARK_CAPTURE(TimeToSolution, ceres_event / 4800, "ceres_event", 4800)->Unit(benchmark::kMillisecond);
BENCHMARK_CAPTURE(TimeToSolution, ceres_phases / 480, "ceres_phases", 480)->Unit(benchmark::kMillisecond);
BENCHMARK_CAPTURE(TimeToSolution, ceres_phases / 1000, "ceres_phases", 1000)->Unit(benchmark::kMillisecond);
BENCHMARK_CAPTURE(TimeToSolution, ceres_phases / 4800, "ceres_phases", 4800)->Unit(benchmark::kMillisecond);
BENCHMARK_CAPTURE(TimeToSolution, mode_search / 480, "mode_search", 480)->Unit(benchmark::kMillisecond);
BENCHMARK_CAPTURE(TimeToSolution, gd / 480, "gd", 480)->Unit(benchmark::kMillisecond);

}  // namespace
}  // namespace saltus
