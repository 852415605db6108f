// Which solver solves how many of the generated problems of a sweep over seeds.
#pragma once

#include <vector>

#include "sweep/output.h"

namespace saltus {

// A row for each kind of problem and each solver (with its contact model), and one for all kinds together. A problem is
// solved if the exact loss is within 1e-6, relative, of the least one of all points of that problem: of its seed and of
// every other option of scenes. Columns:
//   kind, contact, solver, problems, solved (a part of 1), worse_than_start, no_answer (refused, failed or stopped),
//   median_seconds, most_seconds, most_memory_mib.
// Precondition: study.generates() and study.solving().
Table SolvedTable(const SweepStudy& study, const std::vector<StoredPoint>& points);

}  // namespace saltus
