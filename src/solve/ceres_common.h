// What the solvers by Ceres share: the callback, and what it means when Ceres stops.
#pragma once

#include <ceres/iteration_callback.h>
#include <ceres/types.h>

#include <functional>
#include <span>
#include <string>

#include "solve/solve_run.h"

namespace saltus {

// Tolerances so tight that in smooth problems rounding alone stops Ceres; whether that was a minimum is judged by
// Conclude. Solvers work in natural units (scene/units.h), in which losses and variables are about 1, as Ceres'
// own constants suppose.
inline constexpr double kGradientTolerance = 1e-10;
inline constexpr double kFunctionTolerance = 1e-16;
inline constexpr double kParameterTolerance = 1e-15;

// A gradient has vanished if it is below kGradientTolerance, or this part of the largest one met.
inline constexpr double kGradientReduction = 1e-6;

// From what Ceres minimizes to the loss.
struct LossOfCost {
  double scale = 1;
  double offset = 0;
  double operator()(double cost) const { return scale * cost + offset; }
};

// Records the loss of each iterate (of a rejected step, Ceres gives the cost at the rejected candidate), and stops
// Ceres, keeping its iterate, when told to.
class RecordIteration final : public ceres::IterationCallback {
 public:
  // `z` is what Ceres updates in every iteration; `loss` gives the loss of an accepted step from its cost.
  RecordIteration(ShootingRun* run, std::function<double(double cost)> loss, const std::vector<double>* z)
      : run_(run), loss_(std::move(loss)), z_(z) {}
  ceres::CallbackReturnType operator()(const ceres::IterationSummary& summary) override;
  bool Record(const ceres::IterationSummary& summary);

 private:
  ShootingRun* run_;
  std::function<double(double)> loss_;
  const std::vector<double>* z_;
  double last_ = 0;
};

// How Ceres ended.
struct CeresOutcome {
  ceres::TerminationType type;
  std::span<const ceres::IterationSummary> iterations;
  bool failure_is_stall;  // FAILURE at a later iterate means that no descent was found
};

// The effort of a control that is not optimized: a constant that Ceres does not see.
double GivenEffort(const SingleShooting& shooting);

// How a run ended, and why in words.
struct End {
  Termination termination;
  std::string words;
};

// Records what the callback was not shown of a run that ends at z, and says how it ended. Converged means that the
// gradient has vanished. A tolerance on steps or losses says no such thing: where the loss has a kink, steps shrink
// until it is met.
End RecordEnd(ShootingRun* run, RecordIteration* record, std::span<const double> z, const CeresOutcome& outcome);

// Does so, and writes the report.
SolveReport Conclude(ShootingRun* run, RecordIteration* record, std::span<const double> z, const CeresOutcome& outcome);

}  // namespace saltus
