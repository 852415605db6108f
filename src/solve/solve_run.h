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

class SolveRun {
 public:
  // The clock of the report starts here. Preconditions as those of MakeSimulator.
  SolveRun(std::string_view solver, const SolveRequest& request, const SolverOptions& options);
  SolveRun(const SolveRun&) = delete;  // its simulator asks it when to stop

  SingleShooting& shooting() { return shooting_; }
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

 private:
  // Which discs of terminal terms lie in a pocket at the end of the motion from z, in words; empty if none does.
  std::string DescribePockets(std::span<const double> z);

  std::chrono::steady_clock::time_point start_;
  const SolverOptions& options_;
  SolveReport report_;
  int num_estimates_ = 0;
  SingleShooting shooting_;
  std::vector<double> guess_;
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
