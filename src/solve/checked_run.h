// Runs of solvers whose solutions are simulated exactly and certified, and simulations without a solver in their form.
#pragma once

#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "saltus/optimality/certificate.h"
#include "saltus/simulate/exact_run.h"
#include "saltus/solve/solver.h"
#include "solve/motion.h"

namespace saltus {

// The name of no solver in the report of a simulation.
inline constexpr char kNoSolver[] = "none";

// A solver's report with its solution simulated exactly, and certified if it is a control or has design parameters.
struct CheckedRun {
  SolveReport report;
  ExactRun exact;
  std::optional<Certificate> certificate;
  std::vector<double> final_state;  // B x 4, under its contact model; empty if that fails
  std::optional<double> duration;   // s, of the solution, where it was free
  bool simulated = false;           // nothing was solved, and the start has a finite loss

  // Whether there is an initial state and a control to look at.
  bool HasSolution() const { return simulated || !report.history.losses.empty(); }
};

// Returns the initial state and the control of a solution.
MotionInput InputOf(const SolveReport& report);

// Solves, simulates and certifies. Calls `keep` with the run before it is checked. `stop` ends the checks;
// options.stop ends the solver.
CheckedRun SolveAndCheck(const std::string& solver, const SolveRequest& request, const SolverOptions& options,
                         const StopRequest& stop, const std::function<void(CheckedRun)>& keep);

// Solves, and simulates the solution exactly.
CheckedRun SolveAndSimulate(const std::string& solver, const SolveRequest& request, const SolverOptions& options);

// Simulates the scene from its initial state under a control, that of the scene unless `guess` has a value. The
// report's solver is kNoSolver and its losses are empty; its final loss is that under the contact model. The
// termination is kFailed if the rollout fails, kNotApplicable if the contact model does not support the scene.
CheckedRun SimulateAndCheck(const SolveRequest& request, const std::optional<ControlGuess>& guess,
                            const StopRequest& stop);

}  // namespace saltus
