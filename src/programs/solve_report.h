// What was asked of solvers and what came out, as a page.
#pragma once

#include <string>

#include "programs/solve.h"

namespace saltus {

class HtmlReport;

// Table of runs, certificates, replay, trajectories, controls and learning curves.
void AddSolveSections(const Request& request, const SolvedRuns& solved, HtmlReport* report);

// report.html in --output_dir, if there is one. Figures are left out where gnuplot is missing. Throws OutputError.
void WriteSolveReport(const Request& request, const SolvedRuns& solved);

}  // namespace saltus
