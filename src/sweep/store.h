// The finished points of a study, in an SQLite database that survives the end of the program at any moment.
//
// Every point is a transaction of its own, in a write-ahead log: once Add has returned, the row outlives the process,
// however that ends. (Should the machine lose power, the last rows may be missing and are computed again; the database
// is never damaged.) One process at a time has the database, so that no point is computed twice.
//
// Tables: study(key, value) holds the description of the study, runs(run, started, host) each use of the database, and
// points(point, run, status, ...) the rows, with the columns of the study's table.
#pragma once

#include <sqlite3.h>

#include <cstdint>
#include <functional>
#include <memory>
#include <string>

#include "base/status.h"
#include "sweep/study.h"

namespace saltus {

// A database that is damaged, or that something else has written to, is a std::runtime_error of what reads it.
class SweepStore {
 public:
  // Opens the database at `path`, or makes it; ":memory:" is one that lives as long as the object. `study` must outlive
  // the object. Errors: no access, not a store, in use by another process, of another study (with what differs).
  static StatusOr<SweepStore> Open(const std::string& path, const SweepStudy& study);

  // Returns the number of stored points.
  int64_t size() const;
  bool Has(int64_t point) const;

  // Stores a point. An error (a full disk, say) leaves the store as it was; that the point is there already is one too.
  Status Add(int64_t point, const PointResult& result);

  // Calls `visit` with every point, in ascending order.
  void ForEach(const std::function<void(int64_t point, PointResult result)>& visit) const;

  // Removes the failed points, so that they are computed again. Returns how many there were.
  StatusOr<int64_t> ForgetFailed();

  // Adds all points of another store of this study that are not here yet. Returns how many were added.
  StatusOr<int64_t> Merge(const SweepStore& other);

 private:
  struct CloseDatabase {
    void operator()(sqlite3* database) const { sqlite3_close(database); }
  };
  struct FinalizeStatement {
    void operator()(sqlite3_stmt* statement) const { sqlite3_finalize(statement); }
  };
  using Statement = std::unique_ptr<sqlite3_stmt, FinalizeStatement>;

  explicit SweepStore(const SweepStudy& study) : study_(&study) {}

  Status OpenDatabase(const std::string& path);
  Status CheckStudy();
  Status CreateTables();
  Status StartRun();
  // Runs statements without results, or returns what SQLite says against it.
  Status Execute(const std::string& sql);
  Statement Prepare(const std::string& sql) const;
  Status Error() const;
  // Throws the message of SQLite if a database is damaged or cannot be read any more.
  void Expect(bool holds) const;

  const SweepStudy* study_;
  std::string path_;
  int64_t run_ = 0;
  std::unique_ptr<sqlite3, CloseDatabase> database_;
  Statement insert_;  // closed before the database
  Statement find_;
};

}  // namespace saltus
