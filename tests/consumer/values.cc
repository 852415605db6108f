// Contact models are headers, which a user's project compiles with its own options, such as -march=native. Whatever
// they are, a step with derivatives has the values of the step without, to the last bit. Exit code 0 if it does.
#include <array>
#include <iostream>
#include <memory_resource>
#include <random>
#include <span>
#include <vector>

#include "own_model.h"
#include "saltus/base/scalar.h"

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

}  // namespace

int main() { return ValuesAgree<OwnModel>() ? 0 : 1; }
