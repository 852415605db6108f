// Exact motion over part of a step, of which it is known who touches anything meanwhile.
#pragma once

#include <span>
#include <vector>

#include "saltus/simulate/registry.h"

namespace saltus {

// Simulates only the discs that touch something, and lets all others fly: of a thousand discs few meet in a step. Discs
// that do not touch do not change each other's motion, so that states are those of the whole scene.
class ExactFlight {
 public:
  // `model` is event-driven and takes `scene`, which is in its natural units.
  ExactFlight(const Contact& model, const Scene& scene);

  // Which discs touch anything in the flights that follow; all others must not.
  void SetTouching(const std::vector<char>& touches);

  // The state (simulator.h) after `time` from state x under `force` (B x 2, on every disc). That is x if the time is
  // too short for numbers; not a number where the simulation fails.
  std::vector<double> Fly(std::span<const double> x, std::span<const double> force, double time) const;

 private:
  void FlyFreely(int disc, std::span<const double> force, double time, std::span<double> state) const;

  Contact model_;
  Scene scene_, part_;      // `part_` has the discs that touch
  std::vector<int> discs_;  // these
};

}  // namespace saltus
