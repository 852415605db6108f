#include "solve/phases/phase_run.h"

#include <utility>

#include "solve/phases/phase_plan.h"

namespace saltus {

StopRequest StopAfter(double seconds, const StopRequest& stop) {
  using Clock = std::chrono::steady_clock;
  if (seconds <= 0) return stop;
  const auto time = std::chrono::duration<double>(std::min(seconds, 1e9));
  return [stop, end = Clock::now() + std::chrono::duration_cast<Clock::duration>(time)] {
    return (stop && stop()) || Clock::now() >= end;
  };
}

PhaseRun::PhaseRun(std::string_view solver, const SolveRequest& request, const SolverOptions& options)
    : PhaseRun(solver, request, options, GuessTrial(request.scene, request.terms, options.guess)) {}

PhaseRun::PhaseRun(std::string_view solver, const SolveRequest& request, const SolverOptions& options, Trial start)
    : start_(std::chrono::steady_clock::now()),
      scene_(request.scene),
      terms_(request.terms),
      options_(options),
      guess_(std::move(start)) {
  report_.contact = request.contact.name();
  report_.solver = solver;
  if (guess_.exact.ok) Record(guess_.exact.loss);
}

std::optional<SolveReport> PhaseRun::WhyNoMotion() {
  if (!guess_.exact.ok) return Refuse(Termination::kFailed, guess_.exact.reason);
  return std::nullopt;
}

std::optional<SolveReport> PhaseRun::WhyNotStart() {
  if (auto refused = WhyNoMotion()) return refused;
  if (!guess_.exact.only_impacts) {
    return Refuse(Termination::kNotApplicable,
                  "from the initial guess discs rest on or graze each other or a plane; it knows impacts only");
  }
  return std::nullopt;
}

std::optional<SolveReport> PhaseRun::WhyNot(const ContactSequence& sequence) {
  if (auto refused = WhyNotStart()) return refused;
  if (sequence.empty()) {
    return Refuse(Termination::kNotApplicable, "there is no contact in the sequence; give one with --sequence");
  }
  return std::nullopt;
}

bool PhaseRun::Record(double loss) {
  report_.losses.push_back(loss);
  const int iteration = static_cast<int>(report_.losses.size()) - 1;
  if (options_.stop && options_.stop()) interrupted_ = true;
  if (options_.callback && !options_.callback(iteration, loss)) interrupted_ = true;
  return !interrupted_;
}

SolveReport PhaseRun::Refuse(Termination termination, std::string reason) {
  SolveReport refused;
  refused.contact = report_.contact;
  refused.solver = report_.solver;
  refused.termination = termination;
  refused.reason = std::move(reason);
  return refused;
}

SolveReport PhaseRun::Finish(const Trial& trial, double loss, Termination termination, std::string reason) {
  report_.termination = termination;
  report_.reason = std::move(reason);
  report_.initial_loss = report_.losses.front();
  report_.final_loss = loss;
  report_.initial_violation = ViolationOfAll(scene_, guess_);
  report_.final_violation = ViolationOfAll(scene_, trial);
  report_.iterations = static_cast<int>(report_.losses.size()) - 1;
  report_.initial_state = InitialOf(scene_, trial);
  report_.control = trial.control;
  report_.durations = trial.durations;
  report_.seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start_).count();
  return std::move(report_);
}

}  // namespace saltus
