// What every solver by single shooting does around its algorithm: bind the model to the scene, time, collect losses,
// ask the callback, write the report.
#pragma once

#include <chrono>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "saltus/control/single_shooting.h"
#include "saltus/solve/solver.h"

namespace saltus {

// Around an algorithm that minimises any function by shooting.
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
  int num_recorded() const { return static_cast<int>(report_.losses.size()); }

  // Appends the loss of the next iterate z, the initial guess first. False if the callback wants to stop.
  bool Record(double loss, std::span<const double> z);

  // Counts an estimate of the gradient, with the standard error of each component.
  void RecordEstimate(std::vector<double> standard_error);

  // The report of a run that ends at z. The final loss is the last one recorded unless given.
  SolveReport Finish(std::span<const double> z, Termination termination, std::string reason = {},
                     std::optional<double> final_loss = {});

 protected:
  // What is to be said of the motion from z, where a run has ended so; empty if nothing is.
  virtual std::string RemarkOn(std::span<const double> z, Termination termination) = 0;

  const SolverOptions& options_;
  SolveReport report_;
  std::vector<double> guess_;

 private:
  std::chrono::steady_clock::time_point start_;
  int num_estimates_ = 0;
};

// The same for a scene.
class SolveRun final : public ShootingRun {
 public:
  // Preconditions as those of MakeSimulator.
  SolveRun(std::string_view solver, const SolveRequest& request, const SolverOptions& options);

  SingleShooting& shooting() { return shooting_; }
  ShootingFunction& function() override { return shooting_; }

 private:
  // Which discs of terminal terms lie in a pocket at the end, of a run that has converged.
  std::string RemarkOn(std::span<const double> z, Termination termination) override;

  SingleShooting shooting_;
};

// Which bounds on the control a solver keeps.
struct BoundsKept {
  bool components = false, norm = false;
};
// Why single shooting cannot take a request; empty if it can.
std::string WhyNotShot(const SolveRequest& request, const BoundsKept& bounds);

// Why a scene gives single shooting nothing to do; empty if it does not.
std::string WhyNothingToOptimize(const Scene& scene);

}  // namespace saltus
