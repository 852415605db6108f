#include "programs/problem.h"

#include <filesystem>
#include <iostream>

#include "base/interrupt.h"
#include "programs/audit.h"
#include "programs/audit_files.h"
#include "programs/audit_report.h"
#include "programs/launches.h"
#include "programs/report_parts.h"
#include "programs/solution_files.h"
#include "programs/solve.h"
#include "programs/solve_report.h"

namespace saltus {
namespace {

void WriteReport(const Request& request, const AuditReport& audit, const SolvedRuns& solved) {
  if (request.output_dir.empty()) return;
  HtmlReport report = StartReport(request.scene);
  AddAuditSections(request, audit, &report);
  if (!solved.runs.empty()) AddSolveSections(request, solved, &report);
  FinishReport(request, &report);
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
      if (request.json) {
        Json document = {{"audit", AuditToJson(request, audit)}, {"solve", SolveToJson(request, solved)}};
        if (!launches.empty()) document["launches"] = LaunchesToJson(launches);
        PrintJson(document, request.precision);
      } else {
        PrintAuditTable(request, audit);
        if (!solved.runs.empty()) PrintSolveTable(request, solved);
        if (!launches.empty()) {
          std::cout << "\nLaunches that hit the target exactly, under exact dynamics\n\n"
                    << LaunchTable(launches).ToText(LayoutOfStandardOutput());
        }
      }
    };
    DoAll({[&] { WriteAuditFiles(request, audit); },
           [&] { WriteSolutions(request, solved); },
           [&] { WriteReport(request, audit, solved); },
           print});
    PrintReportPath(request);
    return std::max(AuditExitCode(request, audit), SolveExitCode(solved));
  });
}

}  // namespace saltus
