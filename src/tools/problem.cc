#include "tools/problem.h"

#include <filesystem>
#include <iostream>

#include "output/interrupt.h"
#include "tools/audit.h"
#include "tools/audit_files.h"
#include "tools/launches.h"
#include "tools/solve.h"

namespace saltus {

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
    const auto write = [&] {
      WriteAuditFiles(request, audit);
      WriteSolutions(request, solved);
    };
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
    WriteAndPrint(write, print);
    return std::max(AuditExitCode(request, audit), SolveExitCode(solved));
  });
}

}  // namespace saltus
