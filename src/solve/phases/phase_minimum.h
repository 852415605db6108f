// The least loss along a given collision sequence, by Ceres: Levenberg-Marquardt on the few variables of EventPhases.
// Gaps that no pushed disc closes by itself are constraints, met by an augmented Lagrangian. An impact must close:
// where the loss falls until the two sides only touch, that impact is held at a touch, and the rest is minimized.
//
// Tolerances are those of scenes in their natural units (scene/units.h), in which solvers work.
#pragma once

#include <functional>
#include <vector>

#include "control/event_phases.h"

namespace saltus {

struct PhaseMinimum {
  std::vector<double> z;
  bool valid = false;      // there is a path; all else is filled
  bool converged = false;  // the loss does not fall any more and the gaps are closed
  bool interrupted = false;
  bool touches = false;  // at some impact the normal velocity is zero: the loss has a kink there
  double loss = 0;
  int jacobians = 0;
};

struct PhaseMinimumOptions {
  int iterations = 200;                       // of Ceres, in all
  std::function<bool(double loss)> callback;  // after each iteration; false interrupts
};

// Precondition: the scene of `phases` is in its natural units.
PhaseMinimum MinimizeLoss(const EventPhases& phases, std::vector<double> z, const PhaseMinimumOptions& options);

}  // namespace saltus
