// The indirect method: a zero of the conditions of the hybrid minimum principle in continuous time, to rounding.
//
// Without bounds, hard terms, path costs and a free final time, the conditions are those of optimality/costate.h. The
// unknowns are the variables of EventPhases and one multiplier per impact: five for one impact of a controlled disc.
// Newton's method starts from where Levenberg-Marquardt on the same variables has converged. The control reported is
// the best one on Scene::steps intervals with the same impacts, so its loss is a little higher.
//
// Otherwise they are those of optimality/costate_shooting.h, and Newton's method starts from the solution of
// ceres_phases and the multipliers of its certificate. The report has the control that ceres_phases has found on
// Scene::steps intervals, and the loss of the optimum in continuous time. The certificate is that of the control
// reported, and SolveReport::continuous has the conditions in continuous time.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "optimality/costate.h"
#include "optimality/costate_shooting.h"
#include "saltus/solve/solver.h"

namespace saltus {

struct HmpRoot {
  std::vector<double> z;            // variables of the path
  std::vector<double> multipliers;  // one per impact
  bool valid = false;               // whether there is a path; if not, nothing else is filled
  double residual = 0;              // the largest of all conditions
  double scale = 0;                 // the largest costate
  int jacobians = 0;
};

// Starts at z and at the multipliers, in which the conditions are linear, that meet the conditions best.
HmpRoot FindHmpRoot(const EventPhases& phases, std::vector<double> z, int most_iterations);

// The optimum in continuous time.
struct ContinuousOptimum {
  explicit ContinuousOptimum(CostateShooting of) : shooting(std::move(of)) {}

  CostateShooting shooting;
  std::vector<double> y;  // its unknowns
  std::vector<CostateShooting::Leg> legs;
  std::vector<double> residuals;
  double loss = 0;
  double scale = 0;  // the largest costate
  int jacobians = 0;

  double Residual() const;  // the largest of all conditions, as a part of the scale
};

// Finds the optimum from a control whose certificate is stationary, in natural units. Returns std::nullopt if Newton's
// method leaves the motions along its impacts.
std::optional<ContinuousOptimum> FindContinuousOptimum(const Scene& scene, const SolveReport& start,
                                                       int most_iterations);

// Returns the reason why the method does not support a request; empty if it does.
std::string UnsupportedByHmp(const SolveRequest& request);

// Precondition: UnsupportedByHmp() is empty.
SolveReport SolveByHmp(const SolveRequest& request, const SolverOptions& options);

}  // namespace saltus
