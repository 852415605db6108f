// A run of a solver with its solution checked, as every output reports it. No flags: for programs and the Python
// module.
#pragma once

#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "programs/feedback_study.h"
#include "programs/json_output.h"
#include "programs/motion.h"
#include "programs/program.h"

namespace saltus {

// A solver's report with its solution re-simulated exactly, and certified if it is a control.
struct SolvedRun {
  SolveReport report;
  ExactRun exact;
  std::optional<Certificate> certificate;
  std::vector<double> final_state;        // B x 4, under its contact model; empty if that fails
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

// Whether a solver has converged; what was only simulated has not.
bool IsConvergence(const SolveReport& report);

// The largest defect of the solution; 0 of solvers without defects.
double LargestDefect(const SolveReport& report);

Json SolveToJson(const Request& request, const SolvedRuns& solved);

// Fills all that follows from the report's initial state and control: the exact run, the certificate, final_state.
void CheckRun(const Scene& scene, const Contact& contact, Precision precision, SolvedRun* run);

// The start of the scene under a contact model, with nothing changed: solver "none", its loss as `final_loss`, and no
// losses on the way. kFailed if the rollout fails, kNotApplicable if the model cannot take the scene.
SolvedRun SimulateOnly(const Request& request, const std::string& contact);

// A solution's motion under its own contact model or, if `exact`, under exact dynamics.
Motion MotionOf(const Request& request, const SolveReport& report, bool exact, const MotionOptions& options = {});

// The ends of the control intervals of a solution, from 0 on, s: the nodes of its own model's motion.
std::vector<double> NodesOf(const Scene& scene, const SolveReport& report);

}  // namespace saltus
