// Optimise a scene with chosen contact models and solvers.
#pragma once

#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "base/table.h"
#include "programs/feedback_study.h"
#include "programs/json_output.h"
#include "programs/program.h"
#include "saltus/optimality/certificate.h"

namespace saltus {

// A solver's report with its solution re-simulated exactly, and certified if it is a control.
struct SolvedRun {
  SolveReport report;
  ExactRun exact;
  std::optional<Certificate> certificate;
  std::vector<double> final_state;        // B x 4, under its contact model; empty if that fails
  std::optional<double> duration;         // s, of the solution, where it was free
  bool simulated = false;                 // nothing was solved, and the start has a finite loss
  std::optional<FeedbackStudy> feedback;  // if asked for

  // Whether there is an initial state and a control to look at.
  bool HasSolution() const { return simulated || !report.losses.empty(); }
};

struct SolvedRuns {
  std::vector<SolvedRun> runs;
  bool interrupted = false;  // some are missing, or were at work
};

// Solves, re-simulates and certifies. Calls `keep` with the run as it is before it is checked.
SolvedRun SolveAndCheck(const Scene& scene, const std::string& solver, const Contact& contact, Precision precision,
                        const SolverOptions& options, const std::function<void(SolvedRun)>& keep);

// Solves, and simulates the result exactly.
SolvedRun SolveAndSimulate(const std::string& solver, const SolveRequest& request, const SolverOptions& options);

// Studies the feedback about the solution of a run, if it has one and the request asks for that.
void AddFeedback(const Request& request, int threads, SolvedRun* run);

// Whether a solver has converged; what was only simulated has not.
bool IsConvergence(const SolveReport& report);

// The largest defect of the solution; 0 of solvers without defects.
double LargestDefect(const SolveReport& report);

Json SolveToJson(const Request& request, const SolvedRuns& solved);

// The start of the scene under a contact model, with nothing changed: solver "none", its loss as `final_loss`, and no
// losses on the way. kFailed if the rollout fails, kNotApplicable if the model cannot take the scene.
SolvedRun SimulateOnly(const Request& request, const std::string& contact);

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

class Page;

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
std::string WhyNoAnswer(const SolveReport& report);

Table RunTable(const SolvedRuns& solved);
void PrintSolveTable(const Request& request, const SolvedRuns& solved);
// The exit code of feedback studies: wrong input, with a message on stderr, if weights of the regulator differ so much
// that there is none.
int FeedbackExitCode(const NamedStudies& studies);
// The exit code: wrong input if no run asked for is applicable, failed if a run is no answer. Says why on stderr.
int SolveExitCode(const SolvedRuns& solved);

}  // namespace saltus
