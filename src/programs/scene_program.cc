// The programs of scenes: `saltus_audit`, `saltus_solve`, and one for each problem, which audits and solves.
#include <gflags/gflags.h>

#include <filesystem>
#include <iostream>
#include <new>
#include <vector>

#include "base/interrupt.h"
#include "base/table.h"
#include "exact/closed_forms.h"
#include "programs/audit.h"
#include "programs/input_files.h"
#include "programs/problem.h"
#include "programs/program.h"
#include "programs/solve.h"

DEFINE_string(given, "", "JSON file with an externally computed gradient to audit, with the keys that --json prints");
DECLARE_bool(fail_on_wrong);

namespace saltus {
namespace {

constexpr char kLaunches[] = "Launches that hit the target exactly, under exact dynamics";
constexpr const char* kModes[] = {"frictionless", "slip", "stick"};

// Returns launches, slowest first, which has the least effort. Empty if the scene is not of this kind (see
// FindLaunchSolutions) or optimizes something else than velocities.
std::vector<LaunchSolution> FindLaunches(const Scene& scene) {
  if (scene.optimize != Optimize::kVelocity) return {};
  return FindLaunchSolutions(scene);
}

// One object a launch: velocity, speed_squared, events, and minimum_effort: true for the slowest.
Json LaunchesToJson(const std::vector<LaunchSolution>& launches) {
  Json list = Json::array();
  for (const LaunchSolution& launch : launches) {
    Json events = Json::array();
    for (const ExactEvent& event : launch.events) {
      events.push_back(
          {{"time", event.time}, {"a", event.a}, {"b", event.b}, {"mode", kModes[static_cast<int>(event.mode)]}});
    }
    list.push_back({{"velocity", {launch.velocity[0], launch.velocity[1]}},
                    {"speed_squared", launch.velocity.squaredNorm()},
                    {"events", std::move(events)},
                    {"minimum_effort", list.empty()}});
  }
  return list;
}

Table LaunchTable(Json launches) {
  for (Json& launch : launches) {
    std::vector<std::string> struck;
    for (const Json& event : launch["events"]) struck.push_back(event["b"]);
    launch["strikes"] = struck.empty() ? "none" : Joined(struck);
    if (launch["minimum_effort"].get<bool>()) launch["remark"] = "minimum effort";
  }
  return TableOf(
      launches, "", "strikes; velocity x=velocity/0:12; velocity y=velocity/1:12; speed²=speed_squared:12; remark");
}

// The gradient in --given beside the reference.
struct GivenAudit {
  std::string name;
  std::vector<ExternalGradientEntry> entries;
};

Json GivenToJson(const GivenAudit& audit) {
  Json entries = Json::array();
  for (const ExternalGradientEntry& entry : audit.entries) {
    Json& item = entries.emplace_back();
    SALTUS_ADD_MEMBERS(&item, entry, entry, given, exact);
    item["verdict"] = VerdictToString(entry.verdict);
  }
  return {
      {"name", audit.name}, {"verdict", VerdictToString(WorstVerdict(audit.entries))}, {"entries", std::move(entries)}};
}

Table GivenTable(const std::vector<ExternalGradientEntry>& entries) {
  Table table(ColumnsOf("entry; given:5; exact:9; verdict"));
  for (const ExternalGradientEntry& entry : entries) {
    table.AddRow(
        {entry.entry, entry.given, entry.exact, Cell(VerdictToString(entry.verdict)).WithTone(ToneOf(entry.verdict))});
  }
  return table;
}

// Selects the parts that a program computes.
struct Parts {
  bool audit = false, solve = false;
};

// The results of a program; what it does not compute is missing.
struct Results {
  std::optional<AuditReport> audit;
  std::optional<GivenAudit> given;
  std::optional<SolvedRuns> solved;
  std::vector<LaunchSolution> launches;

  // Whether there are runs to show: a problem may be audited alone.
  bool HasRuns() const { return solved && (!audit || !solved->runs.empty()); }
};

// Returns the document of the audit, or of the runs; of a problem both are parts of one.
Json ToJson(const Request& request, const Results& results) {
  if (!results.audit) return SolveToJson(request, *results.solved);
  Json audit = AuditToJson(request, *results.audit);
  if (results.given) audit["given"] = GivenToJson(*results.given);
  if (!results.solved) return audit;
  Json document = {{"audit", std::move(audit)}, {"solve", SolveToJson(request, *results.solved)}};
  if (!results.launches.empty()) document["launches"] = LaunchesToJson(results.launches);
  return document;
}

// States are most of a document: where there is no memory for them, the rest is printed.
void PrintDocument(const Request& request, const Results& results) {
  const auto print = [&](const Request& what) { PrintJson(ToJson(what, results)); };
  try {
    return print(request);
  } catch (const std::bad_alloc&) {
    if (!request.states) throw;
  }
  HoldMemoryBackAgain();
  print(OmitStates(request));
  throw std::bad_alloc();
}

void PrintTables(const Request& request, const Results& results) {
  const TextLayout layout = LayoutOfStandardOutput();
  if (results.audit) PrintAuditTable(request, *results.audit);
  if (results.given) {
    std::cout << Paragraph(results.given->name + ": " + VerdictToString(WorstVerdict(results.given->entries)),
                           layout.width)
              << "\n"
              << GivenTable(results.given->entries).ToText(layout) << std::endl;
  }
  if (results.HasRuns()) PrintSolveTable(request, *results.solved);
  if (results.launches.empty()) return;
  std::cout << "\n" << kLaunches << "\n\n" << LaunchTable(LaunchesToJson(results.launches)).ToText(layout);
}

void AddSections(const Request& request, const Results& results, Page* page) {
  if (results.audit) AddAuditSections(request, *results.audit, page);
  if (results.HasRuns()) AddSolveSections(request, *results.solved, page);
  page->AddTableIfAny(LaunchTable(LaunchesToJson(results.launches)), kLaunches + std::string("."));
  page->SetResults(ToJson(OmitStates(request), results));
}

int RunSceneProgram(int argc, char** argv, const Program& program, const ProgramDefaults& defaults, Parts parts) {
  return RunMain(argc, argv, program, [&] {
    Request request;
    if (!ReadRequest(defaults, &request)) return kDone;
    const std::vector<SimulatorCommand> simulators = ReadSimulators();
    // Simulators are audited alone unless contact models are asked for too.
    if (!simulators.empty() && !IsGiven("contact")) request.contacts.clear();
    if (!simulators.empty() && request.options.surrogate) {
      throw InputError("--simulate: a simulator has no surrogate gradients; expected no --surrogate with it");
    }
    std::optional<ExternalGradient> given;
    if (!FLAGS_given.empty()) given = ReadExternalGradient(FLAGS_given, request.scene);
    const InterruptGuard guard;
    Results results;
    if (parts.audit) results.audit = RunAudit(request, given.has_value(), simulators);
    if (given && results.audit->reference) {
      results.given = {given->name, JudgeExternalGradient(request.scene, *given, *results.audit->reference)};
    }
    if (parts.solve) {
      results.solved = parts.audit && request.solvers.empty() ? SolvedRuns() : SolveAll(request);
    }
    if (parts.audit && parts.solve && !InterruptGuard::Interrupted()) results.launches = FindLaunches(request.scene);
    DoAll({[&] {
             if (results.audit) WriteAuditFiles(request, *results.audit);
           },
           [&] {
             if (results.solved) WriteSolutions(request, *results.solved);
           },
           [&] { WriteReport(request, [&](Page* page) { AddSections(request, results, page); }); },
           [&] { request.json ? PrintDocument(request, results) : PrintTables(request, results); }});
    PrintReportPath(request);
    int code = kDone;
    if (results.audit) code = AuditExitCode(request, *results.audit, simulators.size());
    if (results.solved) code = std::max(code, SolveExitCode(*results.solved));
    const bool wrong = FLAGS_fail_on_wrong && results.given && IsWrong(WorstVerdict(results.given->entries));
    return wrong ? std::max(code, kAnswerFailed) : code;
  });
}

}  // namespace

int AuditMain(int argc, char** argv) {
  return RunSceneProgram(argc, argv, FindProgram("saltus_audit"), {}, {.audit = true});
}

int SolveMain(int argc, char** argv) {
  return RunSceneProgram(argc, argv, FindProgram("saltus_solve"), {.scene = "", .solver = "auto"}, {.solve = true});
}

int ProblemMain(int argc, char** argv, const ProgramDefaults& defaults) {
  const std::string name = std::filesystem::path(defaults.scene).stem().string();
  return RunSceneProgram(argc, argv, ProblemProgram(name), defaults, {.audit = true, .solve = true});
}

}  // namespace saltus
