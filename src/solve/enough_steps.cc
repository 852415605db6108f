#include "solve/enough_steps.h"

#include <algorithm>
#include <cmath>
#include <iterator>
#include <numeric>
#include <utility>

#include "base/number_text.h"
#include "control/hybrid_shooting.h"
#include "saltus/solve/hybrid_solver.h"

namespace saltus {
namespace {

constexpr int kMostRuns = 6;
constexpr double kSameLoss = 1e-8;     // relative
constexpr double kMoreAccurate = 0.1;  // of the error, with the steps that are chosen at the solution

// Whether the integration of a solution is less accurate than it can be, and than the tolerance. If there is no
// accurate motion, *why says why.
bool NeedsMoreSteps(const HybridProblem& problem, const SolveReport& report, std::string* why) {
  const HybridOptions& integration = problem.integration;
  if (report.losses.empty() || integration.steps_per_interval > 0) return false;
  if (report.integration_error <= integration.tolerance) return false;
  HybridShooting accurate(problem);
  HybridShooting::Outcome outcome;
  if (!accurate.Simulate(SolutionOf(problem, report), &outcome)) {
    *why = accurate.WhyFailed();
    return true;
  }
  // Where an event is at a jump of the control, other steps may have other events in the same motion.
  if (std::isinf(report.integration_error)) {
    return std::abs(outcome.loss - report.final_loss) > kSameLoss * std::abs(outcome.loss);
  }
  return accurate.simulator().IntegrationError() < kMoreAccurate * report.integration_error;
}

// Adds a run that went on from the end of another one. Its first loss is that of the same point.
void Append(SolveReport more, SolveReport* report) {
  const auto join = [](auto* before, auto& after) {
    if (after.empty()) return;
    if (!before->empty()) before->pop_back();
    before->insert(before->end(), std::make_move_iterator(after.begin()), std::make_move_iterator(after.end()));
  };
  if (more.best) more.best->iteration += report->iterations;
  join(&report->losses, more.losses);
  join(&report->iterates, more.iterates);
  more.losses = std::move(report->losses);
  more.iterates = std::move(report->iterates);
  more.initial_loss = more.losses.front();
  more.initial_violation = report->initial_violation;
  more.iterations += report->iterations;
  more.evaluations += report->evaluations;
  more.seconds += report->seconds;
  *report = std::move(more);
}

}  // namespace

SolveReport SolveWithEnoughSteps(const HybridProblem& problem, const SolverOptions& options, const SolveFrom& solve) {
  SolveReport report = solve(problem.guess, options);
  for (int run = 1;; ++run) {
    std::string why;
    if (report.termination == Termination::kInterrupted || !NeedsMoreSteps(problem, report, &why)) return report;
    if (!why.empty() || run == kMostRuns) {
      report.termination = why.empty() ? Termination::kNoProgress : Termination::kFailed;
      report.reason += (report.reason.empty() ? "" : "; ") +
                       (why.empty() ? "the error of the integration at the solution is " +
                                          ToText(report.integration_error, 3) + ", which more steps would lower"
                                    : "with the steps that the solution needs there is no motion: " + why);
      return report;
    }
    SolverOptions rest = options;
    rest.iterations = std::max(0, options.iterations - report.iterations);
    if (options.callback) {
      rest.callback = [&options, before = report.iterations](int iteration, double loss) {
        return options.callback(before + iteration, loss);
      };
    }
    SolveReport more = solve(SolutionOf(problem, report), rest);
    if (more.losses.empty()) return report;
    Append(std::move(more), &report);
  }
}

HybridInput SolutionOf(const HybridProblem& problem, const SolveReport& report) {
  HybridInput input = problem.guess;
  if (!report.initial_state.empty()) input.initial = report.initial_state;
  if (!report.parameters.empty()) input.parameters = report.parameters;
  if (!report.control.empty()) input.control = report.control;
  if (!report.durations.empty()) {
    input.duration = std::accumulate(report.durations.begin(), report.durations.end(), 0.0);
    input.num_intervals = static_cast<int>(report.durations.size());
    input.lengths = report.durations;
  }
  return input;
}

}  // namespace saltus
