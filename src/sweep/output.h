// The results of a sweep for people and programs: table, arrays, JSON, and a word on what failed.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "base/table.h"
#include "output/npz.h"
#include "programs/json_output.h"
#include "sweep/store.h"

namespace saltus {

struct StoredPoint {
  int64_t point = 0;
  PointResult result;
};

// "point 3 (stiffness=100, contact=event)"
std::string PlaceOf(const SweepStudy& study, int64_t point);

// Returns the stored points of a range, in ascending order.
std::vector<StoredPoint> StoredPoints(const SweepStore& store, PointRange range);

Table SweepTable(const SweepStudy& study, const std::vector<StoredPoint>& points);

// One array a column, under the column's name, and "point". Numbers are float64, what is missing is NaN; text is str_.
NpzArrays SweepArrays(const SweepStudy& study, const std::vector<StoredPoint>& points);

// {"scene": ..., "points": [{"point": 0, "stiffness": 100, ..., "status": "done"}, ...]}
Json SweepJson(const SweepStudy& study, const std::vector<StoredPoint>& points);

// "10 points: 7 done, 1 not applicable, 2 failed", then a line for every reason with how often it occurs and where
// first; of many reasons the most frequent ones.
std::string Summary(const SweepStudy& study, const std::vector<StoredPoint>& points);

// A row for each kind of problem and each solver (with its contact model), and one for all kinds together. A problem is
// solved if the exact loss is within 1e-6, relative, of the least one of all points of that problem: of its seed and of
// every other option of scenes. Columns:
//   kind, contact, solver, problems, solved (a part of 1), worse_than_start, no_answer (refused, failed or stopped),
//   median_seconds, most_seconds, most_memory_mib.
// Precondition: study.generates() and study.solving().
Table SolvedTable(const SweepStudy& study, const std::vector<StoredPoint>& points);

}  // namespace saltus
