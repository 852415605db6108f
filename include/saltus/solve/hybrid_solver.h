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
// option is wrong, or the solver cannot take the problem. Of the options those of single shooting are used: iterations,
// learning_rate, rate_per_time (of a control), keep_iterates, callback and stop.
//
// The reason also names what keeps the motion that is found from having a derivative: guards that graze, ties, events
// at the final time and where the control jumps or nearly so, where the loss has a kink.
SolveReport Solve(std::string_view solver, const HybridProblem& problem, const SolverOptions& options);

}  // namespace saltus
