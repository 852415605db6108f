#include "programs/problem.h"

#include <filesystem>
#include <iostream>
#include <vector>

#include "base/interrupt.h"
#include "base/table.h"
#include "exact/closed_forms.h"
#include "programs/audit.h"
#include "programs/program.h"
#include "programs/solve.h"

namespace saltus {
namespace {

constexpr char kLaunches[] = "Launches that hit the target exactly, under exact dynamics";
constexpr const char* kModes[] = {"frictionless", "slip", "stick"};

std::string Sequence(const LaunchSolution& launch) {
  std::string sequence;
  for (const ExactEvent& event : launch.events) sequence += (sequence.empty() ? "" : ", ") + event.b;
  return sequence.empty() ? "none" : sequence;
}

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

Table LaunchTable(const std::vector<LaunchSolution>& launches) {
  Table table(ColumnsOf("strikes; velocity x:12; velocity y:12; speed²:12; remark"));
  for (const LaunchSolution& launch : launches) {
    table.AddRow({Sequence(launch),
                  launch.velocity[0],
                  launch.velocity[1],
                  launch.velocity.squaredNorm(),
                  &launch == &launches.front() ? "minimum effort" : ""});
  }
  return table;
}

Json ToJson(const Request& request, const AuditReport& audit, const SolvedRuns& solved,
            const std::vector<LaunchSolution>& launches) {
  Json document = {{"audit", AuditToJson(request, audit)}, {"solve", SolveToJson(request, solved)}};
  if (!launches.empty()) document["launches"] = LaunchesToJson(launches);
  return document;
}

void PrintTables(const Request& request, const AuditReport& audit, const SolvedRuns& solved,
                 const std::vector<LaunchSolution>& launches) {
  PrintAuditTable(request, audit);
  if (!solved.runs.empty()) PrintSolveTable(request, solved);
  if (launches.empty()) return;
  std::cout << "\n" << kLaunches << "\n\n" << LaunchTable(launches).ToText(LayoutOfStandardOutput());
}

}  // namespace

int ProblemMain(int argc, char** argv, const ProgramDefaults& defaults) {
  const std::string name = std::filesystem::path(defaults.scene).stem().string();
  return RunMain(argc, argv, ProblemProgram(name), [&] {
    Request request;
    if (!ReadRequest(defaults, &request)) return kDone;
    const InterruptGuard guard;
    const AuditReport audit = RunAudit(request);
    SolvedRuns solved;
    if (!request.solvers.empty()) solved = SolveAll(request);
    std::vector<LaunchSolution> launches;
    if (!InterruptGuard::Interrupted()) launches = FindLaunches(request.scene);
    const auto print = [&] {
      if (request.json) return PrintJson(ToJson(request, audit, solved, launches), request.precision);
      PrintTables(request, audit, solved, launches);
    };
    DoAll({[&] {
             if (!request.output_dir.empty()) WriteAuditFiles(request, audit, AuditToJson(request, audit));
           },
           [&] { WriteSolutions(request, solved); },
           [&] {
             WriteReport(request, [&](Page* page) {
               AddAuditSections(request, audit, page);
               if (!solved.runs.empty()) AddSolveSections(request, solved, page);
               page->AddTableIfAny(LaunchTable(launches), kLaunches + std::string("."));
               page->SetResults(ToJson(WithoutStates(request), audit, solved, launches));
             });
           },
           print});
    PrintReportPath(request);
    return std::max(AuditExitCode(request, audit), SolveExitCode(solved));
  });
}

}  // namespace saltus
