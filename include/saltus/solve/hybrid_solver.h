// Solvers of problems of hybrid systems (hybrid/hybrid_problem.h), with the options and the report of solver.h.
#pragma once

#include <string_view>
#include <vector>

#include "saltus/hybrid/hybrid_problem.h"
#include "saltus/solve/solver.h"

namespace saltus {

struct HybridSolverEntry {
  std::string_view name;
  std::string_view summary;  // one line
  // Returns why it does not support a problem; empty if it does. Precondition: Validate(problem) is empty.
  std::string (*reason_not_applicable)(const HybridProblem&);
  SolveReport (*solve)(const HybridProblem&, const SolverOptions&);
};

const std::vector<HybridSolverEntry>& HybridSolvers();

// Runs the solver of that name. The report is kNotApplicable with the reason if the name is unknown, the problem or an
// option is wrong, or the solver does not support the problem.
//
//   gd, ceres_lbfgs, ceres_lm   single shooting on the given grid. Options: iterations, learning_rate, rate_per_time
//                               (of a control), keep_iterates, callback, stop. The reason also names what keeps the
//                               motion found from having a derivative: guards that graze, ties, events at the final
//                               time, and events at or near jumps of the control, where the loss has a kink.
//   ceres_phases                phases between events have free lengths, and their control intervals move with the
//                               events (Solution::durations). Supports constraints and bounds, and reports a
//                               certificate (hybrid_certificate.h). Options: iterations (of Ceres, in all), callback,
//                               stop; with `search` off the sequence of events of the guess is kept.
//   ipopt                       the problem of ceres_phases by the interior-point method of IPOPT, with second
//                               derivatives; kNotApplicable if saltus was built without IPOPT.
//   auto                        a sequence of these solvers by the structure of the problem, until one ends with an
//                               optimum: ceres_phases and ipopt before shooting (ceres_lm first in small problems
//                               without events), shooting alone where phases do not apply, and at last mode_search for
//                               mechanical systems. Where none ends with an optimum, they go on from the best end. The
//                               reason and SolveReport::solver name the solver that was used.
//   mode_search                 ceres_phases along neighbouring sequences of events, from several starts; from
//                               the guess ipopt too, if ceres_phases finds no optimum there. Options:
//                               iterations (solves), search_options, threads, callback, status and stop. An event of a
//                               sequence in SolveReport::optima is {mode, guard}, or {mode, -1} of a control jump.
SolveReport Solve(std::string_view solver, const HybridProblem& problem, const SolverOptions& options);

// Returns the guess of the problem with the initial state, control, interval lengths, duration and parameters of the
// report. Precondition: the report is one of this problem and has losses.
HybridInput SolutionOf(const HybridProblem& problem, const SolveReport& report);

}  // namespace saltus
