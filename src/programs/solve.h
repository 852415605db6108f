// Optimise a scene with chosen contact models and solvers.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "base/table.h"
#include "programs/feedback_study.h"
#include "programs/json_output.h"
#include "programs/program.h"
#include "solve/checked_run.h"

namespace saltus {

// A run with the study of the feedback about its solution, if it was asked for.
struct SolvedRun : CheckedRun {
  std::string asked = {};  // the name of its solver in the request, such as auto
  std::optional<FeedbackStudy> feedback = {};
};

struct SolvedRuns {
  std::vector<SolvedRun> runs;
  bool interrupted = false;  // some are missing, or were at work
};

// Studies the feedback about the solution of a run, if it has one and the request asks for that.
void AddFeedback(const Request& request, int threads, SolvedRun* run);

// Whether a solver has converged; what was only simulated has not.
bool IsConvergence(const SolveReport& report);

// The largest defect of the solution; 0 of solvers without defects.
double LargestDefect(const SolveReport& report);

Json SolveToJson(const Request& request, const SolvedRuns& solved);

// One row for each design parameter of each run: its values in the scene and in the solution.
Table DesignTable(const Scene& scene, const SolvedRuns& solved);
// One row a run with a certificate: verdict, residual, smallest curvature and what they mean.
Table CertificateTable(const SolvedRuns& solved);
// Whether any row of that table has a curvature.
bool HasCurvatures(const SolvedRuns& solved);

// Returns the feedback studies of the runs that have one, by the label of the run.
NamedStudies StudiesOf(const SolvedRuns& solved);

// Every solution as an NPZ file in --output_dir, if there is one. Throws OutputError.
void WriteSolutions(const Request& request, const SolvedRuns& solved);

// Adds the table of runs, certificates, replay, trajectories, controls and learning curves.
void AddSolveSections(const Request& request, const SolvedRuns& solved, Page* page);
// Writes the report of runs into the output folder, if there is one. Throws OutputError.
void WriteSolveReport(const Request& request, const SolvedRuns& solved);

// The report's reason, and the remarks on its exact run.
std::string RemarkOn(const SolvedRun& run);

// Every contact model with every solver, contact models outermost, or without a solver the start under each; on all
// threads, in the same order whatever their number. Solvers that support exact contact only run with the event-driven
// model alone, if it is among those asked for. Interruption (SIGINT, under an InterruptGuard) leaves out the runs that
// were not begun.
SolvedRuns SolveAll(const Request& request);

// Returns the reason why a run is no answer, in a few words: it did not converge, its defects are open, or it ends
// worse than it began. Empty if it is one, and for solvers that are not applicable.
std::string ReasonNoSolution(const SolveReport& report);

Table RunTable(const SolvedRuns& solved);
void PrintSolveTable(const Request& request, const SolvedRuns& solved);
// The exit code: wrong input if no run asked for is applicable, failed if a run is no answer. Says why on stderr.
int SolveExitCode(const SolvedRuns& solved);

}  // namespace saltus
