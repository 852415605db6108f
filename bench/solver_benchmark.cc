// What an iteration of a solver costs, in gradients: both are timed in the same run, in turns.
//
//   gradients_per_iteration   thread time from one callback to the next, by that of SingleShooting::Evaluate with
//   gradient gradient_us               the latter setup_in_gradients        time from the call to the first callback:
//   problem construction and first Jacobian
#include <benchmark/benchmark.h>
#include <glog/logging.h>

#include <ctime>

#include "saltus/control/single_shooting.h"
#include "saltus/dynamics/registry.h"
#include "saltus/io/scene_file.h"
#include "saltus/solve/solver.h"

namespace saltus {
namespace {

// Time of this thread, s: not disturbed by what else the machine does.
double Now() {
  timespec time;
  CHECK_EQ(clock_gettime(CLOCK_THREAD_CPUTIME_ID, &time), 0);
  return time.tv_sec + 1e-9 * time.tv_nsec;
}

Scene ProblemScene(const std::string& name, int steps) {
  Scene scene = std::get<Scene>(LoadSceneFile(SALTUS_SOURCE_DIR "/problems/" + name + ".yaml"));
  scene.steps = steps;
  return scene;
}

double TimeGradient(SingleShooting* shooting) {
  constexpr int kRepetitions = 50;
  std::vector<double> z = shooting->initial_guess(), gradient(z.size());
  double loss = 0;
  const double start = Now();
  for (int i = 0; i < kRepetitions; ++i) {
    z[0] += 1e-6;
    CHECK(shooting->Evaluate(z, &loss, gradient.data()));
    benchmark::DoNotOptimize(gradient.data());
  }
  return (Now() - start) / kRepetitions;
}

void Iteration(benchmark::State& state, const char* solver, const char* contact, const char* problem, int steps) {
  const Scene scene = ProblemScene(problem, steps);
  SingleShooting shooting(MakeSimulator(contact, scene, Precision::kDouble));
  double gradients = 0, setups = 0, iterations = 0;
  int solves = 0;
  for (auto _ : state) {
    double first = 0, last = 0;
    SolverOptions options{.iterations = 20};
    options.callback = [&](int iteration, double) {
      (iteration == 0 ? first : last) = Now();
      return true;
    };
    const double start = Now();
    const SolveReport report = Solve(solver, {scene, contact}, options);
    CHECK_GT(report.iterations, 0);
    setups += first - start;
    state.SetIterationTime((last - first) / report.iterations);
    iterations += (last - first) / report.iterations;
    gradients += TimeGradient(&shooting);
    ++solves;
  }
  state.counters["gradients_per_iteration"] = iterations / gradients;
  state.counters["setup_in_gradients"] = setups / gradients;
  state.counters["gradient_us"] = 1e6 * gradients / solves;
}

#define SALTUS_ITERATION(solver, contact, problem, steps) \
  BENCHMARK_CAPTURE(Iteration, solver / contact / problem / steps, #solver, #contact, #problem, steps)->UseManualTime()

SALTUS_ITERATION(ceres_lm, direct_toi, two_balls, 480);
SALTUS_ITERATION(ceres_lm, direct_toi, two_balls, 1000);
SALTUS_ITERATION(ceres_lm, compliant_warp, two_balls, 480);
SALTUS_ITERATION(ceres_lm, compliant_warp, two_balls, 1000);
SALTUS_ITERATION(ceres_lm, direct_toi, ground_wall, 288);
SALTUS_ITERATION(ceres_lm, direct_toi, multiple_collisions, 480);
SALTUS_ITERATION(ceres_lm, direct_toi, multiple_collisions, 1000);
SALTUS_ITERATION(ceres_lbfgs, direct_toi, two_balls, 480);
SALTUS_ITERATION(ceres_lbfgs, direct_toi, two_balls, 1000);
SALTUS_ITERATION(gd, direct_toi, two_balls, 480);
SALTUS_ITERATION(gd, direct_toi, two_balls, 1000);

}  // namespace
}  // namespace saltus
