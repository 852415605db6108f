// The cost of feedback on two balls with 480 steps, beside a gradient of the loss: the linearization of the motion, the
// gains of the regulator about it, and the propagation of a covariance in closed loop.
#include <benchmark/benchmark.h>
#include <glog/logging.h>

#include "saltus/control/single_shooting.h"
#include "saltus/feedback/covariance.h"
#include "saltus/feedback/regulator.h"
#include "saltus/scene/scene_file.h"
#include "saltus/simulate/registry.h"

namespace saltus {
namespace {

struct TwoBalls {
  TwoBalls() : motion(MakeSimulator({"event"}, ReadScene(), Precision::kDouble)) {
    control = InitialControl(motion->scene(), motion->num_steps());
    CHECK(motion->Rollout(InitialState(motion->scene()), control)) << motion->FailureReason();
    linear = Linearize(*motion, control);
    const int n = motion->state_size(), m = motion->control_width();
    cost = {.Q = {Eigen::MatrixXd::Identity(n, n)},
            .R = Eigen::MatrixXd::Identity(m, m),
            .QT = Eigen::MatrixXd::Identity(n, n)};
  }
  static Scene ReadScene() { return std::get<Scene>(LoadSceneFile(SALTUS_SOURCE_DIR "/problems/two_balls.yaml")); }

  std::unique_ptr<Simulator> motion;
  std::vector<double> control;
  LinearMotion linear;
  TrackingCost cost;
};

// The unit of the others: a loss with its gradient.
void BM_Gradient(benchmark::State& state) {
  SingleShooting shooting(MakeSimulator({"event"}, TwoBalls::ReadScene(), Precision::kDouble));
  const std::vector<double> z = shooting.initial_guess();
  std::vector<double> gradient(z.size());
  double loss = 0;
  for (auto _ : state) benchmark::DoNotOptimize(shooting.Evaluate(z, &loss, gradient.data()));
}
BENCHMARK(BM_Gradient)->Unit(benchmark::kMillisecond);

void BM_Linearize(benchmark::State& state) {
  const TwoBalls balls;
  for (auto _ : state) benchmark::DoNotOptimize(Linearize(*balls.motion, balls.control));
}
BENCHMARK(BM_Linearize)->Unit(benchmark::kMillisecond);

void BM_Gains(benchmark::State& state) {
  const TwoBalls balls;
  for (auto _ : state) benchmark::DoNotOptimize(Track(balls.linear, balls.cost));
}
BENCHMARK(BM_Gains)->Unit(benchmark::kMillisecond);

void BM_Propagate(benchmark::State& state) {
  const TwoBalls balls;
  const Regulator regulator = Track(balls.linear, balls.cost);
  const Noise noise{.initial = 1e-6 * Eigen::MatrixXd::Identity(8, 8)};
  for (auto _ : state) benchmark::DoNotOptimize(Propagate(balls.linear, noise, &regulator));
}
BENCHMARK(BM_Propagate)->Unit(benchmark::kMillisecond);

}  // namespace
}  // namespace saltus
