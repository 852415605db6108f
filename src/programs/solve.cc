#include "programs/solve.h"

#include <algorithm>
#include <cmath>
#include <iostream>

#include "programs/parallel.h"
#include "programs/surrogate_flags.h"
#include "saltus/dynamics/registry.h"
#include "saltus/io/npz.h"
#include "saltus/io/table.h"

namespace saltus {
namespace {

void WriteSolutions(const Request& request, const std::vector<SolvedRun>& runs) {
  for (const SolvedRun& run : runs) {
    const SolveReport& report = run.report;
    if (report.losses.empty()) continue;
    const int64_t bodies = request.scene.num_bodies();
    const int64_t controlled = request.scene.num_controlled();
    NpzArrays arrays;
    arrays["loss"] = {{static_cast<int64_t>(report.losses.size())}, report.losses};
    arrays["initial_state"] = {{bodies, 4}, report.initial_state};
    if (controlled > 0) {
      const int64_t intervals = static_cast<int64_t>(report.control.size()) / (2 * controlled);
      arrays["control"] = {{intervals, controlled, 2}, report.control};
      if (!report.durations.empty()) arrays["durations"] = {{intervals}, report.durations};
    }
    if (report.surrogate) arrays["surrogate"] = {{1}, std::vector<std::string>{BiasedName(*report.surrogate)}};
    if (!report.standard_error.empty()) {
      arrays["standard_error"] = {{static_cast<int64_t>(report.standard_error.size())}, report.standard_error};
    }
    const std::string path = request.output_dir + "/" + request.scene.name + "_" + report.contact + "_" +
                             report.solver + FileSuffix(report.surrogate) + ".npz";
    const Status status = WriteNpz(path, arrays);
    if (!status.ok()) throw InputError(status.message());
  }
}

SolvedRun SolveAndCheck(const Scene& scene, const std::string& solver, const std::string& contact, Precision precision,
                        const SolverOptions& options) {
  SolvedRun run;
  run.report = Solve(solver, {scene, contact, precision}, options);
  const SolveReport& report = run.report;
  if (report.losses.empty()) return run;
  run.exact = SimulateExactly(scene, report.initial_state, report.control, report.durations);
  run.certificate = report.certificate;
  if (!run.certificate && scene.optimize == Optimize::kControl && scene.objective.effort > 0) {
    run.certificate = Certify(scene, report.initial_state, report.control, report.durations);
  }
  return run;
}

}  // namespace

std::string RemarkOn(const SolvedRun& run) {
  const std::string& reason = run.report.reason;
  if (run.exact.ambiguous.empty()) return reason;
  return reason + (reason.empty() ? "" : "; ") + "ambiguous: " + DescribeTies(run.exact.ambiguous, run.exact.spread);
}

std::vector<SolvedRun> SolveAll(const Request& request) {
  struct Job {
    std::string contact, solver;
  };
  std::vector<Job> jobs;
  const auto is_exact = [](const std::string& contact) { return FindContactModel(contact)->event_driven; };
  const bool any_exact = std::any_of(request.contacts.begin(), request.contacts.end(), is_exact);
  for (const std::string& contact : request.contacts) {
    for (const std::string& solver : request.solvers) {
      if (FindSolver(solver)->exact_only && any_exact && !is_exact(contact)) continue;
      jobs.push_back({contact, solver});
    }
  }
  const int count = static_cast<int>(jobs.size());
  std::vector<SolvedRun> runs(count);
  const InterruptGuard guard;
  Progress progress(request.progress, stderr, "solve " + request.scene.name, count);
  RunJobs(count, request.threads, &progress, [&](int i) {
    SolverOptions options = request.options;
    if (count == 1) options.threads = request.threads;
    options.callback = [](int, double) { return !InterruptGuard::Interrupted(); };
    options.status = [&](const std::string& note) { progress.Advance(0, note); };
    runs[i] = SolveAndCheck(request.scene, jobs[i].solver, jobs[i].contact, request.precision, options);
  });
  std::erase_if(runs, [](const SolvedRun& run) { return run.report.solver.empty(); });
  return runs;
}

Json SolveToJson(const Request& request, const std::vector<SolvedRun>& runs) {
  Json list = Json::array();
  for (const SolvedRun& run : runs) {
    const SolveReport& report = run.report;
    Json item = {{"contact", report.contact}, {"solver", report.solver}};
    AddBias(report.contact, report.surrogate, &item);
    if (!report.losses.empty()) {
      item["initial_loss"] = NumberToJson(report.initial_loss);
      item["final_loss"] = NumberToJson(report.final_loss);
      if (run.exact.ok) item["exact_loss"] = NumberToJson(run.exact.loss);
      item["losses"] = NumbersToJson(report.losses);
      item["iterations"] = report.iterations;
      item["evaluations"] = report.evaluations;
      item["seconds"] = report.seconds;
      if (!report.defects.empty()) {
        const std::vector<double>& defects = report.defects.back();
        item["defect"] = NumberToJson(*std::max_element(defects.begin(), defects.end()));
      }
    }
    item["termination"] = TerminationToString(report.termination);
    if (!report.reason.empty()) item["reason"] = report.reason;
    if (!report.losses.empty()) {
      item["events"] = EventsToJson(run.exact.events);
      AddTies(run.exact.ambiguous, run.exact.spread, &item);
      item["velocity"] = VectorsToJson(report.initial_state, 2);
      item["control"] = ControlToJson(request.scene, report.control);
      if (!report.standard_error.empty()) item["standard_error"] = NumbersToJson(report.standard_error);
      if (!report.durations.empty()) item["durations"] = NumbersToJson(report.durations);
      if (run.certificate) item["certificate"] = CertificateToJson(*run.certificate);
      if (!report.optima.empty()) item["optima"] = OptimaToJson(request.scene, report.optima);
      if (request.scene.optimize == Optimize::kPosition) item["position"] = VectorsToJson(report.initial_state, 0);
    }
    list.push_back(std::move(item));
  }
  return {{"scene", request.scene.name}, {"steps", request.scene.steps}, {"runs", std::move(list)}};
}

void PrintSolveTable(const Request& request, const std::vector<SolvedRun>& runs) {
  Table table({{"contact"},
               {"solver"},
               {"initial loss", 10},
               {"final loss", 10},
               {"exact loss", 10},
               {"iterations"},
               {"gradients"},
               {"seconds", 3},
               {"termination"},
               {"remark"}});
  for (const SolvedRun& run : runs) {
    const SolveReport& report = run.report;
    if (report.losses.empty()) {
      table.AddRow({LabelOf(report.contact, report.surrogate),
                    report.solver,
                    "",
                    "",
                    "",
                    "",
                    "",
                    "",
                    TerminationToString(report.termination),
                    report.reason});
      continue;
    }
    table.AddRow({LabelOf(report.contact, report.surrogate),
                  report.solver,
                  report.initial_loss,
                  report.final_loss,
                  run.exact.ok ? std::optional(run.exact.loss) : std::nullopt,
                  report.iterations,
                  report.evaluations,
                  report.seconds,
                  TerminationToString(report.termination),
                  RemarkOn(run)});
  }
  std::cout << request.scene.name << ": " << request.scene.steps << " steps\n\n" << table.ToText() << std::endl;
}

int SolveExitCode(const std::vector<SolvedRun>& runs) {
  const bool none = std::all_of(runs.begin(), runs.end(), [](const SolvedRun& run) {
    return run.report.termination == Termination::kNotApplicable;
  });
  if (!runs.empty() && none) {
    std::cerr << "error: " << runs[0].report.contact << " with " << runs[0].report.solver << ": "
              << runs[0].report.reason << std::endl;
    return kWrongInput;
  }
  for (const SolvedRun& run : runs) {
    if (run.report.termination == Termination::kFailed || run.report.termination == Termination::kInterrupted) {
      return kAnswerFailed;
    }
  }
  return kDone;
}

int SolveMain(int argc, char** argv) {
  return RunMain(
      argc, argv, "Optimises a scene: saltus_solve --scene=FILE [--contact=LIST] [--solver=LIST] [--json]", [] {
        Request request;
        if (!ReadRequest({}, &request)) return kDone;
        if (request.solvers.empty())
          throw InputError("--solver=none leaves nothing to do; expected at least one solver");
        const std::vector<SolvedRun> runs = SolveAll(request);
        if (!request.output_dir.empty()) WriteSolutions(request, runs);
        if (request.json) {
          PrintJson(SolveToJson(request, runs), request.precision);
        } else {
          PrintSolveTable(request, runs);
        }
        return SolveExitCode(runs);
      });
}

}  // namespace saltus
