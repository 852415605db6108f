// The results of a sweep: the row of each point, and tables, arrays and JSON of all of them.
//
// The finished points of a study are in a CSV file to which each row is appended, and that the next run reads again.
//
// A row is one write(): once Add has returned, the row outlives the process, however that ends. An incomplete last line
// is dropped when the file is read, and its point is computed again. Beside <base>.csv, the file sweep.study.json
// describes the study, so that results of other options are never mixed with those of this one. A point is found by its
// options, in any order of the rows; the last row of a point counts. The files of several shards, joined with one
// header, are therefore the file of the whole study.
#pragma once

#include <cstdint>
#include <map>
#include <string>
#include <vector>

#include "base/table.h"
#include "output/npz.h"
#include "programs/json_output.h"
#include "sweep/study.h"

namespace saltus {

// The line of a row as it is in the file, and the header line with the names of the columns. The status stands last.
std::string SweepLine(const PointResult& result);
std::string SweepHeader(const SweepStudy& study);

class SweepStore {
 public:
  // Opens DIR/<base>.csv, or makes it; with an empty `directory` rows are only kept in memory. `study` must outlive the
  // object. Throws InputError if the files cannot be used: no access, in use by another process, of another study (with
  // what differs), or rows that are none of this study.
  SweepStore(const std::string& directory, const std::string& base, const SweepStudy& study);
  ~SweepStore();
  SweepStore(const SweepStore&) = delete;
  SweepStore& operator=(const SweepStore&) = delete;

  // Returns the row of a point, or null.
  const PointResult* Find(int64_t point) const;

  // Appends the row of a point. Throws OutputError if the file does not take it (a full disk, say), and leaves the file
  // as it was.
  void Add(int64_t point, PointResult result);

  // Removes the failed points, so that they are computed again.
  void ForgetFailed();

 private:
  void CheckStudy(const std::string& path) const;
  void Read();

  const SweepStudy* study_;
  std::string path_;  // empty: in memory
  int file_ = -1;
  std::map<int64_t, PointResult> results_;  // by point
};

// The columns after those of the options (docs/how-to/sweeps.md, "Results").
std::vector<std::string> ResultColumns(const SweepStudy& study);

// Computes a point, on the thread that calls. It is stopped after `seconds` (0: never) or once `stop` returns true; the
// row then holds what a solver had reached. All but the columns "seconds" and "memory_mib" of a point that is not
// stopped is the same on every call. The latter is empty unless the point is computed `alone`, as the memory of one
// thread is not known.
PointResult ComputePoint(const SweepStudy& study, int64_t point, double seconds, const StopRequest& stop = nullptr,
                         bool alone = true);

// The row of a point of which nothing is known but why it failed.
PointResult FailedPoint(const SweepStudy& study, int64_t point, const std::string& reason);

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
