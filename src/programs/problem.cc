#include "programs/problem.h"

#include <filesystem>

#include "programs/audit.h"
#include "programs/solve.h"

namespace saltus {

int ProblemMain(int argc, char** argv, const ProgramDefaults& defaults) {
  const std::string name = std::filesystem::path(defaults.scene).stem().string();
  return RunMain(argc, argv, "Gradients and optimisation of " + name + ". Defaults are those of the paper.", [&] {
    Request request;
    if (!ReadRequest(defaults, &request)) return kDone;
    const AuditReport audit = RunAudit(request);
    std::vector<SolvedRun> runs;
    if (!request.solvers.empty() && request.scene.optimize != Optimize::kNone) runs = SolveAll(request);
    if (request.json) {
      PrintJson({{"audit", AuditToJson(request, audit)}, {"solve", SolveToJson(request, runs)}}, request.precision);
    } else {
      PrintAuditTable(request, audit);
      if (!runs.empty()) PrintSolveTable(request, runs);
    }
    return std::max(AuditExitCode(request, audit), SolveExitCode(runs));
  });
}

}  // namespace saltus
