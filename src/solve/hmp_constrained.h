// The hybrid minimum principle with bounds, hard terms, running and via terms or a free final time: a zero of its
// conditions in continuous time (optimality/costate_shooting.h), by Newton's method from where ceres_phases and the
// multipliers of its certificate are.
#pragma once

#include "optimality/costate_shooting.h"
#include "saltus/solve/solver.h"

namespace saltus {

// The optimum in continuous time.
struct ContinuousOptimum {
  explicit ContinuousOptimum(CostateShooting of) : shooting(std::move(of)) {}

  CostateShooting shooting;
  std::vector<double> y;  // its unknowns
  std::vector<CostateShooting::Leg> legs;
  std::vector<double> residuals;
  double loss = 0;
  double scale = 0;  // the largest costate
  int iterations = 0, jacobians = 0;

  double Residual() const;  // the largest of all conditions, in parts of the scale
};

// From a control whose certificate is stationary, in natural units. Nothing if Newton's method leaves the motions along
// its impacts.
std::optional<ContinuousOptimum> FindContinuousOptimum(const Scene& scene, const SolveReport& start,
                                                       int most_iterations);

// Reports the control that ceres_phases has found on Scene::steps intervals, and loss and certificate of the optimum in
// continuous time.
std::string WhyNotConstrainedHmp(const SolveRequest& request);
SolveReport SolveConstrainedByHmp(const SolveRequest& request, const SolverOptions& options);

}  // namespace saltus
