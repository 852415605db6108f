#include "programs/hybrid_program.h"

#include <gflags/gflags.h>

#include <algorithm>
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
    if (!entry->reason_not_applicable(problem).empty()) return {};
    return {name};
  }
  if (FLAGS_solver == kNoSolver) return {};
  return ReadNames("solver", FLAGS_solver, NameList(HybridSolvers()), "'all', 'none' or some of ");
}

void ReadHybridRequest(HybridRequest* request) {
  HybridProblem& problem = request->problem;
  ReadSet(&problem);
  if (FLAGS_steps < 0) throw InputError("--steps must be positive");
  if (IsGiven("steps") && !FLAGS_audit) {
    Resample(std::max(1, FLAGS_steps), &problem.guess, problem.system.num_controls());
  }
  if (const std::string wrong = Validate(problem); !wrong.empty()) throw InputError(wrong);
  request->solvers = ReadSolvers(problem);
  request->feedback = ReadFeedback(problem);
  request->options.monitor.stop = InterruptGuard::Interrupted;
  const std::vector<SimulatorCommand> commands = ReadSimulators();
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
};

// Returns the names of the variables that solvers change: of states at the start and of parameters, "duration", and
// "control".
Json FreeToJson(const HybridProblem& problem) {
  const HybridFree& free = problem.free;
  Json names = Json::array();
  for (const int i : free.initial) names.push_back(problem.system.StateName(problem.guess.mode, i));
  for (const int i : free.parameters) names.push_back(problem.system.ParameterName(i));
  if (free.duration) names.push_back("duration");
  if (free.control) names.push_back("control");
  return names;
}

HybridResults Compute(const HybridRequest& request) {
  const HybridProblem& problem = request.problem;
  HybridResults results;
  Json motion;
  const Json loss = HybridLossToJson(problem, request.states, &motion);
  Json& document = results.document;
  document = {{"program", request.name},
              {"system", HybridSystemToJson(problem.system)},
              {"guess", HybridInputToJson(problem.system, problem.guess)},
              {"free", FreeToJson(problem)},
              {"motion", std::move(motion)}};
  if (const HybridFree& free = problem.free; !free.control_min.empty() || !free.control_max.empty()) {
    document["control_bounds"] = {{"min", free.control_min}, {"max", free.control_max}};
  }
  document.update(loss);
  document["runs"] = Json::array();
  const std::size_t tasks = request.solvers.size() + request.schemes.size();
  Progress progress(request.progress, stderr, request.name, static_cast<std::int64_t>(tasks));
  progress.UnitsDiffer();
  const auto study = [&](const HybridInput& input, Json* item) {
    if (!request.feedback) return;
    (*item)["feedback"] =
        FeedbackToJson(StudyFeedback(problem, input, *request.feedback, request.threads), request.states);
  };
  if (request.solvers.empty()) study(problem.guess, &document);
  for (const std::string& solver : request.solvers) {
    progress.Advance(0, solver);
    results.reports.push_back(Solve(solver, problem, request.options));
    progress.Advance();
    results.reports.back().contact = request.name;
    document["runs"].push_back(HybridRunToJson(problem, results.reports.back(), request.states));
    if (results.reports.back().history.losses.empty()) continue;
    study(SolutionOf(problem, results.reports.back()), &document["runs"].back());
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

void PrintTables(const HybridRequest& request, const HybridResults& results) {
  const Json& document = results.document;
  const auto print = [](const std::string& text) {
    std::cout << Paragraph(text, LayoutOfStandardOutput().width) << "\n";
  };
  const Json& motion = document["motion"];
  if (motion.contains("failed")) {
    print(request.name + ": no motion: " + motion["failed"].get<std::string>());
  } else {
    PrintTableIfAny(request.name + ": events of the motion from the guess", EventsTable(motion));
    if (motion.contains("remark")) print(motion["remark"]);
  }
  if (document.contains("gradient")) {
    PrintTableIfAny(request.name + ": loss " + CellOf(document["loss"]).Display(12) + ", and its gradient",
                    GradientTable(document));
  } else {
    print(DescribeLoss(document));
  }
  PrintTableIfAny(request.name + ": solvers", RunsTable(document));
  PrintTableIfAny(request.name + ": solutions", SolutionTable(document));
  if (const NamedStudies studies = StudiesIn(document); !studies.empty()) PrintFeedback(request.name + ": ", studies);
  PrintTableIfAny(request.name + ": audit of time-stepping schemes", AuditsTable(document));
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
    if (results.reports[i].history.losses.empty()) continue;
    document["runs"][i]["motion"] = draw(SolutionOf(request.problem, results.reports[i]));
  }
  WriteTextFile(directory + "/report.html", HybridPage(std::move(document)).Render());
  WriteTextFile(directory + "/result.json", JsonText(results.document));
}

int ExitCode(const HybridResults& results) {
  SolvedRuns solved;
  for (const SolveReport& report : results.reports) {
    SolvedRun& run = solved.runs.emplace_back();
    run.report = report;
  }
  int code = std::max(SolveExitCode(solved), FeedbackExitCode(StudiesIn(results.document)));
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
  return RunMain(argc, argv, program, [&] {
    const InterruptGuard guard;
    if (FLAGS_solver == "list") {
      PrintList(HybridSolvers());
      return kDone;
    }
    HybridRequest request(read());
    ReadHybridRequest(&request);
    const HybridResults results = Compute(request);
    DoAll({[&] { WritePage(request, results); },
           [&] {
             if (request.json) {
               PrintJson(results.document);
             } else {
               PrintTables(request, results);
             }
           }});
    if (!request.json && !request.output_dir.empty()) std::cerr << request.output_dir << "/report.html" << std::endl;
    return ExitCode(results);
  });
}

}  // namespace saltus
