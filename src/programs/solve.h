// Optimise a scene with chosen contact models and solvers.
#pragma once

#include <string>

#include "base/table.h"
#include "programs/program.h"
#include "programs/solve_output.h"

namespace saltus {

// The report's reason, and the remarks on its exact run.
std::string RemarkOn(const SolvedRun& run);

// Every contact model with every solver, contact models outermost, or without a solver the start under each; on all
// threads, in the same order whatever their number. Solvers that support exact contact only run with the event-driven
// model alone, if it is among those asked for. Interruption (SIGINT, under an InterruptGuard) leaves out the runs that
// were not begun.
SolvedRuns SolveAll(const Request& request);

// Returns the reason why a run is no answer, in a few words: it did not converge, its defects are open, or it ends
// worse than it began. Empty if it is one, and for solvers that are not applicable.
std::string WhyNoAnswer(const SolveReport& report);

Table RunTable(const SolvedRuns& solved);
void PrintSolveTable(const Request& request, const SolvedRuns& solved);
// The exit code of feedback studies: wrong input, with a message on stderr, if weights of the regulator differ so much
// that there is none.
int FeedbackExitCode(const NamedStudies& studies);
// The exit code: wrong input if no run asked for is applicable, failed if a run is no answer. Says why on stderr.
int SolveExitCode(const SolvedRuns& solved);

}  // namespace saltus
