// usage: gradient_cost <contact> <points>
// What the gradient of task 3 costs in C++, for python/bench/cost.py: one line of JSON with the time of one call, us of
// this thread, and of each gradient of a batch, us of CPU on one thread and of the clock on 1, 2, ... threads; and with
// that of one gradient of the SLIP hopper by all that may be free; and, us by the clock on 1, 2, ... threads, of each
// of the losses and gradients of many bouncing balls, whose heights and restitutions differ.
#include <glog/logging.h>
#include <tbb/info.h>

#include <array>
#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <deque>
#include <vector>

#include "base/parallel_for.h"
#include "control/hybrid_shooting.h"
#include "problems/hybrid/bouncing_ball.h"
#include "problems/hybrid/slip_hopper.h"
#include "saltus/control/batch.h"
#include "timing.h"

namespace saltus {
namespace {

constexpr int kRepeats = 3;

double ClockTime() {
  return std::chrono::duration<double>(std::chrono::steady_clock::now().time_since_epoch()).count();
}

double CallTime(const std::string& contact, const Scene& scene) {
  SingleShooting shooting(MakeSimulator(contact, scene, Precision::kDouble));
  std::vector<double> gradient(shooting.num_variables());
  double loss = 0;
  return TimeInTurns([&] { CHECK(shooting.Evaluate(shooting.initial_guess(), &loss, gradient.data())); })[0];
}

// The least time of a gradient of a batch by `now`.
template <typename Now>
double BatchTime(const std::string& contact, const Scene& scene, int count, int threads, const Now& now) {
  Batch batch(contact, scene, Precision::kDouble, threads);
  std::vector<double> points, losses(count);
  for (int i = 0; i < count; ++i)
    points.insert(points.end(), batch.initial_guess().begin(), batch.initial_guess().end());
  std::vector<double> gradients(points.size());
  double least = HUGE_VAL;
  for (int repeat = 0; repeat < kRepeats; ++repeat) {
    const double start = now();
    batch.Evaluate(points, losses, gradients);
    least = std::min(least, now() - start);
  }
  return least / count;
}

double HopperTime() {
  HybridProblem problem = SlipHopperProblem();
  problem.free = {.initial = {0, 1, 2, 3}, .parameters = {0, 1}, .duration = true};
  HybridShooting shooting(problem);
  std::vector<double> gradient(shooting.num_variables());
  double loss = 0;
  return TimeInTurns([&] { CHECK(shooting.Evaluate(shooting.initial_guess(), &loss, gradient.data())); })[0];
}

// The least time by the clock of a loss and gradient of a bouncing ball, of a batch of `count` on this many threads.
// Each ball has its own height and restitution, and chooses its integration steps by itself.
double BallTime(int count, int threads) {
  HybridProblem problem = BouncingBallProblem();
  problem.free = {.initial = {0}, .parameters = {1}};
  std::deque<HybridShooting> shootings;
  for (int i = 0; i < threads; ++i) shootings.emplace_back(problem).set_accurate(true);
  std::vector<double> losses(count), gradients(2 * count);
  double least = HUGE_VAL;
  for (int repeat = 0; repeat < kRepeats; ++repeat) {
    const double start = ClockTime();
    ParallelFor(threads, count, [&](int thread, int i) {
      const double part = static_cast<double>(i) / count;
      shootings[thread].simulator().ResetStepChoice();
      CHECK(shootings[thread].Evaluate(std::array{50 + 10 * part, 0.8 + 0.15 * part}, &losses[i], &gradients[2 * i]));
    });
    least = std::min(least, ClockTime() - start);
  }
  return least / count;
}

int Main(const std::string& contact, int count) {
  const Scene scene = ProblemScene("two_balls", 480);
  std::printf("{\"hopper\": %.4f, \"call\": %.4f, \"batch_cpu\": %.4f, \"batch\": [",
              1e6 * HopperTime(),
              1e6 * CallTime(contact, scene),
              1e6 * BatchTime(contact, scene, count, 1, ThreadTime));
  for (int threads = 1; threads <= tbb::info::default_concurrency(); ++threads) {
    std::printf("%s%.4f", threads > 1 ? ", " : "", 1e6 * BatchTime(contact, scene, count, threads, ClockTime));
  }
  std::printf("], \"balls\": [");
  for (int threads = 1; threads <= tbb::info::default_concurrency(); ++threads) {
    std::printf("%s%.4f", threads > 1 ? ", " : "", 1e6 * BallTime(count, threads));
  }
  std::printf("]}\n");
  return 0;
}

}  // namespace
}  // namespace saltus

int main(int argc, char** argv) {
  const int count = argc == 3 ? std::atoi(argv[2]) : 0;
  if (count <= 0 || saltus::FindContactModel(std::string(argv[1])) == nullptr) {
    std::fprintf(stderr, "usage: gradient_cost <contact> <points>\n");
    return 2;
  }
  return saltus::Main(argv[1], count);
}
