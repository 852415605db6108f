// A zero of the conditions of the hybrid minimum principle near a given path, by Ceres.
#pragma once

#include <functional>
#include <vector>

#include "optimality/costate.h"

namespace ceres {
class CostFunction;
}

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

// Newton's method, damped until it works, for as many equations as there are numbers in y; takes the function over.
struct NewtonSummary {
  int iterations = 0, jacobians = 0;
};
NewtonSummary FindRoot(ceres::CostFunction* equations, std::vector<double>* y, int most_iterations);

}  // namespace saltus
