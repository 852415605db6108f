// report.html: all tables and figures, with what they mean.
#pragma once

#include <string>
#include <vector>

#include "programs/experiments.h"
#include "programs/paper_figures.h"
#include "programs/published.h"
#include "programs/solver_comparison.h"

namespace saltus {

// Writes report.html into `output_dir`. Throws InputError if it cannot. `seconds` is what the experiments took.
void WritePaperReport(const Experiments& experiments, const std::vector<PublishedRow>& rows,
                      const std::vector<PaperFigure>& figures, const SolverComparison& comparison, double seconds,
                      const std::string& output_dir);

}  // namespace saltus
