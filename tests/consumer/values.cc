// Contact models and hybrid systems are headers, which a user's project compiles with its own options, such as
// -march=native. Whatever they are, a step with derivatives has the values of the step without, to the last bit. Exit
// code 0 if it does.
#include <array>
#include <iostream>
#include <memory_resource>
#include <random>
#include <span>

#include "own_model.h"
#include "saltus/base/scalar.h"
#include "saltus/hybrid/hybrid_system.h"

namespace {

using namespace saltus;

// A step of two discs above a plane; `numbers` are their states and the forces on them.
template <typename T, typename Model>
std::array<T, 8> Step(const Model& model, const std::array<double, 12>& numbers) {
  std::array<T, 12> at;
  for (int i = 0; i < 12; ++i) {
    at[i] = T(numbers[i]);
    if constexpr (!std::is_same_v<T, double>) at[i].v[i % 6] = 1;
  }
  std::pmr::monotonic_buffer_resource scratch;
  const std::array<BodyConstants<T>, 2> bodies = {{{T(1.3), T(1 / 1.3), 0.2, false}, {T(0.7), T(1 / 0.7), 0.3, false}}};
  const std::array<Wall<double>, 1> planes = {{{Vec2d(0.6, 0.8), -0.1}}};
  const std::array<Vec2<T>, 2> force = {Vec2<T>(at[8], at[9]), Vec2<T>(at[10], at[11])};
  const std::array<Candidate, 3> candidates = {{{0, 1, false}, {0, 0, true}, {1, 0, true}}};
  StepInput<T> in{};
  in.h = 1.0 / 480;
  in.gravity = Vec2d(0.1, -9.8);
  in.contact = {T(0.8), T(Model::kTraits.friction ? 0.3 : 0.0), T(1e4), T(0.5)};
  in.bodies = bodies;
  in.planes = planes;
  in.force = force;
  in.candidates = candidates;
  in.scratch = &scratch;
  std::array<BodyState<T, 0>, 2> x, next;
  for (int i = 0; i < 2; ++i) x[i] = {{at[4 * i], at[4 * i + 1]}, {at[4 * i + 2], at[4 * i + 3]}};
  model.Step(in, std::span<const BodyState<T, 0>>(x), std::span<BodyState<T, 0>>(next));
  return {
      next[0].p[0], next[0].p[1], next[0].v[0], next[0].v[1], next[1].p[0], next[1].p[1], next[1].v[0], next[1].v[1]};
}

template <typename Model>
bool ValuesAgree() {
  std::mt19937 random(1);
  const auto number = [&](double low, double high) { return low + (high - low) * random() / 4294967295.0; };
  for (int sample = 0; sample < 2000; ++sample) {
    std::array<double, 12> numbers;
    for (double& entry : numbers) entry = number(-3, 3);
    // Near contact with each other, and the first with the plane.
    numbers[0] = 0.06 + 0.005 * number(-1, 1);
    numbers[1] = 0.08 + 0.005 * number(-1, 1);
    numbers[4] = numbers[0] + 0.3 + 0.01 * number(-1, 1);
    numbers[5] = numbers[1] + 0.4 + 0.01 * number(-1, 1);
    const auto values = Step<double>(Model(), numbers);
    const auto jets = Step<StepJet<double>>(Model(), numbers);
    for (int i = 0; i < 8; ++i) {
      if (values[i] == jets[i].a) continue;
      std::cerr.precision(17);
      std::cerr << Model::kTraits.name << ": " << values[i] << " without derivatives, " << jets[i].a << " with them\n";
      return false;
    }
  }
  return true;
}

// Whose slopes have sums and differences of products side by side, which a compiler may fuse: (x1, x2, x3, x4) are two
// points that spiral, and x5 counts.
struct Spirals {
  static constexpr int kNumControls = 1;
  static constexpr int kNumParameters = 2;
  static constexpr std::array kStateSizes = {5};
  static constexpr std::array kNumGuards = {0};
  template <typename T>
  void Flow(int, const T&, const T* x, const T* u, const T* p, T* xdot) const {
    for (int i = 0; i < 4; i += 2) {
      xdot[i] = p[0] * x[i] - p[1] * x[i + 1];
      xdot[i + 1] = p[0] * x[i + 1] + p[1] * x[i];
    }
    xdot[4] = u[0] * x[0] + x[4];
  }
  template <typename T>
  T Guard(int, int, const T&, const T*, const T*) const {
    return T(1.0);
  }
  template <typename T>
  int Reset(int, int, const T&, const T*, const T*, T*) const {
    return 0;
  }
};

// The slopes of a step of the integration and the state after it.
bool StepsAgree() {
  using namespace cooper_verner;
  const HybridSystem system{Spirals()};
  constexpr int kSize = 5, kColumns = kSize + 1 + 2 + 1;
  std::mt19937 random(2);
  const auto number = [&] { return random() / 2147483648.0 - 1; };
  for (int sample = 0; sample < 2000; ++sample) {
    double x[kSize], slope[kSize], after[kSize], slope_after[kSize], again[kSize], scratch[kSize];
    double slopes[kStages * kSize], jacobians[kStages * kSize * kColumns];
    for (double& entry : x) entry = number();
    const double u[] = {number()}, p[] = {number(), number()};
    const FlowStep step{{0, 0, x, u, p}, 0.1};
    system.functions().Flow(step, slope);
    system.functions().Step(step, slope, scratch, after, slope_after);
    system.functions().LinearizeStep(step, scratch, slopes, jacobians);
    CombineSlopes<kStages, kSize>(step.h, x, slopes, again);
    for (int i = 0; i < kSize; ++i) {
      if (after[i] == again[i] && slope[i] == slopes[i]) continue;
      std::cerr.precision(17);
      std::cerr << "step: " << after[i] << " without derivatives, " << again[i] << " with them\n";
      return false;
    }
  }
  return true;
}

}  // namespace

int main() { return ValuesAgree<OwnModel>() && StepsAgree() ? 0 : 1; }
