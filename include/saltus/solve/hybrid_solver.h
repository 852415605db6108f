// Solvers for problems of hybrid systems (hybrid/hybrid_problem.h). They are those of scenes (solver.h), and report the
// same.
#pragma once

#include <string_view>
#include <vector>

#include "saltus/hybrid/hybrid_problem.h"
#include "saltus/solve/solver.h"

namespace saltus {

struct HybridSolverEntry {
  std::string_view name;
  std::string_view summary;  // one line
  // Why it cannot take a problem; empty if it can. Precondition: WhatIsWrongWith(problem) is empty.
  std::string (*why_not)(const HybridProblem&);
  SolveReport (*solve)(const HybridProblem&, const SolverOptions&);
};

const std::vector<HybridSolverEntry>& HybridSolvers();

// Runs the solver of that name. The report is kNotApplicable with the reason if the name is unknown, the problem or an
// option is wrong, or the solver cannot take the problem.
//
//   gd, ceres_lbfgs, ceres_lm   single shooting on the given grid. Options: iterations, learning_rate, rate_per_time
//                               (of a control), keep_iterates, callback, stop. The reason also names what keeps the
//                               motion that is found from having a derivative: guards that graze, ties, events at the
//                               final time and where the control jumps or nearly so, where the loss has a kink.
//   ceres_phases                phases between events have free lengths, and their control intervals move with the
//                               events: SolveReport::durations. It takes constraints and bounds and reports a
//                               certificate (saltus/optimality/hybrid_certificate.h). Options: iterations (of Ceres, in
//                               all), callback, stop; with `search` off the sequence of events of the guess is kept.
//   ipopt                       the problem of ceres_phases, by the interior-point method of IPOPT with second
//   derivatives.
//                               kNotApplicable if saltus was built without IPOPT.
//   auto                        ceres_phases or ipopt, by the structure of the problem, and the other one if the first
//   ends
//                               without an optimum; solvers by shooting where phases do not apply. SolveReport::solver
//                               and the reason name which was used, and why.
//   mode_search                 ceres_phases along neighbouring sequences of events, from several starts. Options:
//                               iterations (solves), search_options, threads, callback, status and stop. In
//                               SolveReport::optima an event stands in a sequence as {mode, guard}.
SolveReport Solve(std::string_view solver, const HybridProblem& problem, const SolverOptions& options);

// The input that the solution of a report stands for. Precondition: the report has losses.
HybridInput SolutionOf(const HybridProblem& problem, const SolveReport& report);

}  // namespace saltus
