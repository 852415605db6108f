#include "programs/problem.h"

#include <filesystem>
#include <iostream>

#include "programs/audit.h"
#include "programs/launches.h"
#include "programs/solve.h"

namespace saltus {

int ProblemMain(int argc, char** argv, const ProgramDefaults& defaults) {
  const std::string name = std::filesystem::path(defaults.scene).stem().string();
  return RunMain(argc, argv, "Gradients and optimisation of " + name + ". Defaults are those of the paper.", [&] {
    Request request;
    if (!ReadRequest(defaults, &request)) return kDone;
    const AuditReport audit = RunAudit(request);
    std::vector<SolvedRun> runs;
    if (!request.solvers.empty()) runs = SolveAll(request);
    const std::vector<LaunchSolution> launches = FindLaunches(request.scene);
    if (request.json) {
      Json document = {{"audit", AuditToJson(request, audit)}, {"solve", SolveToJson(request, runs)}};
      if (!launches.empty()) document["launches"] = LaunchesToJson(launches);
      PrintJson(document, request.precision);
    } else {
      PrintAuditTable(request, audit);
      if (!runs.empty()) PrintSolveTable(request, runs);
      if (!launches.empty()) {
        std::cout << "\nLaunches that hit the target exactly, under exact dynamics\n\n"
                  << LaunchTable(launches).ToText();
      }
    }
    return std::max(AuditExitCode(request, audit), SolveExitCode(runs));
  });
}

}  // namespace saltus
