// Motions of mechanical systems beside those of Siconos' event-driven integrator (EventDriven with LsodarOSI) on the
// same problems, in turns. There is no friction, which that integrator does not support.
//
//   TumblingBoxes/n, RestingBoxes/n   n boxes that bounce on the ground, or rest on two corners each
//   SlidingDoublePendulum             its tip slides on the ground
//
//   us_per_s, siconos_us_per_s   thread time of the motion, without set-up, by its duration
//   siconos_ratio                the second by the first
//   us_per_event                 by the number of impacts, on which both agree
//   error, siconos_error         largest error of a component of the final state, beside a motion with finer steps
// The last number of a name is the number of digits that both shall have: the tolerance of either is 10^-digits.
#include <benchmark/benchmark.h>
#include <glog/logging.h>

#include <algorithm>
#include <cmath>
#include <memory>
#include <span>
#include <vector>

#include "paper/experiments.h"
#include "saltus/hybrid/hybrid_simulator.h"
#include "saltus/hybrid/mechanical_system.h"
#include "siconos_motion.h"

namespace saltus {
namespace {

// Coordinates x, y and angle of each box in turn; the boxes do not touch each other.
struct Boxes : BouncingBox {
  int count = 1;

  MechanicalLayout Layout() const { return {.num_coordinates = 3 * count, .num_contacts = 4 * count}; }
  template <typename T>
  void Mass(const T*, const T*, T* M) const {
    const int n = 3 * count;
    for (int i = 0; i < n * n; ++i) M[i] = T(0.0);
    for (int i = 0; i < n; ++i) M[i * (n + 1)] = T(i % 3 == 2 ? kInertia : kMass);
  }
  template <typename T>
  void Force(const T&, const T*, const T*, const T*, const T*, T* h) const {
    for (int i = 0; i < 3 * count; ++i) h[i] = T(i % 3 == 1 ? -kMass * kGravity : 0.0);
  }
  template <typename T>
  T Gap(int contact, const T* q, const T*) const {
    using std::cos, std::sin;
    const T* box = q + 3 * (contact / 4);
    return box[1] + Along(contact % 4) * sin(box[2]) + Across(contact % 4) * cos(box[2]);
  }
  template <typename T>
  T Restitution(int, const T*) const {
    return T(kRestitution);
  }
};

struct Pendulum : SlidingPendulum {
  static constexpr int kNumCoordinates = 2, kNumControls = 0, kNumParameters = 0, kNumContacts = 1;

  template <typename T>
  T Restitution(int, const T*) const {
    return T(0.0);
  }
};

template <typename Function>
double TimeOf(const Function& function) {
  const double start = ThreadTime();
  function();
  return ThreadTime() - start;
}

double LargestDifference(std::span<const double> a, std::span<const double> b) {
  CHECK_EQ(a.size(), b.size());
  double largest = 0;
  for (std::size_t i = 0; i < a.size(); ++i) largest = std::max(largest, std::abs(a[i] - b[i]));
  return largest;
}

template <typename BySiconos>
void Compare(benchmark::State& state, const MechanicalSystem& system, HybridInput input, double tolerance,
             const BySiconos& by_siconos) {
  constexpr int kTurns = 25;
  input.mode = system.FindMode(input.initial, {}, input.parameters).mode;
  HybridSimulator simulator(system.hybrid(), {.tolerance = tolerance});
  CHECK(simulator.Rollout(input)) << simulator.FailureReason();
  HybridSimulator finer(system.hybrid(), {.steps_per_interval = 8 * simulator.steps_per_interval()});
  CHECK(finer.Rollout(input)) << finer.FailureReason();
  const std::vector<double> exact(finer.final_state().begin(), finer.final_state().end());
  for (auto _ : state) {
    double ours = HUGE_VAL, theirs = HUGE_VAL;
    int impacts = 0;
    std::vector<double> their_state;
    for (int turn = 0; turn < kTurns; ++turn) {
      ours = std::min(ours, TimeOf([&] { CHECK(simulator.Rollout(input)); }));
      const std::unique_ptr<SiconosMotion> motion = by_siconos(input.initial, input.duration, tolerance);
      theirs = std::min(theirs, TimeOf([&] { impacts = motion->Run(); }));
      their_state = motion->State();
    }
    const auto events = static_cast<int>(simulator.events().size());
    state.SetIterationTime(ours);
    state.counters["us_per_s"] = 1e6 * ours / input.duration;
    state.counters["siconos_us_per_s"] = 1e6 * theirs / input.duration;
    state.counters["siconos_ratio"] = theirs / ours;
    state.counters["steps"] = simulator.num_steps();
    state.counters["events"] = events;
    state.counters["siconos_events"] = impacts;
    if (events > 0) state.counters["us_per_event"] = 1e6 * ours / events;
    if (impacts > 0) state.counters["siconos_us_per_event"] = 1e6 * theirs / impacts;
    state.counters["error"] = LargestDifference(simulator.final_state(), exact);
    state.counters["siconos_error"] = LargestDifference(their_state, exact);
  }
}

double ToleranceOf(const benchmark::State& state, int argument) {
  return std::pow(10.0, -static_cast<double>(state.range(argument)));
}

void CompareBoxes(benchmark::State& state, bool tumble) {
  const auto count = static_cast<int>(state.range(0));
  HybridInput input{.initial = std::vector<double>(6 * count), .duration = 1};
  for (int i = 0; i < count; ++i) {
    double *q = &input.initial[3 * i], *v = q + 3 * count;
    q[0] = 2 * i;
    q[1] = tumble ? 0.9 - 0.005 * i : Boxes::kHalfHeight;
    if (!tumble) continue;
    q[2] = 0.6 + 0.005 * i;
    v[0] = 1.5;
    v[1] = -0.5;
    v[2] = -3;
  }
  Boxes boxes;
  boxes.count = count;
  Compare(state, MechanicalSystem(boxes), input, ToleranceOf(state, 1), BoxesBySiconos);
}

void TumblingBoxes(benchmark::State& state) { CompareBoxes(state, true); }
void RestingBoxes(benchmark::State& state) { CompareBoxes(state, false); }
void SlidingDoublePendulum(benchmark::State& state) {
  constexpr double kFirst = -0.45;  // rad
  const double second = std::acos((Pendulum::kDepth - Pendulum::kLength[0] * std::cos(kFirst)) / Pendulum::kLength[1]);
  const HybridInput input{.initial = {kFirst, second, 0, 0}, .duration = 1};
  Compare(state, MechanicalSystem(Pendulum()), input, ToleranceOf(state, 0), PendulumBySiconos);
}
BENCHMARK(TumblingBoxes)->ArgsProduct({{1, 2, 4, 8}, {12}})->UseManualTime()->Iterations(1);
BENCHMARK(RestingBoxes)->ArgsProduct({{1, 2, 4, 8}, {12}})->UseManualTime()->Iterations(1);
BENCHMARK(SlidingDoublePendulum)->Arg(12)->UseManualTime()->Iterations(1);

}  // namespace
}  // namespace saltus
