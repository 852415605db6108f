// The frame of every solver along sequences of events: it takes the time, collects losses, asks the callback, and
// writes the report.
#pragma once

#include <algorithm>
#include <chrono>
#include <string>
#include <string_view>

#include "saltus/solve/solver.h"
#include "solve/phases/augmented_lagrangian.h"

namespace saltus {

// Returns a request to stop after so many seconds (0: never), or when `stop` asks for it.
StopRequest StopAfter(double seconds, const StopRequest& stop);

// The limit of time of a search (SearchOptions::seconds) from now on, for the solves of several steps together.
class TimeLimit {
 public:
  explicit TimeLimit(const SolverOptions& options)
      : seconds_(options.sequences.limits.seconds), time_(StopAfter(seconds_, nullptr)), stop_(options.monitor.stop) {}
  // Returns whether the time is over; never if there is no limit.
  bool IsOver() const { return time_ && time_(); }
  // Returns a request to stop then, or when the options ask for it.
  StopRequest stop() const {
    if (!time_) return stop_;
    return [time = time_, stop = stop_] { return time() || (stop && stop()); };
  }
  // Returns the time that is left, at least a little; 0: no limit.
  double SecondsLeft() const;

 private:
  const double seconds_;
  const StopRequest time_, stop_;
  const std::chrono::steady_clock::time_point begin_ = std::chrono::steady_clock::now();
};

// The clock, the losses and the report of a solver along sequences of events.
class SequenceRun {
 public:
  // The clock of the report starts here. `options` must outlive this object.
  SequenceRun(std::string_view solver, const SolverOptions& options);

  const SolverOptions& options() const { return options_; }
  // Appends the loss after another iteration. Returns false if the callback wants to stop.
  bool Record(double loss);
  bool interrupted() const { return interrupted_; }
  // Returns the number of iterations that are left.
  int iterations_left() const {
    return std::max(0, options_.limits.iterations - std::max(0, static_cast<int>(report_.history.losses.size()) - 1));
  }
  bool IsOutOfIterations() const { return iterations_left() == 0; }
  SolveReport& report() { return report_; }
  // Returns the algorithm that minimises along a sequence.
  AugmentedLagrangian::Algorithm algorithm() const { return algorithm_; }
  void set_algorithm(AugmentedLagrangian::Algorithm algorithm) { algorithm_ = algorithm; }
  // Whether the run is one of a search, which has other starts (AugmentedLagrangian::Options::one_of_many), and to
  // which an optimum with a loss above `most_loss` is of no use.
  bool is_one_of_many() const { return one_of_many_; }
  double most_loss() const { return most_loss_; }
  void set_one_of_many(double most_loss) {
    one_of_many_ = true;
    most_loss_ = most_loss;
  }
  // Whether optima at which the loss has no kink are certified, and left where their certificate says that they are
  // none; a search certifies only those that it did not know.
  bool certifies() const { return certifies_; }
  void set_certifies(bool certifies) { certifies_ = certifies; }

 protected:
  SolveReport Refuse(Termination termination, std::string reason) const;
  // Sets the report of a run that ends with a loss, except for the motion and its violations.
  void FinishReport(double loss, Termination termination, std::string reason);

  const SolverOptions& options_;
  SolveReport report_;
  bool interrupted_ = false;

 private:
  AugmentedLagrangian::Algorithm algorithm_ = AugmentedLagrangian::Algorithm::kLeastSquares;
  bool one_of_many_ = false, certifies_ = true;
  double most_loss_ = INFINITY;
  std::chrono::steady_clock::time_point start_;
};

}  // namespace saltus
