// The frame of solvers by single shooting: it binds the model to the scene, takes the time, collects losses, asks the
// callback, writes the report; and common parts of those by Ceres: tolerances, the callback, and the meaning of its
// termination.
#pragma once

#include <ceres/iteration_callback.h>
#include <ceres/types.h>

#include <chrono>
#include <functional>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "saltus/control/single_shooting.h"
#include "saltus/solve/solver.h"

namespace saltus {

// Returns the error of an option that is wrong for every solver, as "found x, expected y"; empty if there is none.
std::string Validate(const SolverOptions& options);

// Sets what the motion at the decision variables z depends on.
void SetSolution(const ShootingFunction& shooting, std::span<const double> z, Solution* solution);

// The frame of an algorithm that minimises any function by shooting.
class ShootingRun {
 public:
  // The clock of the report starts here. Both outlive it.
  ShootingRun(std::string_view solver, const SolverOptions& options);
  ShootingRun(const ShootingRun&) = delete;  // its function asks it when to stop
  virtual ~ShootingRun() = default;

  virtual ShootingFunction& function() = 0;
  const SolverOptions& options() const { return options_; }
  // The decision variables to start from.
  const std::vector<double>& initial_guess() const { return guess_; }
  int num_recorded() const { return static_cast<int>(report_.history.losses.size()); }

  // Appends the loss of the next iterate z, the initial guess first. Returns false if the callback wants to stop.
  bool Record(double loss, std::span<const double> z);

  // Counts an estimate of the gradient, with the standard error of each component.
  void RecordEstimate(std::vector<double> standard_error);

  // The report of a run that ends at z. The final loss is the last one recorded unless given.
  SolveReport Finish(std::span<const double> z, Termination termination, std::string reason = {},
                     std::optional<double> final_loss = {});

 protected:
  // Returns a remark on the motion from z, where a run has ended so; empty if there is none.
  virtual std::string RemarkOn(std::span<const double> z, Termination termination) = 0;

  const SolverOptions& options_;
  SolveReport report_;
  std::vector<double> guess_;

 private:
  std::chrono::steady_clock::time_point start_;
  int num_estimates_ = 0;
};

// The frame of a solve of a scene.
class SolveRun final : public ShootingRun {
 public:
  // Preconditions as those of MakeSimulator.
  SolveRun(std::string_view solver, const SolveRequest& request, const SolverOptions& options);

  SingleShooting& shooting() { return shooting_; }
  ShootingFunction& function() override { return shooting_; }

 private:
  // Names the discs of terminal terms that lie in a pocket at the end of a run that has converged.
  std::string RemarkOn(std::span<const double> z, Termination termination) override;

  SingleShooting shooting_;
};

// The bounds on the control that a solver keeps.
struct BoundsKept {
  bool components = false, norm = false;
};
// Returns the reason why single shooting does not support a request; empty if it does.
std::string UnsupportedByShooting(const SolveRequest& request, const BoundsKept& bounds);

// Returns the reason why single shooting has nothing to optimize in a scene; empty if it has.
std::string ReasonNothingToOptimize(const Scene& scene);

// Tolerances so tight that in smooth problems rounding alone stops Ceres; whether that was a minimum is judged by
// Conclude. Solvers work in natural units (scene/units.h), in which losses and variables are about 1, as Ceres'
// own constants suppose.
inline constexpr double kGradientTolerance = 1e-10;
inline constexpr double kFunctionTolerance = 1e-16;
inline constexpr double kParameterTolerance = 1e-15;

// Sets what all of Ceres' solvers here have in common.
template <typename CeresOptions>
void SetCommonOptions(int iterations, CeresOptions* options) {
  options->logging_type = ceres::SILENT;
  options->max_num_iterations = iterations;
  options->gradient_tolerance = kGradientTolerance;
  options->function_tolerance = kFunctionTolerance;
  options->parameter_tolerance = kParameterTolerance;
  options->update_state_every_iteration = true;  // callbacks read it; Ceres drops the state otherwise if it fails
}

// Calls a function after each iteration. Where it returns false, Ceres stops and keeps its iterate.
class AfterIteration final : public ceres::IterationCallback {
 public:
  using ContinuePredicate = std::function<bool(const ceres::IterationSummary& summary)>;
  explicit AfterIteration(ContinuePredicate may_continue) : may_continue_(std::move(may_continue)) {}
  ceres::CallbackReturnType operator()(const ceres::IterationSummary& summary) override {
    return may_continue_(summary) ? ceres::SOLVER_CONTINUE : ceres::SOLVER_TERMINATE_SUCCESSFULLY;
  }

 private:
  ContinuePredicate may_continue_;
};

// A gradient has vanished if it is below kGradientTolerance, or this part of the largest one met.
inline constexpr double kGradientReduction = 1e-6;

// Records the loss of each iterate (of a rejected step, Ceres gives the cost at the rejected candidate), and stops
// Ceres, keeping its iterate, when told to.
class RecordIteration final : public ceres::IterationCallback {
 public:
  // `z` is what Ceres updates in every iteration; `loss` gives the loss of an accepted step from its cost.
  RecordIteration(ShootingRun* run, std::function<double(double cost)> loss, const std::vector<double>* z)
      : run_(run), loss_(std::move(loss)), z_(z) {}
  ceres::CallbackReturnType operator()(const ceres::IterationSummary& summary) override;
  bool Record(const ceres::IterationSummary& summary);
  // The last iterate that was recorded, if any. After a failure Ceres sets the variables back to their initial values.
  const std::optional<std::vector<double>>& iterate() const { return iterate_; }

 private:
  ShootingRun* run_;
  std::function<double(double)> loss_;
  const std::vector<double>* z_;
  double last_ = 0;
  std::optional<std::vector<double>> iterate_;
};

// The termination of Ceres.
struct CeresOutcome {
  ceres::TerminationType type;
  std::span<const ceres::IterationSummary> iterations;
  bool failure_is_stall;  // FAILURE at a later iterate means that no descent was found
};

// The termination of a run, and the reason in words.
struct End {
  Termination termination;
  std::string words;
};

// Records what the callback was not shown of a run that ends at z, and how it ended. Converged means that the
// gradient has vanished. A tolerance on steps or losses says no such thing: where the loss has a kink, steps shrink
// until it is met.
End RecordEnd(ShootingRun* run, RecordIteration* record, std::span<const double> z, const CeresOutcome& outcome);

// Records the end in this way, and writes the report.
SolveReport Conclude(ShootingRun* run, RecordIteration* record, std::span<const double> z, const CeresOutcome& outcome);

// A converged run whose certificate finds no minimum becomes no_progress, with the reason of the certificate.
void JudgeByCertificate(SolveReport* report);
// Removes the certificate of a run, and what JudgeByCertificate() has made of it.
void ForgetCertificate(SolveReport* report);

}  // namespace saltus
