// report.html: all tables and figures with explanations.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "paper/descent_audit.h"
#include "paper/experiments.h"
#include "paper/formulation_audit.h"
#include "paper/paper_figures.h"
#include "paper/parameter_fits.h"
#include "paper/published.h"
#include "paper/solver_comparison.h"
#include "paper/strike_comparison.h"

namespace saltus {

// Writes report.html into `output_dir`, with those of `figures` that it has a place for. Throws OutputError if it
// cannot. `formulations`, `descents`, `fits` and `law` may be left out; `seconds` is what the experiments took.
void WritePaperReport(const Experiments& experiments, const std::vector<PublishedRow>& rows,
                      const std::vector<PaperFigure>& figures, const SolverComparison& comparison,
                      const StrikeComparison& strike, const std::optional<FormulationAudit>& formulations,
                      const std::optional<DescentAudit>& descents, const std::optional<ParameterFits>& fits,
                      const std::optional<PaperFigure>& law, double seconds, const std::string& output_dir);

}  // namespace saltus
