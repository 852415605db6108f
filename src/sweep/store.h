// The finished points of a study: a CSV file to which each row is appended, and that the next run reads again.
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

  // Returns the row of a point, or of another one with the same options, or null.
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
  std::map<int64_t, PointResult> results_;  // by the first point with the same options
};

}  // namespace saltus
