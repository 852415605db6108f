#include "sweep/store.h"

#include <fcntl.h>
#include <glog/logging.h>
#include <sys/file.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <filesystem>

#include "base/csv.h"
#include "base/csv_line.h"
#include "base/file.h"
#include "base/number_text.h"
#include "base/table.h"

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
  const auto found = results_.find(study_->FirstLike(point));
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
  results_[study_->FirstLike(point)] = std::move(result);
}

void SweepStore::ForgetFailed() {
  std::erase_if(results_, [](const auto& entry) { return entry.second.status == PointStatus::kFailed; });
}

}  // namespace saltus
