#include "solve/search/global_search.h"

#include <algorithm>
#include <cstdio>
#include <utility>

#include "saltus/global/global_bound.h"
#include "saltus/simulate/exact_run.h"
#include "scene/units.h"
#include "solve/phases/ceres_event.h"
#include "solve/phases/phase_solution.h"
#include "solve/phases/sequence_run.h"
#include "solve/search/mode_search.h"

namespace saltus {
namespace {

constexpr double kWorkOfBox = 50;      // as SearchOptions::work
constexpr int kFineSteps = 4800;       // on which the best control is all but that of any number of intervals
constexpr double kRelativeGap = 1e-6;  // of the loss

// Solves along the sequence of the solution on more intervals, and takes the result if it is better, with a bound for
// controls on as many intervals.
void Refine(const SolveRequest& request, const SolverOptions& options, SolveReport* report) {
  if (request.scene.steps >= kFineSteps || !UnsupportedByEventPhases(request).empty()) return;
  const ExactRun run = SimulateExactly(request.scene,
                                       report->solution.initial_state,
                                       report->solution.control,
                                       report->solution.durations,
                                       options.monitor.stop);
  if (!run.ok || !run.only_impacts) return;
  SolveRequest fine = request;
  fine.scene.steps = kFineSteps;
  SolverOptions along = options;
  along.sequences.given = run.contacts;
  along.monitor.callback = nullptr;
  along.guess = ControlGuess{report->solution.control, report->solution.durations};
  // Without an impact there are no phases between impacts.
  SolveReport finer = run.contacts.empty() ? SolveByModeSearch(fine, along) : SolveByCeresEvent(fine, along);
  if (finer.solution.control.empty() || !(finer.solution.loss < report->solution.loss)) return;
  const ExactRun exact = SimulateExactly(request.scene,
                                         finer.solution.initial_state,
                                         finer.solution.control,
                                         finer.solution.durations,
                                         options.monitor.stop);
  if (!exact.ok || !(exact.loss < report->solution.loss)) return;
  report->solution.loss = exact.loss;
  report->history.losses.push_back(exact.loss);
  ++report->work.iterations;
  report->solution.initial_state = std::move(finer.solution.initial_state);
  report->solution.control = std::move(finer.solution.control);
  report->solution.durations = std::move(finer.solution.durations);
  report->certificate = std::move(finer.certificate);
  if (report->searched) report->searched->lower_bound = finer.searched ? finer.searched->lower_bound : 0;
}

std::string Digits(double number, int digits) {
  char text[40];
  std::snprintf(text, sizeof text, "%.*g", digits, number);
  return text;
}

// "striker-target and these again (6.2e-05 above)", of the least bounds in the list.
std::string Describe(const SolveRequest& request, const std::vector<SequenceBound>& bounds) {
  constexpr size_t kMost = 4;
  std::string text;
  for (size_t i = 0; i < std::min(bounds.size(), kMost); ++i) {
    const SequenceBound& bound = bounds[i];
    const bool again = std::ranges::count(bound.repeated, 1) > 0;
    text += (i == 0 ? "" : "; ") + ContactSequenceToString(request.scene, bound.sequence) +
            (bound.open ? " and any others"
             : again    ? " and these again"
                        : "") +
            ", at least " + Digits(ConvertLoss(bound.lower, request.scene.units, Units()), 6);
  }
  return text + (bounds.size() > kMost ? "; and " + std::to_string(bounds.size() - kMost) + " more" : "");
}

// The bound, the gap, and which sequences of impacts are excluded or left.
std::string Describe(const SolveRequest& request, const GlobalBound& bound, double gap) {
  const auto in_si = [&](double loss) { return ConvertLoss(loss, request.scene.units, Units()); };
  std::string text = "no control has a loss below " + Digits(in_si(bound.lower), 12) + ", a gap of " +
                     Digits(in_si(bound.upper) - in_si(bound.lower), 2) + " after " + std::to_string(bound.boxes) +
                     " boxes";
  if (!bound.excluded.empty()) text += "; excluded: " + Describe(request, bound.excluded);
  if (bound.gap() > gap && !bound.interrupted) {
    text +=
        "; this is the bound for forces of any shape, which more work does not raise: a control on more steps may "
        "have a smaller loss; raise steps";
  }
  if (bound.interrupted) {
    text += "; left: " + Describe(request, bound.left) + "; allow more with search_work or search_seconds";
  }
  return text;
}

}  // namespace

std::string UnsupportedByGlobalSearch(const SolveRequest& request) {
  if (std::string why = UnsupportedByModeSearch(request); !why.empty()) return why;
  return UnsupportedByGlobalBound(request.scene);
}

SolveReport SolveByGlobal(const SolveRequest& request, const SolverOptions& options) {
  const TimeLimit time(options);
  SolverOptions searching = options;
  searching.sequences.search = true;
  SolveReport report = SolveByModeSearch(request, searching);
  report.solver = "global";
  if (report.solution.control.empty() || report.termination == Termination::kInterrupted) return report;
  Refine(request, options, &report);

  const SearchOptions& limits = options.sequences.limits;
  GlobalOptions global{
      .gap = kRelativeGap * report.solution.loss,
      .seconds = time.SecondsLeft(),
      .boxes = static_cast<std::size_t>(std::max(limits.work > 0 ? 1.0 : 0.0, limits.work / kWorkOfBox)),
      .memory = limits.memory,
      .stop = options.monitor.stop};
  if (options.monitor.status) {
    global.progress = [&](const GlobalBound& bound) { options.monitor.status(Describe(request, bound, bound.gap())); };
  }
  const GlobalBound bound = BoundGlobally(request.scene, report.solution.loss, global);
  double lower = bound.lower;
  if (report.searched) {
    lower = std::max(report.searched->lower_bound, lower);
    report.searched->lower_bound = lower;
    report.searched->proof = {.gap = report.solution.loss - lower, .boxes = bound.boxes};
  }
  if (!report.certificate) {
    report.certificate = Certify(request.scene,
                                 report.solution.initial_state,
                                 report.solution.control,
                                 report.solution.durations,
                                 options.monitor.stop);
  }
  std::string proved = Describe(request, bound, global.gap);
  if (lower > bound.lower) {
    const double in_si = ConvertLoss(lower, request.scene.units, Units());
    proved = "no control on as many intervals has a loss below " + Digits(in_si, 12) + "; " + proved;
  }
  if (report.solution.loss - lower <= global.gap) {
    report.termination = Termination::kConverged;
    report.certificate->verdict = Certificate::Verdict::kGlobal;
    report.certificate->reason = proved;
  } else {
    report.termination = options.monitor.stop && options.monitor.stop() ? Termination::kInterrupted
                         : bound.interrupted                            ? Termination::kIterationLimit
                                                                        : Termination::kNoProgress;
    report.reason = proved;
  }
  return report;
}

}  // namespace saltus
