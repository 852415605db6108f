// Free flight of several motions at once, each in a lane of the processor.
#pragma once

#include <array>
#include <cstddef>
#include <cstring>

#include "saltus/contact/step_input.h"
#include "saltus/internal/lanes.h"

namespace saltus {

// Free flight of one disc in several motions, over a number of steps in each.
struct FlightsInput {
  StepInput<double> step;                     // one disc; the flights set `force`
  std::array<int, kLanes> steps{};            // of each motion; at least one has some
  std::array<const double*, kLanes> force{};  // [u_x u_y] of the first step, in units of `unit`; null in all or in none
  std::ptrdiff_t stride = 0;                  // numbers from one step's force to the next
  double unit = 1;                            // N
  std::array<std::ptrdiff_t, 2> ahead{};      // numbers from a force to one that is read soon, to one that is set
};

namespace internal {

// Loads two numbers of each lane, from u[lane] + offset on.
inline std::array<Lanes, 2> LoadPairs(const std::array<const double*, kLanes>& u, std::ptrdiff_t offset) {
  using Pair = double __attribute__((vector_size(2 * sizeof(double))));
  const auto load = [&](int lane) {
    Pair pair;
    std::memcpy(&pair, u[lane] + offset, sizeof(pair));
    return pair;
  };
  const Lanes::Pack even = __builtin_shufflevector(load(0), load(2), 0, 1, 2, 3);
  const Lanes::Pack odd = __builtin_shufflevector(load(1), load(3), 0, 1, 2, 3);
  return {Lanes(__builtin_shufflevector(even, odd, 0, 4, 2, 6)), Lanes(__builtin_shufflevector(even, odd, 1, 5, 3, 7))};
}

template <typename M>
void FlyInLanes(const M& model, const FlightsInput& flights, const std::array<BodyState<double, 0>*, kLanes>& at) {
  // The lanes in the order in which they end. A lane that has ended goes along with the last one.
  std::array<int, kLanes> order;
  for (int lane = 0; lane < kLanes; ++lane) {
    int place = lane;
    for (; place > 0 && flights.steps[order[place - 1]] > flights.steps[lane]; --place) order[place] = order[place - 1];
    order[place] = lane;
  }
  const int last = order.back();
  std::array<const double*, kLanes> u = flights.force;
  std::array<const BodyState<double, 0>*, kLanes> from;
  for (int lane = 0; lane < kLanes; ++lane) {
    const bool flies = flights.steps[lane] > 0;
    from[lane] = at[flies ? lane : last];
    if (!flies) u[lane] = u[last];
  }
  BodyState<Lanes, 0> x;
  for (int j = 0; j < 2; ++j) {
    x.p[j] = Lanes(Lanes::Pack{from[0]->p[j], from[1]->p[j], from[2]->p[j], from[3]->p[j]});
    x.v[j] = Lanes(Lanes::Pack{from[0]->v[j], from[1]->v[j], from[2]->v[j], from[3]->v[j]});
  }
  const BodyConstants<double>& disc = flights.step.bodies[0];
  const BodyConstants<Lanes> body{disc.mass, disc.inverse_mass, disc.radius, disc.fixed};
  Vec2<Lanes> force(Lanes(0.0), Lanes(0.0));
  StepInput<Lanes> in{};
  in.h = flights.step.h;
  in.gravity = flights.step.gravity;
  in.bodies = {&body, 1};
  in.force = {&force, 1};
  const Lanes unit(flights.unit);
  const bool pushed = u[last] != nullptr;
  int step = 0;
  std::ptrdiff_t offset = 0;
  for (int lane : order) {
    const int end = flights.steps[lane];
    if (end == 0) continue;
    // Two loops, so that what does not change is not computed in each step.
    if (!pushed) {
      for (; step < end; ++step) x = model.Free(in, 0, x);
    } else {
      for (; step < end; ++step, offset += flights.stride) {
        const std::array<Lanes, 2> pair = LoadPairs(u, offset);
        force = {unit * pair[0], unit * pair[1]};
        // The forces of a disc in four steps fill a line of the cache.
        const double* const here = u[step % kLanes] + offset;
        __builtin_prefetch(here + flights.ahead[0]);
        __builtin_prefetch(here + flights.ahead[1], /*rw=*/1);
        x = model.Free(in, 0, x);
      }
    }
    const BodyState<Lanes, 0> now = x;
    *at[lane] = {{now.p[0][lane], now.p[1][lane]}, {now.v[0][lane], now.v[1][lane]}};
    u[lane] = u[last];
  }
}

#ifdef __x86_64__
template <typename M>
SALTUS_FLATTEN [[gnu::target("avx2")]] void FlyWithAvx2(const M& model, const FlightsInput& flights,
                                                        const std::array<BodyState<double, 0>*, kLanes>& at) {
  FlyInLanes(model, flights, at);
}
#endif

// Moves the disc of each motion from *at[lane] to the state after its steps, by the model's free flight, with the bits
// of one motion after the other. A motion without steps may have a null pointer.
template <typename M>
void FlyTogether(const M& model, const FlightsInput& flights, const std::array<BodyState<double, 0>*, kLanes>& at) {
#ifdef __x86_64__
  if (__builtin_cpu_supports("avx2")) return FlyWithAvx2(model, flights, at);
#endif
  FlyInLanes(model, flights, at);
}

}  // namespace internal
}  // namespace saltus
