#include "programs/solve.h"

#include <algorithm>
#include <iostream>
#include <new>

#include "base/interrupt.h"
#include "control/surrogate_names.h"
#include "programs/parallel.h"
#include "saltus/simulate/registry.h"

namespace saltus {
namespace {

constexpr double kOpenDefect = 1e-9;  // m, m/s

// The reason of a run and the remarks on it, each text once.
std::string ReasonAndRemarks(const SolvedRun& run, const Remarks& remarks) {
  std::string text = run.report.reason;
  for (const Remark& remark : remarks) {
    if (text.find(remark.text) == std::string::npos) text += (text.empty() ? "" : "; ") + remark.text;
  }
  return text;
}

SolvedRun MakeRunWithoutLosses(const std::string& solver, const std::string& contact, Termination termination,
                               const std::string& reason) {
  SolvedRun run;
  run.report.solver = solver;
  run.report.contact = contact;
  run.report.termination = termination;
  run.report.reason = reason;
  return run;
}

// A solver has converged on the loss under its contact model, which need not be near an optimum of the exact one.
std::string TerminationInWords(const SolveReport& report) {
  const bool elsewhere = IsConvergence(report) && !FindContactModel(report.contact)->event_driven;
  return TerminationToString(report.termination) + (elsewhere ? " under " + report.contact : std::string());
}

// Runs that are refused for one reason: each of these solvers with each of these contact models.
struct Refusal {
  std::vector<std::string> contacts, solvers;
  std::string reason;
};

// Returns the refusals: solvers that one contact model refuses for one reason are joined, and then contact models that
// refuse the same solvers.
std::vector<Refusal> RefusalsOf(const SolvedRuns& solved) {
  using Names = std::vector<std::string> Refusal::*;
  // Adds a refusal, or its only name in `joined` to one that differs in nothing else.
  const auto add = [](const Refusal& added, Names same, Names joined, std::vector<Refusal>* refusals) {
    const auto found = std::ranges::find_if(
        *refusals, [&](const Refusal& one) { return one.reason == added.reason && one.*same == added.*same; });
    if (found == refusals->end()) return refusals->push_back(added);
    ((*found).*joined).push_back((added.*joined).front());
  };
  std::vector<Refusal> of_contacts, refusals;
  for (const SolvedRun& run : solved.runs) {
    const SolveReport& report = run.report;
    if (report.termination != Termination::kNotApplicable) continue;
    const Refusal refusal{{LabelOf(report.contact, report.surrogate)}, {report.solver}, report.reason};
    add(refusal, &Refusal::contacts, &Refusal::solvers, &of_contacts);
  }
  for (const Refusal& refusal : of_contacts) add(refusal, &Refusal::solvers, &Refusal::contacts, &refusals);
  return refusals;
}

}  // namespace

SolvedRuns SolveAll(const Request& request) {
  struct Task {
    std::string contact, solver;
  };
  std::vector<Task> tasks;
  std::vector<std::string> names;
  const auto is_exact = [](const std::string& contact) { return FindContactModel(contact)->event_driven; };
  const bool any_exact = std::ranges::any_of(request.contacts, is_exact);
  for (const std::string& contact : request.contacts) {
    for (const std::string& solver : request.solvers) {
      if (FindSolver(solver)->exact_only && any_exact && !is_exact(contact)) continue;
      tasks.push_back({contact, solver});
      names.push_back(contact + " " + solver);
    }
    if (request.solvers.empty()) {
      tasks.push_back({contact, kNoSolver});
      names.push_back(contact);
    }
  }
  Progress progress(request.progress, stderr, "solve " + request.scene.name, static_cast<int64_t>(tasks.size()));
  const auto done = ComputeAll<SolvedRun>(
      names, request.threads, &progress, [request, tasks](int i, const SayNote& say, const auto& keep) {
        const auto& [contact, solver] = tasks[i];
        SolverOptions options = request.options;
        if (tasks.size() == 1) options.threads = request.threads;
        options.monitor.stop = IsStopRequested;
        options.monitor.status = say;
        try {
          const SolveRequest task{request.scene, contact, request.precision};
          const auto stop = InterruptGuard::GraceIsOver;
          SolvedRun run{solver == kNoSolver ? SimulateAndCheck(task, request.start, stop)
                                            : SolveAndCheck(solver, task, options, stop, [&](CheckedRun at) {
                                                keep({std::move(at)});
                                              })};
          if (request.feedback) keep(run);
          AddFeedback(request, options.threads, &run);
          return run;
        } catch (const std::bad_alloc&) {
          HoldMemoryBackAgain();
          return MakeRunWithoutLosses(solver, contact, Termination::kFailed, kMemoryRanOut);
        }
      });
  SolvedRuns solved;
  solved.interrupted = !done.complete;
  for (size_t i = 0; i < tasks.size(); ++i) {
    if (!done.started[i]) continue;
    solved.runs.push_back(done.results[i].value_or(
        MakeRunWithoutLosses(tasks[i].solver, tasks[i].contact, Termination::kInterrupted, "")));
    solved.runs.back().asked = tasks[i].solver;
    solved.interrupted |= solved.runs.back().report.termination == Termination::kInterrupted;
  }
  return solved;
}

std::string ReasonNoSolution(const SolveReport& report) {
  if (report.termination == Termination::kNotApplicable) return "";
  if (report.termination == Termination::kFailed) return "failed, " + report.reason;
  if (report.termination != Termination::kConverged) return TerminationToString(report.termination);
  if (LargestDefect(report) > kOpenDefect) return "open defects";
  return EndsWorse(report) ? "ends worse than it began" : "";
}

Table RunTable(const SolvedRuns& solved) {
  Table table(ColumnsOf("contact; solver; initial loss:10; final loss:10; exact loss:10; duration (s):6; iterations; "
                        "gradients; seconds:3; termination; remark"),
              2);
  for (const SolvedRun& run : solved.runs) {
    const SolveReport& report = run.report;
    if (report.termination == Termination::kNotApplicable) continue;  // below
    const bool ran = run.HasSolution(), solved_it = !report.history.losses.empty();
    const auto of_run = [&](const auto& value) { return ran ? Cell(value) : Cell(); };
    const auto of_solver = [&](const auto& value) { return solved_it ? Cell(value) : Cell(); };
    table.AddRow({LabelOf(report.contact, report.surrogate),
                  report.solver,
                  of_solver(report.guess.loss),
                  of_run(report.solution.loss),
                  run.exact.ok ? of_run(run.exact.loss) : Cell(),
                  run.duration,
                  of_solver(report.work.iterations),
                  of_solver(report.work.evaluations),
                  of_run(report.work.seconds),
                  TerminationInWords(report),
                  ran ? ReasonAndRemarks(run, RemarksOn(run)) : report.reason});
  }
  for (const Refusal& refusal : RefusalsOf(solved)) {
    std::vector<Cell> row(table.columns().size());
    row[0] = FirstOf(refusal.contacts);
    row[1] = FirstOf(refusal.solvers);
    row[row.size() - 2] = TerminationToString(Termination::kNotApplicable);
    row.back() = refusal.reason;
    table.AddRow(std::move(row));
  }
  return table;
}

void PrintSolveTable(const Request& request, const SolvedRuns& solved) {
  const std::string name = request.scene.name + ": ";
  PrintTable(name + std::to_string(request.scene.steps) + " steps", RunTable(solved));
  PrintTableIfAny(name + "parameters that were optimized, SI units", DesignTable(request.scene, solved));
  PrintTableIfAny(
      name + "certificates of the exact loss, stationary with a residual of at most " +
          Format("%g", kCertificateTolerance) +
          (HasCurvatures(solved) ? ", a minimum with positive curvature (1 is that of the effort alone)" : ""),
      CertificateTable(solved));
  const NamedStudies studies = StudiesOf(solved);
  if (!studies.empty()) PrintFeedback(name, studies);
}

std::string RemarkOn(const SolvedRun& run) {
  return ReasonAndRemarks(run, run.HasSolution() ? RemarksOn(run.exact) : Remarks());
}

int SolveExitCode(const SolvedRuns& solved) {
  const std::vector<SolvedRun>& runs = solved.runs;
  const bool none = std::ranges::all_of(
      runs, [](const SolvedRun& run) { return run.report.termination == Termination::kNotApplicable; });
  if (!runs.empty() && none && !solved.interrupted) {
    std::cerr << "error: " << runs[0].report.contact << " with " << runs[0].report.solver << ": "
              << runs[0].report.reason << std::endl;
    return kWrongInput;
  }
  if (const int code = FeedbackExitCode(StudiesOf(solved)); code != kDone) return code;
  std::vector<std::string> failed;
  for (const SolvedRun& run : runs) {
    const std::string why = ReasonNoSolution(run.report);
    if (!why.empty()) failed.push_back(run.report.contact + " " + run.report.solver + ": " + why);
  }
  if (!failed.empty()) {
    std::cerr << "no answer from " << failed.size() << " of " << runs.size() << " runs (" << FirstOf(failed) << ")"
              << std::endl;
  }
  return !failed.empty() || solved.interrupted ? kAnswerFailed : kDone;
}

}  // namespace saltus
