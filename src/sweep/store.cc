#include "sweep/store.h"

#include <glog/logging.h>
#include <unistd.h>

#include <array>
#include <stdexcept>

#include "base/file.h"

namespace saltus {
namespace {

constexpr int kBusyMilliseconds = 500;           // the locks of a process that was killed go at once
constexpr int kFixedColumns = 3;                 // point, run, status
constexpr char kApplicationId[] = "0x73616c74";  // "salt"

std::string QuoteName(const std::string& name) {
  std::string quoted = "\"";
  for (const char c : name) quoted += c == '"' ? std::string("\"\"") : std::string(1, c);
  return quoted + "\"";
}

std::string HostName() {
  std::array<char, 256> name = {};
  return gethostname(name.data(), name.size() - 1) == 0 ? name.data() : "";
}

// Whether SQLite has taken the value: it copies texts, for which it may lack the memory.
bool Bind(sqlite3_stmt* statement, int place, const std::string& text) {
  return sqlite3_bind_text(statement, place, text.data(), static_cast<int>(text.size()), SQLITE_TRANSIENT) == SQLITE_OK;
}

bool Bind(sqlite3_stmt* statement, int place, const SweepValue& value) {
  if (value.is_number_float()) return sqlite3_bind_double(statement, place, value.get<double>()) == SQLITE_OK;
  if (value.is_number()) return sqlite3_bind_int64(statement, place, value.get<int64_t>()) == SQLITE_OK;
  if (value.is_string()) return Bind(statement, place, value.get_ref<const std::string&>());
  return sqlite3_bind_null(statement, place) == SQLITE_OK;
}

std::string TextAt(sqlite3_stmt* statement, int column) {
  const auto* text = reinterpret_cast<const char*>(sqlite3_column_text(statement, column));
  return text == nullptr ? "" : std::string(text, static_cast<size_t>(sqlite3_column_bytes(statement, column)));
}

SweepValue ValueAt(sqlite3_stmt* statement, int column) {
  switch (sqlite3_column_type(statement, column)) {
    case SQLITE_INTEGER:
      return int64_t{sqlite3_column_int64(statement, column)};
    case SQLITE_FLOAT:
      return sqlite3_column_double(statement, column);
    case SQLITE_TEXT:
      return TextAt(statement, column);
    default:
      return {};
  }
}

}  // namespace

StatusOr<SweepStore> SweepStore::Open(const std::string& path, const SweepStudy& study) {
  SweepStore store(study);
  if (Status status = store.OpenDatabase(path); !status.ok()) return status;
  if (Status status = store.CheckStudy(); !status.ok()) return status;
  if (Status status = store.StartRun(); !status.ok()) return status;
  std::string places = "?1, ?2, ?3";
  for (size_t i = 0; i < study.columns().size(); ++i) places += ", ?" + std::to_string(i + 1 + kFixedColumns);
  store.insert_ = store.Prepare("INSERT INTO points VALUES (" + places + ")");
  if (!store.insert_) return store.Error();
  store.find_ = store.Prepare("SELECT 1 FROM points WHERE point = ?1");
  if (!store.find_) return store.Error();
  return store;
}

Status SweepStore::OpenDatabase(const std::string& path) {
  path_ = path;
  // SQLite would write into any file of that name, so that only a regular file is accepted.
  for (const char* suffix : {"", "-wal", "-journal"}) {
    if (Status status = CheckRegularFile(path + suffix); !status.ok()) return status;
  }
  sqlite3* database = nullptr;
  const int result = sqlite3_open(path.c_str(), &database);
  database_.reset(database);
  if (result != SQLITE_OK) return Error();
  sqlite3_busy_timeout(database, kBusyMilliseconds);
  // The lock is exclusive before the log is first used: the log then needs no memory shared between processes, which
  // network file systems do not have.
  return Execute(
      "PRAGMA locking_mode = EXCLUSIVE; PRAGMA journal_mode = WAL; PRAGMA synchronous = NORMAL; BEGIN IMMEDIATE; "
      "COMMIT");
}

Status SweepStore::CheckStudy() {
  const Statement tables = Prepare("SELECT count(*) FROM sqlite_master");
  if (!tables || sqlite3_step(tables.get()) != SQLITE_ROW) return Error();
  if (sqlite3_column_int64(tables.get(), 0) == 0) return CreateTables();
  const Statement query = Prepare("SELECT value FROM study WHERE key = 'description'");
  if (!query || sqlite3_step(query.get()) != SQLITE_ROW) {
    return Status::Error(path_ + ": a database, but not one of sweeps; expected none, or one that a sweep made");
  }
  const std::string before = TextAt(query.get(), 0);
  const std::string now = study_->Description();
  if (before == now) return Status();
  return Status::Error(path_ + " holds another study (" + DescribeDifference(before, now) +
                       "); expected the same options as then, or another --output_dir");
}

Status SweepStore::CreateTables() {
  std::string columns;
  for (const std::string& column : study_->columns()) columns += ", " + QuoteName(column);
  // Columns without a type keep every value as it is. The tables are made in one transaction: all or none exist.
  const Status status =
      Execute(std::string("BEGIN IMMEDIATE; PRAGMA application_id = ") + kApplicationId +
              "; CREATE TABLE study (key TEXT PRIMARY KEY, value TEXT) WITHOUT ROWID;"
              "CREATE TABLE runs (run INTEGER PRIMARY KEY, started TEXT, host TEXT);"
              "CREATE TABLE points (point INTEGER PRIMARY KEY, run INTEGER NOT NULL, status TEXT NOT NULL" +
              columns + ")");
  if (!status.ok()) return status;
  const Statement insert = Prepare("INSERT INTO study VALUES ('description', ?1)");
  if (!insert || !Bind(insert.get(), 1, study_->Description()) || sqlite3_step(insert.get()) != SQLITE_DONE) {
    return Error();
  }
  return Execute("COMMIT");
}

Status SweepStore::StartRun() {
  const Statement insert = Prepare("INSERT INTO runs (started, host) VALUES (datetime('now'), ?1)");
  if (!insert || !Bind(insert.get(), 1, HostName()) || sqlite3_step(insert.get()) != SQLITE_DONE) return Error();
  run_ = sqlite3_last_insert_rowid(database_.get());
  return Status();
}

Status SweepStore::Execute(const std::string& sql) {
  return sqlite3_exec(database_.get(), sql.c_str(), nullptr, nullptr, nullptr) == SQLITE_OK ? Status() : Error();
}

SweepStore::Statement SweepStore::Prepare(const std::string& sql) const {
  sqlite3_stmt* statement = nullptr;
  sqlite3_prepare_v2(database_.get(), sql.c_str(), -1, &statement, nullptr);
  return Statement(statement);
}

Status SweepStore::Error() const {
  const int code = sqlite3_errcode(database_.get()) & 0xff;
  if (code == SQLITE_BUSY || code == SQLITE_LOCKED) {
    return Status::Error(path_ + ": in use by another process; expected one sweep at a time");
  }
  return Status::Error(path_ + ": " + sqlite3_errmsg(database_.get()));
}

void SweepStore::Expect(bool holds) const {
  if (!holds) throw std::runtime_error(Error().message());
}

int64_t SweepStore::size() const {
  const Statement count = Prepare("SELECT count(*) FROM points");
  Expect(count && sqlite3_step(count.get()) == SQLITE_ROW);
  return sqlite3_column_int64(count.get(), 0);
}

bool SweepStore::Has(int64_t point) const {
  Expect(Bind(find_.get(), 1, SweepValue(point)));
  const int result = sqlite3_step(find_.get());
  Expect(result == SQLITE_ROW || result == SQLITE_DONE);
  sqlite3_reset(find_.get());
  return result == SQLITE_ROW;
}

Status SweepStore::Add(int64_t point, const PointResult& result) {
  CHECK_EQ(result.row.size(), study_->columns().size());
  bool bound = Bind(insert_.get(), 1, SweepValue(point)) && Bind(insert_.get(), 2, SweepValue(run_)) &&
               Bind(insert_.get(), 3, std::string(ToString(result.status)));
  for (size_t i = 0; bound && i < result.row.size(); ++i) {
    bound = Bind(insert_.get(), static_cast<int>(i) + 1 + kFixedColumns, result.row[i]);
  }
  const Status status = bound && sqlite3_step(insert_.get()) == SQLITE_DONE ? Status() : Error();
  sqlite3_reset(insert_.get());
  return status;
}

void SweepStore::ForEach(const std::function<void(int64_t, PointResult)>& visit) const {
  const Statement query = Prepare("SELECT * FROM points ORDER BY point");
  Expect(query != nullptr);
  const int columns = kFixedColumns + static_cast<int>(study_->columns().size());
  int step = 0;
  while ((step = sqlite3_step(query.get())) == SQLITE_ROW) {
    const std::optional<PointStatus> status = FindPointStatus(TextAt(query.get(), 2));
    if (!status || sqlite3_column_count(query.get()) != columns) {
      throw std::runtime_error(path_ +
                               ": found a point that no sweep has stored, expected a database that nothing else "
                               "has written to");
    }
    PointResult result{*status, {}};
    for (int i = kFixedColumns; i < columns; ++i) {
      result.row.push_back(ValueAt(query.get(), i));
    }
    visit(sqlite3_column_int64(query.get(), 0), std::move(result));
  }
  Expect(step == SQLITE_DONE);
}

StatusOr<int64_t> SweepStore::ForgetFailed() {
  const Status status = Execute("DELETE FROM points WHERE status = 'failed'");
  if (!status.ok()) return status;
  return int64_t{sqlite3_changes(database_.get())};
}

StatusOr<int64_t> SweepStore::Merge(const SweepStore& other) {
  Status status = Execute("BEGIN IMMEDIATE");
  if (!status.ok()) return status;
  int64_t added = 0;
  other.ForEach([&](int64_t point, const PointResult& result) {
    if (!status.ok() || Has(point)) return;
    status = Add(point, result);
    ++added;
  });
  if (status.ok()) status = Execute("COMMIT");
  if (!status.ok()) return status;
  return added;
}

}  // namespace saltus
