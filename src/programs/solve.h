// Optimise a scene with chosen contact models and solvers.
#pragma once

#include <optional>
#include <vector>

#include "programs/json_output.h"
#include "programs/program.h"

namespace saltus {

// A solver's report with its solution re-simulated exactly, and certified if it is a control.
struct SolvedRun {
  SolveReport report;
  ExactRun exact;
  std::optional<Certificate> certificate;
};

// The report's reason, and what is ambiguous in its exact run.
std::string RemarkOn(const SolvedRun& run);

// Every contact model with every solver, contact models outermost; on all threads, in the same order whatever their
// number. Solvers that know exact contact only run with the event-driven model alone, if it is among those asked for.
// Interruption (SIGINT) leaves the runs that were not started out.
std::vector<SolvedRun> SolveAll(const Request& request);

Json SolveToJson(const Request& request, const std::vector<SolvedRun>& runs);
void PrintSolveTable(const Request& request, const std::vector<SolvedRun>& runs);
// The exit code: wrong input if the only run asked for is not applicable, failed if a run failed.
int SolveExitCode(const std::vector<SolvedRun>& runs);

// `saltus_solve`.
int SolveMain(int argc, char** argv);

}  // namespace saltus
