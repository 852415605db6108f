#include "solve/solve_chain.h"

#include <algorithm>
#include <cmath>
#include <optional>
#include <string>
#include <utility>

namespace saltus {

SolverOptions SolveChain::Next() const {
  SolverOptions next = options_;
  next.limits.iterations = std::max(0, options_.limits.iterations - iterations_);
  if (options_.monitor.callback) {
    next.monitor.callback = [&options = options_, before = iterations_](int iteration, double loss) {
      return options.monitor.callback(before + iteration, loss);
    };
  }
  return next;
}

void SolveChain::Add(const SolveReport& report) {
  seconds_ += report.work.seconds;
  evaluations_ += report.work.evaluations;
  if (report.history.losses.empty()) return;
  // The first loss of a solve takes the place of the last one before: no iteration lies between them.
  const auto join = [](auto* before, const auto& after) {
    if (!before->empty() && !after.empty()) before->pop_back();
    before->insert(before->end(), after.begin(), after.end());
  };
  if (losses_.empty()) initial_violation_ = report.guess.violation;
  const double initial_loss = losses_.empty() ? report.guess.loss : losses_.front();
  join(&losses_, report.history.losses);
  losses_.front() = initial_loss;
  join(&iterates_, report.history.iterates);
  last_ = iterations_;
  iterations_ = static_cast<int>(losses_.size()) - 1;
}

SolveReport SolveChain::Finish(SolveReport report) const {
  report.work.seconds = seconds_;
  report.work.evaluations = evaluations_;
  if (losses_.empty()) return report;
  if (report.history.best) report.history.best->iteration += last_;
  report.history.losses = losses_;
  report.history.iterates = iterates_;
  report.work.iterations = iterations_;
  report.guess.loss = losses_.front();
  report.guess.violation = initial_violation_;
  return report;
}

namespace {

constexpr double kLower = 1e-9;     // relative: losses that differ by less are the same
constexpr double kFarLower = 1e-2;  // relative: a loss that is lower by more is better even if it is no optimum
constexpr int kLeastShare = 200;    // iterations that a solver may take, if so many are left; else half of these

// Whether a loss is lower than another one by more than a part of it.
bool IsLower(double loss, double than, double part) { return loss < than - part * std::abs(than); }

// Whether a report is better than the best one so far: lower by far, or else as EndsBetter() says.
bool IsBetter(const SolveReport& report, const SolveReport& than) {
  const auto feasible = [](const SolveReport& r) {
    return !r.history.losses.empty() && r.solution.violation <= kFeasible;
  };
  if (feasible(report) && feasible(than)) {
    if (IsLower(report.solution.loss, than.solution.loss, kFarLower)) return true;
    if (IsLower(than.solution.loss, report.solution.loss, kFarLower)) return false;
  }
  return EndsBetter(report, than);
}

// Returns the remedy for a solve that has ended without an optimum; empty if it has one or was interrupted.
std::string RemedyFor(const SolveReport& report) {
  switch (report.termination) {
    case Termination::kIterationLimit:
      return "allow more iterations, or start from the solution";
    case Termination::kFailed:
      return "start from a guess that has a finite motion and finite derivatives";
    case Termination::kNoProgress:
      return report.solution.violation > kFeasible
                 ? "try another guess, a longer duration or wider bounds; mode_search tries other sequences of events"
                 : "try another guess or more control intervals; mode_search tries other sequences of events";
    default:
      return "";
  }
}

}  // namespace

bool EndsBetter(const SolveReport& report, const SolveReport& than) {
  const auto converged = [](const SolveReport& r) { return r.termination == Termination::kConverged; };
  if (report.history.losses.empty() || than.history.losses.empty()) return !report.history.losses.empty();
  if (converged(report) != converged(than)) return converged(report);
  const bool feasible = report.solution.violation <= kFeasible, other = than.solution.violation <= kFeasible;
  if (feasible != other) return feasible;
  return feasible ? report.solution.loss < than.solution.loss : report.solution.violation < than.solution.violation;
}

SolveReport SolveInTurn(const std::vector<std::string_view>& order, const std::vector<std::string_view>& refine,
                        const std::string& why, const SolverOptions& options, const SolveByName& solve,
                        const std::function<std::string(const SolveReport&)>& find_loss_of_reach) {
  SolveChain chain(options);
  std::optional<SolveReport> best, refused;
  std::string tried, out_of_reach;  // the latter: of an optimum found before
  double loss_out_of_reach = 0;
  std::pair<double, std::string> lowest = {INFINITY, ""};  // feasible losses of solves without an optimum
  int left = options.limits.iterations;  // of which a solve in several turns takes no more than it may in one
  const auto solve_within = [&](std::string_view name, int most, const SolveReport* from) {
    SolverOptions next = chain.Next();
    next.limits.iterations = most;
    SolveReport report = solve(name, next, from);
    if (report.termination == Termination::kNotApplicable) return report;
    left -= std::clamp(report.work.iterations, 0, most);
    chain.Add(report);
    return report;
  };
  const auto share_of = [&](std::string_view name, const std::vector<std::string_view>& names) {
    return name == names.back() ? left : std::min(left, std::max(kLeastShare, left / 2));
  };
  for (const std::string_view name : order) {
    SolveReport report = solve_within(name, share_of(name, order), /*from=*/nullptr);
    if (report.termination == Termination::kNotApplicable) {
      if (!refused) {
        refused = std::move(report);
        refused->solver = name;
      }
      continue;
    }
    tried += (tried.empty() ? "" : ", then ") + std::string(name);
    const bool interrupted = report.termination == Termination::kInterrupted,
               converged = report.termination == Termination::kConverged;
    const std::string lost = converged && find_loss_of_reach ? find_loss_of_reach(report) : "";
    const bool lower = !out_of_reach.empty() && report.solution.violation <= kFeasible &&
                       !report.history.losses.empty() && IsLower(report.solution.loss, loss_out_of_reach, kLower);
    if (!lost.empty() && out_of_reach.empty()) {
      out_of_reach = std::string(name) + " has converged, but " + lost;
      loss_out_of_reach = report.solution.loss;
    }
    if (!converged && report.solution.violation <= kFeasible && !report.history.losses.empty()) {
      lowest = std::min(lowest, {report.solution.loss, std::string(name)});
    }
    if (!best || IsBetter(report, *best) || lower) best = std::move(report);
    const bool is_best = converged && best->termination == Termination::kConverged;
    if (interrupted) best->termination = Termination::kInterrupted;
    if (interrupted || (is_best && lost.empty()) || left <= 0) break;
  }
  if (!best) {
    refused->solver = "auto";
    return *refused;
  }
  const auto is_over = [&] {
    return best->history.losses.empty() || best->termination == Termination::kConverged ||
           best->termination == Termination::kInterrupted || left <= 0;
  };
  for (const std::string_view name : refine) {
    if (is_over()) break;
    SolveReport report = solve_within(name, share_of(name, refine), &*best);
    if (report.termination == Termination::kNotApplicable) continue;
    tried += ", then " + std::string(name) + " from the end of " + best->solver;
    const bool interrupted = report.termination == Termination::kInterrupted;
    if (IsBetter(report, *best)) best = std::move(report);
    if (interrupted) best->termination = Termination::kInterrupted;
  }
  if (best->termination == Termination::kNoProgress && left <= 0) best->termination = Termination::kIterationLimit;
  const bool tells = refused && refused->reason != why;
  std::string words = "auto used " + best->solver + ", as " + why;
  if (tried != best->solver) words += " (tried: " + tried + ")";
  if (tells) words += " (" + refused->solver + " does not apply: " + refused->reason + ")";
  if (!out_of_reach.empty()) words += "; " + out_of_reach;
  if (IsLower(lowest.first, best->solution.loss, kLower)) {
    words += "; " + lowest.second + " ended at a lower loss, at which it has proved no optimum";
  }
  if (!best->reason.empty()) words += "; " + best->reason;
  if (const std::string remedy = RemedyFor(*best); !remedy.empty()) words += "; " + remedy;
  best->reason = std::move(words);
  return chain.Finish(std::move(*best));
}

}  // namespace saltus
