#include "solve/phases/sequence_run.h"

#include <algorithm>
#include <utility>

namespace saltus {

StopRequest StopAfter(double seconds, const StopRequest& stop) {
  using Clock = std::chrono::steady_clock;
  if (seconds <= 0) return stop;
  const auto time = std::chrono::duration<double>(std::min(seconds, 1e9));
  return [stop, end = Clock::now() + std::chrono::duration_cast<Clock::duration>(time)] {
    return (stop && stop()) || Clock::now() >= end;
  };
}

double TimeLimit::SecondsLeft() const {
  constexpr double kLeast = 1e-9;  // 0 is no limit
  const std::chrono::duration<double> gone = std::chrono::steady_clock::now() - begin_;
  return seconds_ > 0 ? std::max(kLeast, seconds_ - gone.count()) : 0;
}

SequenceRun::SequenceRun(std::string_view solver, const SolverOptions& options)
    : options_(options), start_(std::chrono::steady_clock::now()) {
  report_.solver = solver;
}

bool SequenceRun::Record(double loss) {
  report_.history.losses.push_back(loss);
  const int iteration = static_cast<int>(report_.history.losses.size()) - 1;
  if (options_.monitor.stop && options_.monitor.stop()) interrupted_ = true;
  if (options_.monitor.callback && !options_.monitor.callback(iteration, loss)) interrupted_ = true;
  return !interrupted_;
}

SolveReport SequenceRun::Refuse(Termination termination, std::string reason) const {
  SolveReport refused;
  refused.contact = report_.contact;
  refused.solver = report_.solver;
  refused.termination = termination;
  refused.reason = std::move(reason);
  return refused;
}

void SequenceRun::FinishReport(double loss, Termination termination, std::string reason) {
  report_.termination = termination;
  report_.reason = std::move(reason);
  report_.guess.loss = report_.history.losses.front();
  report_.solution.loss = loss;
  report_.work.iterations = static_cast<int>(report_.history.losses.size()) - 1;
  report_.work.seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start_).count();
}

}  // namespace saltus
