// What the solvers on event phases do around their algorithm: time, simulate the initial guess, collect losses, ask the
// callback, write the report.
#pragma once

#include <algorithm>
#include <chrono>
#include <string>

#include "saltus/solve/solver.h"
#include "solve/phases/phase_solution.h"

namespace saltus {

// True when so many seconds are over (0: never), or when `stop` says so.
StopRequest StopAfter(double seconds, const StopRequest& stop);

class PhaseRun {
 public:
  // The clock of the report starts here.
  PhaseRun(std::string_view solver, const SolveRequest& request, const SolverOptions& options);
  // From a motion in place of the initial guess.
  PhaseRun(std::string_view solver, const SolveRequest& request, const SolverOptions& options, Trial start);

  const Scene& scene() const { return scene_; }
  const SolverOptions& options() const { return options_; }
  const std::vector<OwnTerm>& terms() const { return terms_; }
  const Trial& guess() const { return guess_; }
  // Why there is nothing to start from, as a report; otherwise nothing. The second also refuses what does not only have
  // impacts, the third an empty sequence too.
  std::optional<SolveReport> WhyNoMotion();
  std::optional<SolveReport> WhyNotStart();
  std::optional<SolveReport> WhyNot(const ContactSequence& sequence);

  // Appends the loss after another iteration. False if the callback wants to stop.
  bool Record(double loss);
  bool interrupted() const { return interrupted_; }
  bool IsOutOfIterations() const { return static_cast<int>(report_.losses.size()) > std::max(1, options_.iterations); }

  SolveReport& report() { return report_; }
  SolveReport Finish(const Trial& trial, double loss, Termination termination, std::string reason = {});

 private:
  SolveReport Refuse(Termination termination, std::string reason);

  std::chrono::steady_clock::time_point start_;
  const Scene& scene_;
  const std::vector<OwnTerm>& terms_;
  const SolverOptions& options_;
  Trial guess_;
  SolveReport report_;
  bool interrupted_ = false;
};

}  // namespace saltus
