// The audit as files: CSV tables and figures.
#pragma once

#include <string>

#include "output/figure.h"
#include "programs/program.h"
#include "saltus/audit/audit.h"

namespace saltus {

// Error against the step, log-log: one panel for each of position, velocity and control, one line a model, whose label
// has the order by position.
Figure RefinementFigure(const Scene& scene, const AuditReport& report);

// Slope against width: for each of position, velocity and control the entry on which differences speak most against a
// model. Level lines are the exact values.
Figure WidthFigure(const Scene& scene, const AuditReport& report);

// Writes <scene>_{gradients,refinement,contacts}.csv and <scene>_refinement.{svg,png}, and with a width sweep
// <scene>_widths.{csv,svg,png}; of a surrogate <scene>_<surrogate>_biased_{gradients.csv,verdicts.md}. Throws
// OutputError if it cannot. Writes nothing without --output_dir, and no figures, which take long, after an interrupt.
void WriteAuditFiles(const Request& request, const AuditReport& report);

}  // namespace saltus
