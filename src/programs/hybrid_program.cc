#include "programs/hybrid_program.h"

#include <gflags/gflags.h>

#include <algorithm>
#include <cmath>
#include <iostream>

#include "base/interrupt.h"
#include "base/table.h"
#include "blackbox/session.h"
#include "programs/feedback_study.h"
#include "programs/simulators.h"
#include "programs/solve.h"
#include "solve/control_guess.h"

DEFINE_string(
    set, "",
    "comma-separated name=value: parameters, components of the initial state, duration, and tolerance (of the "
    "integration, relative)");
DEFINE_bool(audit, false, "audit the system's own time-stepping scheme, or those of --simulate");

DECLARE_string(solver);
DECLARE_int32(steps);
DECLARE_bool(rate_per_time);
DECLARE_bool(width_sweep);

namespace saltus {

namespace {

struct HybridRequest : HybridTask, SolveFlags {
  explicit HybridRequest(HybridTask task) : HybridTask(std::move(task)) {}

  std::vector<std::shared_ptr<HybridScheme>> schemes;
};

// Returns the numbers that --set can change, by name.
std::vector<std::pair<std::string, double*>> PlacesOf(HybridProblem* problem) {
  const HybridSystem& system = problem->system;
  HybridInput& guess = problem->guess;
  std::vector<std::pair<std::string, double*>> places;
  for (int i = 0; i < system.num_parameters(); ++i) {
    places.emplace_back(system.ParameterName(i), &guess.parameters.at(i));
  }
  for (int i = 0; i < system.state_size(guess.mode); ++i) {
    places.emplace_back(system.StateName(guess.mode, i), &guess.initial.at(i));
  }
  places.emplace_back("duration", &guess.duration);
  places.emplace_back("tolerance", &problem->integration.tolerance);
  return places;
}

void ReadSet(HybridProblem* problem) {
  if (FLAGS_set.empty()) return;
  const auto places = PlacesOf(problem);
  std::vector<std::string> names;
  for (const auto& [name, place] : places) names.push_back(name);
  for (const auto& [name, value] : ReadAssignments("set", FLAGS_set, names)) {
    *std::ranges::find_if(places, [&](const auto& one) { return one.first == name; })->second = value;
  }
}

// Takes the guess's control on another number of intervals: the mean over each.
void Resample(int intervals, HybridInput* guess, int width) {
  if (!guess->control.empty()) guess->control = MeanOverSteps({guess->control, guess->lengths}, width, intervals);
  guess->num_intervals = intervals;
  guess->lengths.clear();
}

std::optional<FeedbackOptions> ReadFeedback(const HybridProblem& problem) {
  std::vector<std::string> states, controls;
  const HybridSystem& system = problem.system;
  for (int i = 0; i < system.state_size(problem.guess.mode); ++i) {
    states.push_back(system.StateName(problem.guess.mode, i));
  }
  for (int i = 0; i < system.num_controls(); ++i) controls.push_back(system.ControlName(i));
  return FeedbackFromFlags(states, controls);
}

std::vector<std::string> ReadSolvers(const HybridProblem& problem) {
  if (FLAGS_solver.empty()) {
    const std::string name = IsGiven("learning_rate") || FLAGS_rate_per_time ? "gd" : "auto";
    const auto entry = std::ranges::find(HybridSolvers(), name, &HybridSolverEntry::name);
    if (!entry->why_not(problem).empty()) return {};
    return {name};
  }
  if (FLAGS_solver == kNoSolver) return {};
  return ReadNames("solver", FLAGS_solver, NameList(HybridSolvers()), "'all', 'none' or some of ");
}

void ReadHybridRequest(const std::vector<std::string>& arguments, HybridRequest* request) {
  HybridProblem& problem = request->problem;
  ReadSet(&problem);
  if (FLAGS_steps < 0) throw InputError("--steps must be positive");
  if (IsGiven("steps") && !FLAGS_audit)
    Resample(std::max(1, FLAGS_steps), &problem.guess, problem.system.num_controls());
  if (const std::string wrong = WhatIsWrongWith(problem); !wrong.empty()) throw InputError(wrong);
  request->solvers = ReadSolvers(problem);
  request->feedback = ReadFeedback(problem);
  request->options.stop = InterruptGuard::Interrupted;
  const std::vector<SimulatorCommand> commands = ReadSimulators(arguments);
  if (FLAGS_audit && commands.empty() && request->extras.scheme == nullptr) {
    throw InputError("--audit: the system has no scheme of its own, expected --simulate=COMMAND with it");
  }
  if (FLAGS_audit && request->extras.scheme != nullptr) request->schemes.push_back(request->extras.scheme);
  for (const SimulatorCommand& command : commands) {
    request->schemes.push_back(
        std::make_shared<CommandScheme>(problem.system, OptionsOf(command, /*copies=*/1), request->extras.scene));
  }
  ReadSolveFlags({}, request);
  request->options.threads = request->threads;
}

struct HybridResults {
  Json document;
  std::vector<SolveReport> reports;
  std::vector<HybridAudit> audits;
  std::vector<std::pair<std::string, FeedbackStudy>> studies;  // of each solution; of the guess without solvers

  NamedStudies Studies() const {
    NamedStudies named;
    for (const auto& [label, study] : studies) named.emplace_back(label, &study);
    return named;
  }
};

HybridResults Compute(const HybridRequest& request) {
  const HybridProblem& problem = request.problem;
  HybridResults results;
  Json motion;
  const Json loss = HybridLossToJson(problem, request.states, &motion);
  Json& document = results.document;
  document = {{"program", request.name},
              {"system", HybridSystemToJson(problem.system)},
              {"guess", HybridInputToJson(problem.system, problem.guess)},
              {"motion", std::move(motion)}};
  if (const HybridFree& free = problem.free; !free.control_min.empty() || !free.control_max.empty()) {
    document["control_bounds"] = {{"min", free.control_min}, {"max", free.control_max}};
  }
  document.update(loss);
  document["runs"] = Json::array();
  const std::size_t tasks = request.solvers.size() + request.schemes.size();
  Progress progress(request.progress, stderr, request.name, static_cast<std::int64_t>(tasks));
  progress.UnitsDiffer();
  const auto study = [&](const std::string& label, const HybridInput& input, Json* item) {
    if (!request.feedback) return;
    results.studies.emplace_back(label, StudyFeedback(problem, input, *request.feedback, request.threads));
    (*item)["feedback"] = FeedbackToJson(results.studies.back().second, request.states);
  };
  if (request.solvers.empty()) study("initial guess", problem.guess, &document);
  for (const std::string& solver : request.solvers) {
    progress.Advance(0, solver);
    results.reports.push_back(Solve(solver, problem, request.options));
    progress.Advance();
    results.reports.back().contact = request.name;
    document["runs"].push_back(HybridRunToJson(problem, results.reports.back(), request.states));
    if (results.reports.back().losses.empty()) continue;
    study(solver, SolutionOf(problem, results.reports.back()), &document["runs"].back());
  }
  HybridAuditOptions options{.width_sweep = FLAGS_width_sweep, .stop = InterruptGuard::Interrupted};
  if (FLAGS_steps > 0) options.steps = FLAGS_steps;
  for (const std::shared_ptr<HybridScheme>& scheme : request.schemes) {
    progress.Advance(0, "audit of " + scheme->name());
    HybridAuditOptions limited = options;
    if (scheme != request.extras.scheme) {
      // A command is asked for two steps per variable for the Jacobian of each step, which take some 50 us each.
      limited.refinement.samples = 3;
      limited.refinement.budget = 5000;
    }
    results.audits.push_back(AuditScheme(problem, scheme.get(), limited));
    progress.Advance();
    document["audits"].push_back(HybridAuditToJson(problem, results.audits.back()));
  }
  return results;
}

// The derivatives of the loss by all but the control, whose norm stands for it.
Table GradientTable(const HybridProblem& problem, const Json& gradient) {
  Table table(ColumnsOf("variable; value:10; derivative of the loss:10"));
  const HybridInput& guess = problem.guess;
  for (int i = 0; i < static_cast<int>(guess.initial.size()); ++i) {
    const std::string name = problem.system.StateName(guess.mode, i) + " at the start";
    table.AddRow({name, guess.initial[i], CellOf(gradient["initial"][i])});
  }
  for (int i = 0; i < static_cast<int>(guess.parameters.size()); ++i) {
    table.AddRow({problem.system.ParameterName(i), guess.parameters[i], CellOf(gradient["parameters"][i])});
  }
  table.AddRow({"duration", guess.duration, CellOf(gradient["duration"])});
  double sum = 0;
  for (const Json& row : gradient["control"]) {
    for (const Json& entry : row) sum += std::pow(entry.get<double>(), 2);
  }
  if (!gradient["control"].empty()) table.AddRow({"control (norm)", Cell(), std::sqrt(sum)});
  return table;
}

Table RunsTable(const std::vector<SolveReport>& reports) {
  Table table(ColumnsOf(
      "solver; initial loss:10; final loss:10; iterations; gradients; seconds:3; termination; certificate; remark"));
  for (const SolveReport& report : reports) {
    const bool ran = !report.losses.empty();
    const auto of = [&](const auto& value) { return ran ? Cell(value) : Cell(); };
    table.AddRow({report.solver,
                  of(report.initial_loss),
                  of(report.final_loss),
                  of(report.iterations),
                  of(report.evaluations),
                  of(report.seconds),
                  TerminationToString(report.termination),
                  report.certificate ? VerdictInWords(*report.certificate) : "",
                  report.reason});
  }
  return table;
}

// Returns the optimised variables of each solver, without the control.
Table SolutionTable(const HybridProblem& problem, const std::vector<SolveReport>& reports) {
  std::vector<Column> columns = ColumnsOf("variable; guess:10");
  std::vector<HybridInput> solutions;
  for (const SolveReport& report : reports) {
    if (report.losses.empty()) continue;
    columns.push_back({report.solver, 16});
    solutions.push_back(SolutionOf(problem, report));
  }
  Table table(columns);
  if (solutions.empty()) return table;
  const auto add = [&](const std::string& name, const auto& value_of) {
    std::vector<Cell> row = {name, value_of(problem.guess)};
    for (const HybridInput& solution : solutions) row.push_back(value_of(solution));
    table.AddRow(std::move(row));
  };
  for (const int i : problem.free.initial) {
    add(problem.system.StateName(problem.guess.mode, i), [i](const HybridInput& input) { return input.initial[i]; });
  }
  for (const int i : problem.free.parameters) {
    add(problem.system.ParameterName(i), [i](const HybridInput& input) { return input.parameters[i]; });
  }
  if (problem.free.duration) add("duration", [](const HybridInput& input) { return input.duration; });
  return table;
}

Table AuditsTable(const std::vector<HybridAudit>& audits) {
  Table table(ColumnsOf("scheme; verdict; steps; loss:8; exact loss:8; order:3; finest error:3; reason"));
  for (const HybridAudit& audit : audits) {
    double error = 0;
    const bool studied = audit.refinement && audit.refinement->ok();
    for (const QuantityStudy& quantity : studied ? audit.refinement->quantities : std::vector<QuantityStudy>()) {
      error = std::max(error, quantity.levels.back().error);
    }
    table.AddRow({audit.scheme,
                  Cell(VerdictToString(audit.verdict)).With(IsWrong(audit.verdict) ? Tone::kBad : Tone::kPlain),
                  audit.steps,
                  audit.ok() ? Cell(audit.loss) : Cell(),
                  audit.ok() ? Cell(audit.exact_loss) : Cell(),
                  studied ? Cell(audit.order) : Cell(),
                  studied ? Cell(error) : Cell(),
                  audit.Why()});
  }
  return table;
}

void PrintTables(const HybridRequest& request, const HybridResults& results) {
  const TextLayout layout = LayoutOfStandardOutput();
  const Json& document = results.document;
  const Json& motion = document["motion"];
  if (motion.contains("failed")) {
    std::cout << Paragraph(request.name + ": no motion: " + motion["failed"].get<std::string>(), layout.width) << "\n";
  } else {
    PrintTableIfAny(request.name + ": events of the motion from the guess",
                    TableOf(Json::array({motion}), "/events", "event=#; time:12; mode; guard; next mode"));
    if (motion.contains("remark")) std::cout << Paragraph(motion["remark"].get<std::string>(), layout.width) << "\n";
  }
  if (document.contains("gradient")) {
    PrintTableIfAny(request.name + ": loss " + CellOf(document["loss"]).Display(12) + ", and its gradient",
                    GradientTable(request.problem, document["gradient"]));
  } else {
    const std::string what = document.contains("loss")
                                 ? "Loss " + CellOf(document["loss"]).Display(12) + ", without a gradient: "
                                 : "No loss: ";
    std::cout << Paragraph(what + document["failed"].get<std::string>(), layout.width) << "\n";
  }
  PrintTableIfAny(request.name + ": solvers", RunsTable(results.reports));
  PrintTableIfAny(request.name + ": solutions", SolutionTable(request.problem, results.reports));
  if (!results.studies.empty()) {
    PrintFeedback(request.name + ": ", *request.feedback, results.Studies());
  }
  PrintTableIfAny(request.name + ": audit of time-stepping schemes", AuditsTable(results.audits));
}

// One file: the page with the document in it.
void WritePage(const HybridRequest& request, const HybridResults& results) {
  const std::string& directory = request.output_dir;
  if (directory.empty()) return;
  Json document = results.document;
  const auto draw = [&](const HybridInput& input) {
    return DrawnMotionToJson(request.problem, input, request.extras.draw);
  };
  document["motion"] = draw(request.problem.guess);
  for (std::size_t i = 0; i < results.reports.size(); ++i) {
    if (results.reports[i].losses.empty()) continue;
    document["runs"][i]["motion"] = draw(SolutionOf(request.problem, results.reports[i]));
  }
  WriteTextFile(directory + "/report.html", RenderPage(document));
  WriteTextFile(directory + "/result.json", results.document.dump(1) + "\n");
}

int ExitCode(const HybridResults& results) {
  SolvedRuns solved;
  for (const SolveReport& report : results.reports) {
    SolvedRun& run = solved.runs.emplace_back();
    run.report = report;
  }
  int code = std::max(SolveExitCode(solved), FeedbackExitCode(results.Studies()));
  for (const HybridAudit& audit : results.audits) {
    const bool none = !audit.ok() && audit.verdict == Verdict::kUnknown;
    if (none) std::cerr << "audit of " << audit.scheme << ": " << audit.reason << std::endl;
    if (none || IsWrong(audit.verdict)) code = std::max(code, kAnswerFailed);
  }
  if (!results.document.contains("loss")) code = std::max(code, kAnswerFailed);
  return code;
}

}  // namespace

int RunHybridProgram(int argc, char** argv, const Program& program, const std::function<HybridTask()>& read) {
  const std::vector<std::string> arguments(argv, argv + argc);
  return RunMain(argc, argv, program, [&] {
    const InterruptGuard guard;
    if (FLAGS_solver == "list") {
      PrintList(HybridSolvers());
      return kDone;
    }
    HybridRequest request(read());
    ReadHybridRequest(arguments, &request);
    const HybridResults results = Compute(request);
    DoAll({[&] { WritePage(request, results); },
           [&] {
             if (request.json) {
               PrintJson(results.document, Precision::kDouble);
             } else {
               PrintTables(request, results);
             }
           }});
    if (!request.json && !request.output_dir.empty()) std::cerr << request.output_dir << "/report.html" << std::endl;
    return ExitCode(results);
  });
}

}  // namespace saltus
