// The indirect method: a zero of the conditions of the hybrid minimum principle in continuous time, to rounding.
//
// The conditions are those of optimality/costate_shooting.h. Newton's method starts from a solution on Scene::steps
// intervals and the multipliers of its certificate: that of ceres_event along the impacts of the guess, or of
// ceres_phases where the scene has bounds, hard terms, path costs or a free final time. The report has the control of
// that solution, and the loss of the optimum in continuous time. The certificate is that of the control reported, and
// SolveReport::continuous has the conditions in continuous time.
//
// Arcs of EventPhases (optimality/costate.h) are brought to a zero of their conditions in the same way.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "optimality/costate.h"
#include "optimality/costate_shooting.h"
#include "saltus/solve/solver.h"

namespace saltus {

struct HmpRoot {
  std::vector<double> z;  // variables of the path
  bool valid = false;     // whether there is a path; if not, nothing else is filled
  double residual = 0;    // the largest of all conditions
  double scale = 0;       // the largest costate
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
  std::vector<double> speeds;  // of approach at the impacts
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
