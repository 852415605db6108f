#include "programs/solved_run.h"

#include <algorithm>

#include "programs/simulated_run.h"
#include "programs/solution_files.h"
#include "programs/surrogate_flags.h"

namespace saltus {

double LargestDefect(const SolveReport& report) {
  if (report.defects.empty()) return 0;
  const std::vector<double>& last = report.defects.back();
  return *std::max_element(last.begin(), last.end());
}

SolvedRun SolveAndCheck(const Scene& scene, const std::string& solver, const Contact& contact, Precision precision,
                        const SolverOptions& options, const std::function<void(SolvedRun)>& keep) {
  SolvedRun run;
  run.report = Solve(solver, {scene, contact, precision}, options);
  const SolveReport& report = run.report;
  if (report.losses.empty()) return run;
  keep(run);
  CheckRun(scene, contact, precision, &run);
  return run;
}

bool IsConvergence(const SolveReport& report) {
  return report.termination == Termination::kConverged && report.solver != kNoSolver;
}

Json SolveToJson(const Request& request, const SolvedRuns& solved) {
  Json list = Json::array();
  for (const SolvedRun& run : solved.runs) {
    const SolveReport& report = run.report;
    Json item = {{"contact", report.contact}, {"solver", report.solver}};
    AddBias(report.contact, report.surrogate, &item);
    if (run.simulated) {
      item["loss"] = NumberToJson(report.final_loss);
      if (run.exact.ok) item["exact_loss"] = NumberToJson(run.exact.loss);
    }
    if (!report.losses.empty()) {
      item["initial_loss"] = NumberToJson(report.initial_loss);
      item["final_loss"] = NumberToJson(report.final_loss);
      if (run.exact.ok) item["exact_loss"] = NumberToJson(run.exact.loss);
      item["losses"] = NumbersToJson(report.losses);
      item["iterations"] = report.iterations;
      item["evaluations"] = report.evaluations;
      item["seconds"] = report.seconds;
      if (!report.defects.empty()) item["defect"] = NumberToJson(LargestDefect(report));
      if (report.best) {
        item["best_loss"] = NumberToJson(report.best->loss);
        item["best_iteration"] = report.best->iteration;
      }
    }
    item["termination"] = TerminationToString(report.termination);
    if (IsConvergence(report)) item["converged_under"] = report.contact;
    if (!report.reason.empty()) item["reason"] = report.reason;
    if (run.HasSolution()) {
      item["events"] = EventsToJson(run.exact.events);
      AddTies(run.exact.ambiguous, run.exact.spread, &item);
      item["velocity"] = VectorsToJson(request.scene, report.initial_state, 2);
      if (request.scene.Spins()) {
        item["angular_velocity"] = RotationsToJson(request.scene, report.initial_state, 1);
      }
      item["control"] = ControlToJson(request.scene, report.control);
      if (!report.standard_error.empty()) item["standard_error"] = NumbersToJson(report.standard_error);
      if (!report.durations.empty()) item["durations"] = NumbersToJson(report.durations);
      if (report.best && !report.best->initial_state.empty()) {
        item["best_velocity"] = VectorsToJson(request.scene, report.best->initial_state, 2);
        if (request.scene.Spins()) {
          item["best_angular_velocity"] = RotationsToJson(request.scene, report.best->initial_state, 1);
        }
        item["best_control"] = ControlToJson(request.scene, report.best->control);
        if (!report.best->durations.empty()) item["best_durations"] = NumbersToJson(report.best->durations);
        if (request.scene.optimize == Optimize::kPosition) {
          item["best_position"] = VectorsToJson(request.scene, report.best->initial_state, 0);
        }
      }
      if (run.certificate) item["certificate"] = CertificateToJson(request.scene, *run.certificate);
      if (report.searched) item["searched"] = SearchedToJson(*report.searched);
      if (!report.optima.empty()) item["optima"] = OptimaToJson(request.scene, report.optima);
      if (request.scene.optimize == Optimize::kPosition)
        item["position"] = VectorsToJson(request.scene, report.initial_state, 0);
      AddStates(request, run, &item);
    }
    list.push_back(std::move(item));
  }
  Json document = {{"scene", request.scene.name}, {"steps", request.scene.steps}, {"runs", std::move(list)}};
  if (request.states) {
    AddDrawn(request.scene, &document);
  }
  if (solved.interrupted) document["interrupted"] = true;
  return document;
}

}  // namespace saltus
