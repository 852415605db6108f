#include "solve/enough_steps.h"

#include <algorithm>
#include <cmath>
#include <numeric>
#include <utility>

#include "base/number_text.h"
#include "control/hybrid_shooting.h"
#include "optimality/hybrid_conditions.h"
#include "saltus/optimality/hybrid_certificate.h"
#include "saltus/solve/hybrid_solver.h"
#include "solve/solve_chain.h"

namespace saltus {
namespace {

constexpr int kMostRuns = 6;
constexpr double kSameLoss = 1e-8;     // relative
constexpr double kFarBelow = 1e-3;     // of the loss of a guess
constexpr double kNoLoss = 1e-9;       // of the loss where all has changed by its size
constexpr double kMoreAccurate = 0.1;  // of the error, with the steps that are chosen at the solution

// Whether the integration of a solution is less accurate than it can be, and than the tolerance. If there is no
// accurate motion, *why is the reason.
bool NeedsMoreSteps(const HybridProblem& problem, const SolveReport& report, std::string* why) {
  const HybridOptions& integration = problem.integration;
  if (report.history.losses.empty() || integration.steps_per_interval > 0) return false;
  if (report.solution.integration_error <= integration.tolerance) return false;
  HybridShooting accurate(problem);
  HybridShooting::Outcome outcome;
  if (!accurate.Simulate(SolutionOf(problem, report), &outcome)) {
    *why = accurate.FailureReason();
    return true;
  }
  // Where an event is at a jump of the control, other steps may have other events in the same motion.
  if (std::isinf(report.solution.integration_error)) {
    return std::abs(outcome.loss - report.solution.loss) > kSameLoss * std::abs(outcome.loss);
  }
  return accurate.simulator().IntegrationError() < kMoreAccurate * report.solution.integration_error;
}

// Whether a run from this loss has ended so far below it, without an optimum, that the sizes of its guess, to which its
// tolerances are relative, hide what is left. Adds the certificate that it looks at to the report.
bool NeedsNewSizes(const HybridProblem& problem, double initial_loss, SolveReport* report) {
  const bool is_far = std::isfinite(initial_loss) && report->solution.violation <= kFeasible &&
                      std::abs(report->solution.loss) <= kFarBelow * std::abs(initial_loss);
  const bool has_ended =
      report->termination == Termination::kConverged || report->termination == Termination::kNoProgress;
  if (!is_far || !has_ended) return false;
  if (!report->certificate) report->certificate = Certify(problem, SolutionOf(problem, *report));
  if (report->certificate->verdict != Certificate::Verdict::kNotStationary) return false;
  return !HasNoLoss(problem, *report);
}

}  // namespace

SolveReport SolveWithEnoughSteps(const HybridProblem& problem, const SolverOptions& options, const SolveFrom& solve,
                                 const std::function<bool(const SolveReport&)>& is_of_use) {
  SolveChain chain(options);
  SolveReport report = solve(problem, options);
  if (!is_of_use(report)) return report;
  chain.Add(report);
  double initial_loss = report.guess.loss;
  for (int run = 1;; ++run) {
    std::string why;
    if (report.termination == Termination::kInterrupted || report.history.losses.empty()) return report;
    const bool needs_steps = NeedsMoreSteps(problem, report, &why);
    if (needs_steps && (!why.empty() || run >= kMostRuns)) {
      report.termination = why.empty() ? Termination::kNoProgress : Termination::kFailed;
      report.reason +=
          (report.reason.empty() ? "" : "; ") +
          (why.empty() ? "the error of the integration at the solution is " +
                             ToText(report.solution.integration_error, 3) + ", which more steps would lower"
                       : "with the steps that the solution needs there is no motion: " + why);
      return report;
    }
    const bool needs_sizes = !needs_steps && run < kMostRuns && NeedsNewSizes(problem, initial_loss, &report);
    if (!needs_steps && (!needs_sizes || chain.IsOutOfIterations())) return report;
    HybridProblem from = problem;
    from.guess = SolutionOf(problem, report);
    from.guess_states.clear();
    SolveReport more = solve(ScaleConstraints(from, from.guess), chain.Next());
    if (more.history.losses.empty()) return report;
    initial_loss = more.guess.loss;
    const auto converged = [](const SolveReport& r) { return r.termination == Termination::kConverged; };
    if (more.work.iterations == 0 && converged(report) && converged(more))
      more.reason = report.reason;  // not of a guess
    chain.Add(more);
    report.solution.violation = more.guess.violation;  // relative to the new sizes
    const bool is_worse = needs_sizes && !EndsBetter(more, report) && !(more.solution.loss <= report.solution.loss);
    report = chain.Finish(is_worse ? std::move(report) : std::move(more));
    if (is_worse) return report;
  }
}

bool HasNoLoss(const HybridProblem& problem, const SolveReport& report) {
  const auto sizes = SizesOf(problem, SolutionOf(problem, report));
  return !sizes || std::abs(report.solution.loss) <= kNoLoss * sizes->asked_loss;
}

HybridInput SolutionOf(const HybridProblem& problem, const SolveReport& report) {
  HybridInput input = problem.guess;
  if (!report.solution.initial_state.empty()) input.initial = report.solution.initial_state;
  if (!report.solution.parameters.empty()) input.parameters = report.solution.parameters;
  if (!report.solution.control.empty()) input.control = report.solution.control;
  if (!report.solution.durations.empty()) {
    input.duration = std::accumulate(report.solution.durations.begin(), report.solution.durations.end(), 0.0);
    input.num_intervals = static_cast<int>(report.solution.durations.size());
    input.lengths = report.solution.durations;
  }
  return input;
}

}  // namespace saltus
