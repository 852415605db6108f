// Lasting contact: a resting stack under exact events, and a pile that falls and comes to rest.
//
//   Stack      a step, alone and with its gradient, 20 to 160 discs; `per_disc` is relative to the stack of 20 in the
//              same minute, 1 if growth is linear
//   Pile       50 to 1000 discs in 1000 steps, the mean of several piles; `per_disc` likewise, relative to 50 discs
//   Rest       every further step in which nothing moves, relative to the first, alone and with the gradient
//   Audit      that of `event` on 20 discs, s by the clock on all cores and of CPU time
#include <benchmark/benchmark.h>

#include <algorithm>
#include <chrono>

#include "base/parallel_for.h"
#include "saltus/audit/audit.h"
#include "saltus/simulate/registry.h"
#include "scene/scene_generators.h"
#include "timing.h"

namespace saltus {
namespace {

constexpr int kSmallest = 20;

Scene Stack(int discs, double friction, int steps) {
  Scene scene;
  scene.name = "stack";
  scene.duration = 0.01 * steps;
  scene.steps = steps;
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

// Steps and, if asked for, the gradient of one number by all that there is.
class Steps {
 public:
  Steps(int discs, double friction, int steps)
      : scene_(Stack(discs, friction, steps)),
        simulator_(MakeSimulator("event", scene_, Precision::kDouble)),
        initial_(InitialState(scene_)),
        cotangent_(simulator_->state_size(), 1.0) {}
  void Run(bool with_gradient) {
    // Elsewhere each time, so that nothing is known of it.
    for (int i = 0; i < scene_.num_bodies(); ++i) initial_[4 * i] += 1e-3;
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
  Steps small(kSmallest, friction, 1), step(discs, friction, 1);
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

// The mean of several piles, as their motion is chaotic, and the work with it.
double SecondsOfPile(int discs) {
  const int piles = std::max(1, 400 / discs);
  double seconds = 0;
  for (int seed = 1; seed <= piles; ++seed) {
    const Scene scene = FallingPile({.discs = discs}, seed);
    const std::unique_ptr<Simulator> simulator = MakeSimulator("event", scene, Precision::kDouble);
    const double start = ThreadTime();
    CHECK(simulator->Rollout(InitialState(scene), InitialControl(scene, scene.steps)));
    seconds += (ThreadTime() - start) / piles;
  }
  return seconds;
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

void BM_Rest(benchmark::State& state) {
  const int discs = static_cast<int>(state.range(0));
  const double friction = state.range(1) == 0 ? 0.0 : 0.5;
  constexpr int kFurther = 100;
  Steps one(discs, friction, 1), many(discs, friction, 1 + kFurther);
  for (auto _ : state) {
    const auto [first, first_gradient, all, all_gradient] =
        TimeInTurns([&] { one.Run(false); }, [&] { one.Run(true); }, [&] { many.Run(false); }, [&] { many.Run(true); });
    state.counters["further_us"] = 1e6 * (all - first) / kFurther;
    state.counters["further_gradient_us"] = 1e6 * (all_gradient - first_gradient) / kFurther;
    state.counters["ratio"] = (all - first) / kFurther / first;
    state.counters["ratio_gradient"] = (all_gradient - first_gradient) / kFurther / first_gradient;
  }
}
BENCHMARK(BM_Rest)->ArgsProduct({{20, 80}, {0, 1}})->ArgNames({"discs", "friction"})->Iterations(1);

void BM_Audit(benchmark::State& state) {
  Scene scene = Stack(kSmallest, state.range(0) == 0 ? 0.0 : 0.5, 240);
  scene.duration = 1;
  scene.contact.restitution = 0;
  scene.objective.terminal = {{.body = kSmallest - 1, .quantity = TerminalTerm::Quantity::kPosition}};
  for (auto _ : state) {
    const std::clock_t work = std::clock();
    const auto start = std::chrono::steady_clock::now();
    const std::optional<ModelGradient> exact = ComputeExactGradient(scene);
    CHECK(exact);
    const ModelAudit audit =
        AuditModel("event", scene, Precision::kDouble, exact, {.threads = NumThreads(/*threads=*/0)});
    CHECK(audit.verdict == Verdict::kRight);
    state.counters["seconds"] = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
    state.counters["cpu_seconds"] = static_cast<double>(std::clock() - work) / CLOCKS_PER_SEC;
  }
}
BENCHMARK(BM_Audit)->Arg(0)->Arg(1)->ArgName("friction")->Iterations(1);

}  // namespace
}  // namespace saltus
