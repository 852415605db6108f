// report.html: all tables and figures, with what they mean.
#pragma once

#include <string>
#include <vector>

#include "programs/experiments.h"
#include "programs/paper_figures.h"
#include "programs/published.h"

namespace saltus {

// How the solvers did, one row a contact model and solver: task 2 with and without friction, and task 3.
Table SolverTable(const Experiments& experiments, const std::string& problem, double friction);

// Writes report.html into `output_dir`. Throws InputError if it cannot. `seconds` is what the experiments took.
void WritePaperReport(const Experiments& experiments, const std::vector<PublishedRow>& rows,
                      const std::vector<PaperFigure>& figures, double seconds, const std::string& output_dir);

}  // namespace saltus
