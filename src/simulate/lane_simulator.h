// Simulators that take several motions through the lanes of a core at once.
#pragma once

#include <array>
#include <cstddef>
#include <span>

#include "saltus/simulate/simulator.h"

namespace saltus {

class LaneSimulator : public Simulator {
 public:
  // A motion of the scene, with the simulator that no other motion uses.
  struct Motion {
    LaneSimulator* simulator;
    std::span<const double> initial, control;  // as of Rollout; the control must stay as long as results are asked for
    bool ok = false;                           // set to what Rollout would have returned
  };

  // Whether this simulator has lanes. Precondition of RolloutTogether().
  virtual bool HasLanes() const = 0;
  // Simulates up to kLanes motions (internal/lanes.h) under controls in units of `force_unit`, N, with the bits of
  // Rollout. Derivatives by the control are in the same units. Meanwhile the cache fetches the numbers `ahead` of those
  // of the controls, which are to be read and to be set next (0 if none are). Precondition: all simulators were made as
  // this one.
  virtual void RolloutTogether(std::span<Motion> motions, double force_unit,
                               const std::array<std::ptrdiff_t, 2>& ahead) = 0;

 protected:
  using Simulator::Simulator;
};

}  // namespace saltus
