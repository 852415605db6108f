// A zero of the conditions of the hybrid minimum principle near a given path, by Ceres.
#pragma once

#include <functional>
#include <vector>

#include "control/costate.h"

namespace saltus {

struct HmpRoot {
  std::vector<double> z;            // variables of the path
  std::vector<double> multipliers;  // one an impact
  bool valid = false;               // there is a path; all else is filled
  double residual = 0;              // the largest of all conditions
  double scale = 0;                 // the largest costate
  int iterations = 0;
  int jacobians = 0;
};

// Starts at z; the multipliers start where the conditions, linear in them, are met best.
HmpRoot FindHmpRoot(const EventPhases& phases, std::vector<double> z, int most_iterations);

}  // namespace saltus
