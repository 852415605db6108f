#include "sweep/results.h"

#include <fcntl.h>
#include <glog/logging.h>
#include <sys/file.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cmath>
#include <cstring>
#include <filesystem>
#include <limits>
#include <string_view>
#include <tuple>

#include "base/csv.h"
#include "base/file.h"
#include "base/number_text.h"
#include "scene/control_problems.h"

namespace saltus {
namespace {

constexpr size_t kMostBytes = size_t{1} << 36;

// Columns whose values are text or whole numbers; all others are numbers.
constexpr std::string_view kTexts[] = {"surrogate", "biased", "termination", "reason"};
constexpr std::string_view kWholeNumbers[] = {
    "iterations", "evaluations", "events", "open_otherwise", "open_failed", "closed_otherwise", "closed_failed"};

SweepValue ReadResult(std::string_view column, const std::string& text) {
  if (column.ends_with(kDoneSuffix)) column.remove_suffix(kDoneSuffix.size());
  if (std::ranges::find(kTexts, column) != std::end(kTexts)) return text;
  if (text.empty()) return {};
  if (std::ranges::find(kWholeNumbers, column) != std::end(kWholeNumbers)) {
    if (const auto whole = FromText<int64_t>(text)) return *whole;
  }
  const std::optional<double> number = FromText<double>(text);
  return number ? SweepValue(*number) : SweepValue(text);
}

// Returns the number of bytes before the first record that has no end: a program that was killed may have written a
// part of its last one.
size_t EndOfLastRecord(std::string_view text) {
  size_t end = 0;
  bool quoted = false;
  for (size_t i = 0; i < text.size(); ++i) {
    if (text[i] == '"') quoted = !quoted;
    if (text[i] == '\n' && !quoted) end = i + 1;
  }
  return end;
}

// Returns the number of bytes that were written.
size_t WriteAll(int file, std::string_view text) {
  size_t written = 0;
  while (written < text.size()) {
    const ssize_t size = write(file, text.data() + written, text.size() - written);
    if (size < 0 && errno == EINTR) continue;
    if (size < 0) break;
    written += static_cast<size_t>(size);
  }
  return written;
}

}  // namespace

std::string SweepLine(const PointResult& result) {
  std::vector<std::string> cells;
  for (const SweepValue& value : result.row) cells.push_back(CellOf(value).Exact());
  cells.emplace_back(ToString(result.status));
  return CsvLine(cells);
}

std::string SweepHeader(const SweepStudy& study) {
  std::vector<std::string> names = study.columns();
  names.emplace_back(kStatusColumn);
  return CsvLine(names);
}

SweepStore::SweepStore(const std::string& directory, const std::string& base, const SweepStudy& study)
    : study_(&study) {
  if (directory.empty()) return;
  path_ = directory + "/" + base + ".csv";
  const std::string description = directory + "/sweep.study.json";
  for (const std::string& path : {path_, description}) {
    if (const Status status = CheckRegularFile(path); !status.ok()) throw InputError(status.message());
  }
  CheckStudy(description);
  file_ = open(path_.c_str(), O_RDWR | O_CREAT | O_APPEND | O_CLOEXEC, 0666);
  if (file_ < 0) throw InputError(path_ + ": cannot write: " + std::strerror(errno));
  if (flock(file_, LOCK_EX | LOCK_NB) != 0) {
    close(file_);
    throw InputError(path_ + ": in use by another process; wait for its end, or give another --output_dir");
  }
  try {
    Read();
  } catch (...) {
    close(file_);
    throw;
  }
}

SweepStore::~SweepStore() {
  if (file_ >= 0) close(file_);
}

void SweepStore::CheckStudy(const std::string& path) const {
  const std::string now = study_->Description();
  if (!std::filesystem::exists(path)) {
    std::error_code unknown;
    if (const auto size = std::filesystem::file_size(path_, unknown); !unknown && size > 0) {
      throw InputError(path_ + " has rows, but without " + path +
                       " it is not known of which study; put that file beside it, or give another --output_dir");
    }
    const Status status = WriteFile(path, now + "\n");
    if (!status.ok()) throw InputError(status.message());
    return;
  }
  const StatusOr<std::string> text = ReadFile(path);
  if (!text.ok()) throw InputError(text.status().message());
  const std::string before = text->substr(0, text->find_last_not_of('\n') + 1);
  if (before == now) return;
  throw InputError(path + " is of another study (" + DescribeDifference(before, now) +
                   "); expected the same options as then, or another --output_dir");
}

void SweepStore::Read() {
  const StatusOr<std::string> text = ReadFile(path_, kMostBytes);
  if (!text.ok()) throw InputError(text.status().message());
  const size_t end = EndOfLastRecord(*text);
  if (end < text->size() && ftruncate(file_, static_cast<off_t>(end)) != 0) {
    throw InputError(path_ + ": cannot remove the incomplete last line: " + std::strerror(errno));
  }
  const std::string header = SweepHeader(*study_);
  if (end == 0) {
    if (WriteAll(file_, header) < header.size()) throw OutputError(path_ + ": cannot write: " + std::strerror(errno));
    return;
  }
  const StatusOr<CsvDocument> csv = ParseCsv(std::string_view(*text).substr(0, end));
  if (!csv.ok()) throw InputError(path_ + ": " + csv.status().message());
  if (CsvLine(csv->header) != header) {
    throw InputError(path_ + ": the columns are none of this sweep; expected " + header.substr(0, header.size() - 1));
  }
  const size_t num_options = study_->options().size();
  for (size_t i = 0; i < csv->rows.size(); ++i) {
    const std::vector<std::string>& cells = csv->rows[i];
    const std::optional<int64_t> point = study_->FindPoint({cells.begin(), cells.begin() + num_options});
    const std::optional<PointStatus> status = FindPointStatus(cells.back());
    if (!point || !status) {
      throw InputError(path_ + ", line " + std::to_string(csv->lines[i]) +
                       ": no row of this sweep; remove the line, or give another --output_dir");
    }
    PointResult result{*status, study_->Values(*point)};
    for (size_t j = num_options; j < study_->columns().size(); ++j) {
      result.row.push_back(ReadResult(study_->columns()[j], cells[j]));
    }
    results_[*point] = std::move(result);
  }
}

const PointResult* SweepStore::Find(int64_t point) const {
  const auto found = results_.find(point);
  return found == results_.end() ? nullptr : &found->second;
}

void SweepStore::Add(int64_t point, PointResult result) {
  CHECK_EQ(result.row.size(), study_->columns().size());
  if (file_ >= 0) {
    const std::string line = SweepLine(result);
    const off_t size = lseek(file_, 0, SEEK_END);
    if (WriteAll(file_, line) < line.size()) {
      const std::string why = std::strerror(errno);
      const bool restored = ftruncate(file_, size) == 0;
      throw OutputError(path_ + ": cannot write: " + why + (restored ? "" : "; its last line is incomplete"));
    }
  }
  results_[point] = std::move(result);
}

void SweepStore::ForgetFailed() {
  std::erase_if(results_, [](const auto& entry) { return entry.second.status == PointStatus::kFailed; });
}

namespace {

constexpr size_t kMostReasons = 10;

int64_t CountStatus(const std::vector<StoredPoint>& points, PointStatus status) {
  return std::ranges::count_if(points, [&](const StoredPoint& point) { return point.result.status == status; });
}

// Returns an array of texts if some row has one, and of numbers otherwise.
NpyArray ColumnArray(const std::vector<StoredPoint>& points, size_t column) {
  std::vector<std::string> texts;
  std::vector<double> numbers;
  bool text = false;
  for (const StoredPoint& point : points) {
    const SweepValue& value = point.result.row[column];
    text = text || value.is_string();
    texts.push_back(CellOf(value).Exact());
    numbers.push_back(ToNumber(value));
  }
  NpyArray array{{std::ssize(points)}, std::move(numbers)};
  if (text) array.data = std::move(texts);
  return array;
}

struct Reason {
  std::string text;
  int64_t count = 0;
  const StoredPoint* first = nullptr;
};

// Returns the reasons, most frequent first, equally frequent ones by their first point.
std::vector<Reason> Reasons(const std::vector<StoredPoint>& points) {
  std::map<std::string, Reason> by_text;
  for (const StoredPoint& point : points) {
    if (point.result.status == PointStatus::kComputed) continue;
    Reason& reason = by_text[CellOf(point.result.row.back()).Exact()];
    if (reason.first == nullptr) reason.first = &point;
    ++reason.count;
  }
  std::vector<Reason> reasons;
  for (auto& [text, reason] : by_text) {
    reason.text = text.empty() ? "no reason given" : text;
    reasons.push_back(reason);
  }
  std::ranges::sort(reasons, [](const Reason& a, const Reason& b) {
    return a.count != b.count ? a.count > b.count : a.first->point < b.first->point;
  });
  return reasons;
}

}  // namespace

std::string PlaceOf(const SweepStudy& study, int64_t point) {
  const SweepRow row = study.Values(point);
  std::string values;
  for (size_t i = 0; i < row.size(); ++i) {
    values += (i > 0 ? ", " : "") + study.options()[i] + "=" + CellOf(row[i]).Exact();
  }
  return "point " + std::to_string(point) + " (" + values + ")";
}

std::vector<StoredPoint> StoredPoints(const SweepStore& store, PointRange range) {
  std::vector<StoredPoint> points;
  for (int64_t point = range.begin; point < range.end; ++point) {
    if (const PointResult* result = store.Find(point)) points.push_back({point, *result});
  }
  return points;
}

Table SweepTable(const SweepStudy& study, const std::vector<StoredPoint>& points) {
  std::vector<Column> columns;
  for (const std::string& name : study.columns()) columns.push_back({name});
  columns.push_back({kStatusColumn});
  Table table(columns);
  for (const StoredPoint& point : points) {
    std::vector<Cell> row;
    for (const SweepValue& value : point.result.row) row.push_back(CellOf(value));
    row.emplace_back(ToString(point.result.status));
    table.AddRow(std::move(row));
  }
  return table;
}

NpzArrays SweepArrays(const SweepStudy& study, const std::vector<StoredPoint>& points) {
  NpzArrays arrays;
  std::vector<int64_t> numbers;
  for (const StoredPoint& point : points) numbers.push_back(point.point);
  arrays["point"] = {{static_cast<int64_t>(points.size())}, std::move(numbers)};
  for (size_t i = 0; i < study.columns().size(); ++i) arrays[study.columns()[i]] = ColumnArray(points, i);
  std::vector<std::string> statuses;
  for (const StoredPoint& point : points) statuses.emplace_back(ToString(point.result.status));
  arrays[kStatusColumn] = {{static_cast<int64_t>(points.size())}, std::move(statuses)};
  return arrays;
}

Json SweepJson(const SweepStudy& study, const std::vector<StoredPoint>& points) {
  Json list = Json::array();
  for (const StoredPoint& point : points) {
    Json object = {{"point", point.point}};
    for (size_t i = 0; i < study.columns().size(); ++i) object[study.columns()[i]] = point.result.row[i];
    object[kStatusColumn] = ToString(point.result.status);
    list.push_back(std::move(object));
  }
  Json document = Json::object();
  if (!study.generates()) document["scene"] = study.request().scene.name;
  document["points"] = std::move(list);
  return document;
}

std::string Summary(const SweepStudy& study, const std::vector<StoredPoint>& points) {
  const int64_t failed = CountStatus(points, PointStatus::kFailed);
  const int64_t not_applicable = CountStatus(points, PointStatus::kNotApplicable);
  std::string text = std::to_string(points.size()) +
                     " points: " + std::to_string(CountStatus(points, PointStatus::kComputed)) + " done, " +
                     std::to_string(not_applicable) + " not applicable, " + std::to_string(failed) + " failed\n";
  const std::vector<Reason> reasons = Reasons(points);
  for (size_t i = 0; i < std::min(reasons.size(), kMostReasons); ++i) {
    text += "  " + std::to_string(reasons[i].count) + " x " + reasons[i].text + "; first at " +
            PlaceOf(study, reasons[i].first->point) + "\n";
  }
  if (reasons.size() > kMostReasons) {
    text += "  and " + std::to_string(reasons.size() - kMostReasons) + " reasons more\n";
  }
  return text;
}

namespace {

constexpr double kSame = 1e-6;   // relative, of losses
constexpr double kZero = 1e-12;  // a loss so small is none

// The counts over the points of one solver and kind.
struct Tally {
  int problems = 0, solved = 0, worse = 0, without = 0;
  std::vector<double> seconds;
  double memory = 0;
};

// Whether an option is one of solvers, and not of the problem that they solve.
bool IsOfSolvers(const std::string& option) {
  constexpr std::string_view kNames[] = {"contact", "solver", "precision", "iterations", "learning_rate"};
  return std::ranges::find(kNames, option) != std::end(kNames) || option.starts_with("search_") ||
         option.starts_with("surrogate_") || option.starts_with("feedback_");
}

}  // namespace

Table SolvedTable(const SweepStudy& study, const std::vector<StoredPoint>& points) {
  const auto value = [&](const StoredPoint& point, const std::string& column) -> const SweepValue& {
    return point.result.row[*study.FindColumn(column)];
  };
  const auto problem_of = [&](const StoredPoint& point) {
    std::string problem;
    for (size_t i = 0; i < study.options().size(); ++i) {
      const std::string& option = study.options()[i];
      if (!IsOfSolvers(option)) problem += option + "=" + CellOf(point.result.row[i]).Exact() + " ";
    }
    return problem;
  };
  std::map<std::string, double> least;  // exact loss, by problem
  for (const StoredPoint& point : points) {
    double& best = least.try_emplace(problem_of(point), std::numeric_limits<double>::infinity()).first->second;
    best = std::fmin(best, ToNumber(value(point, "exact_loss")));
  }
  std::map<std::tuple<int, std::string, std::string>, Tally> tallies;
  for (const StoredPoint& point : points) {
    const double best = least.at(problem_of(point)), loss = ToNumber(value(point, "exact_loss"));
    const double seconds = ToNumber(value(point, "seconds")), memory = ToNumber(value(point, "memory_mib"));
    const bool answered = point.result.status == PointStatus::kComputed && std::isfinite(loss);
    const int kind = static_cast<int>(std::fmod(ToNumber(value(point, kSeedOption)), kNumControlKinds));
    for (const int row : {kind, kNumControlKinds}) {
      Tally& tally =
          tallies[{row, value(point, "contact").get<std::string>(), value(point, "solver").get<std::string>()}];
      ++tally.problems;
      if (std::isfinite(seconds)) tally.seconds.push_back(seconds);
      tally.memory = std::fmax(tally.memory, memory);
      tally.without += !answered;
      tally.solved += answered && loss <= best + kSame * std::abs(best) + kZero;
      tally.worse += answered && loss > (1 + kSame) * ToNumber(value(point, "initial_loss"));
    }
  }
  Table table(
      ColumnsOf("kind; contact; solver; problems; solved:3; worse_than_start; no_answer; median_seconds:3; "
                "most_seconds:3; most_memory_mib:4"));
  for (auto& [key, tally] : tallies) {
    const auto& [kind, contact, solver] = key;
    std::vector<double>& seconds = tally.seconds;
    std::ranges::sort(seconds);
    table.AddRow({kind < kNumControlKinds ? std::string(kControlKinds[kind]) : "all",
                  contact,
                  solver,
                  tally.problems,
                  double(tally.solved) / tally.problems,
                  tally.worse,
                  tally.without,
                  seconds.empty() ? Cell() : Cell(seconds[seconds.size() / 2]),
                  seconds.empty() ? Cell() : Cell(seconds.back()),
                  tally.memory > 0 ? Cell(tally.memory) : Cell()});
  }
  return table;
}

}  // namespace saltus
