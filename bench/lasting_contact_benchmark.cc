// Lasting contact: a step of a resting stack by exact events, alone and with its gradient; and a pile that falls and
// comes to rest.
//
//   Stack      20 to 160 discs; `per_disc` is relative to the stack of 20 in the same minute, 1 if growth is linear
//   Pile       50 to 1000 discs in 1000 steps; `per_disc` likewise, relative to the pile of 50
#include <benchmark/benchmark.h>

#include "physics/scene_generators.h"
#include "saltus/dynamics/registry.h"
#include "timing.h"

namespace saltus {
namespace {

constexpr int kSmallest = 20;

Scene Stack(int discs, double friction) {
  Scene scene;
  scene.name = "stack";
  scene.duration = 0.01;
  scene.steps = 1;
  scene.gravity = {0, -9.8};
  scene.contact.restitution = 0.5;
  scene.contact.friction = friction;
  scene.planes = {{"ground", {0, 0}, {0, 1}}};
  for (int i = 0; i < discs; ++i) {
    scene.bodies.push_back(
        {.name = "disc" + std::to_string(i), .radius = 0.1, .mass = 1, .position = {0, 0.1 * (2 * i + 1)}});
  }
  return scene;
}

// A step and, if asked for, the gradient of one number by all that there is.
class Step {
 public:
  Step(int discs, double friction)
      : scene_(Stack(discs, friction)),
        simulator_(MakeSimulator("event", scene_, Precision::kDouble)),
        initial_(InitialState(scene_)),
        cotangent_(simulator_->state_size(), 1.0) {}
  void Run(bool with_gradient) const {
    CHECK(simulator_->Rollout(initial_, {}));
    if (!with_gradient) return;
    Sensitivity sensitivity;
    simulator_->Adjoint(cotangent_, /*with_parameters=*/true, &sensitivity);
    benchmark::DoNotOptimize(sensitivity.initial.data());
  }

 private:
  Scene scene_;
  std::unique_ptr<Simulator> simulator_;
  std::vector<double> initial_, cotangent_;
};

void BM_Stack(benchmark::State& state) {
  const int discs = static_cast<int>(state.range(0));
  const double friction = state.range(1) == 0 ? 0.0 : 0.5;
  const Step small(kSmallest, friction), step(discs, friction);
  for (auto _ : state) {
    const auto [first, plain, gradient] =
        TimeInTurns([&] { small.Run(true); }, [&] { step.Run(false); }, [&] { step.Run(true); });
    state.counters["step_us"] = 1e6 * plain;
    state.counters["gradient_us"] = 1e6 * gradient;
    state.counters["ratio"] = gradient / plain;
    state.counters["per_disc"] = gradient / first * kSmallest / discs;
  }
}
BENCHMARK(BM_Stack)->ArgsProduct({{20, 40, 80, 160}, {0, 1}})->ArgNames({"discs", "friction"})->Iterations(1);

double SecondsOfPile(int discs) {
  const Scene scene = FallingPile({.discs = discs}, 1);
  const std::unique_ptr<Simulator> simulator = MakeSimulator("event", scene, Precision::kDouble);
  const double start = ThreadTime();
  CHECK(simulator->Rollout(InitialState(scene), InitialControl(scene, scene.steps)));
  return ThreadTime() - start;
}

void BM_Pile(benchmark::State& state) {
  constexpr int kFew = 50;
  const int discs = static_cast<int>(state.range(0));
  for (auto _ : state) {
    const double first = SecondsOfPile(kFew), all = SecondsOfPile(discs);
    state.counters["seconds"] = all;
    state.counters["per_disc"] = all / first * kFew / discs;
  }
}
BENCHMARK(BM_Pile)->ArgsProduct({{50, 200, 1000}})->ArgNames({"discs"})->Iterations(1);

}  // namespace
}  // namespace saltus
