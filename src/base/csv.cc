#include "base/csv.h"

#include <algorithm>

#include "base/file.h"

namespace saltus {
namespace {

// Reads records off the text, one at a time.
class CsvReader {
 public:
  explicit CsvReader(std::string_view text) : text_(text) {}

  // Line on which the last record began, from 1.
  int line() const { return record_line_; }

  bool AtEnd() const { return at_ == text_.size(); }

  StatusOr<std::vector<std::string>> Record() {
    record_line_ = line_;
    std::vector<std::string> fields;
    while (true) {
      fields.emplace_back();
      const bool quoted = !AtEnd() && text_[at_] == '"';
      const Status status = quoted ? Quoted(&fields.back()) : Bare(&fields.back());
      if (!status.ok()) return status;
      if (AtEnd() || text_[at_] != ',') break;
      ++at_;
    }
    EndLine();
    return fields;
  }

  // Skips line ends that stand alone.
  void SkipEmptyLines() {
    while (!AtEnd() && (text_[at_] == '\n' || text_.substr(at_, 2) == "\r\n")) EndLine();
  }

 private:
  Status Error(const std::string& what) const {
    return Status::Error("line " + std::to_string(record_line_) + ": " + what);
  }

  bool AtFieldEnd() const {
    return AtEnd() || text_[at_] == ',' || text_[at_] == '\n' || text_.substr(at_, 2) == "\r\n";
  }

  void EndLine() {
    if (AtEnd()) return;
    at_ += text_[at_] == '\r' ? 2 : 1;
    ++line_;
  }

  Status Bare(std::string* field) {
    for (; !AtFieldEnd(); ++at_) {
      if (text_[at_] == '"') return Error("quote inside an unquoted field");
      *field += text_[at_];
    }
    return Status();
  }

  Status Quoted(std::string* field) {
    for (++at_; !AtEnd(); ++at_) {
      if (text_[at_] == '"') {
        ++at_;
        if (AtFieldEnd()) return Status();
        if (text_[at_] != '"') return Error("text after a closing quote");
      }
      if (text_[at_] == '\n') ++line_;
      *field += text_[at_];
    }
    return Error("quote is never closed");
  }

  std::string_view text_;
  size_t at_ = 0;
  int line_ = 1;
  int record_line_ = 1;
};

}  // namespace

std::optional<size_t> CsvDocument::Find(std::string_view column) const {
  const auto found = std::ranges::find(header, column);
  if (found == header.end()) return std::nullopt;
  return static_cast<size_t>(found - header.begin());
}

StatusOr<CsvDocument> ParseCsv(std::string_view text) {
  CsvReader reader(text);
  CsvDocument document;
  for (reader.SkipEmptyLines(); !reader.AtEnd(); reader.SkipEmptyLines()) {
    StatusOr<std::vector<std::string>> record = reader.Record();
    if (!record.ok()) return record.status();
    if (document.header.empty()) {
      document.header = std::move(*record);
    } else if (record->size() == document.header.size()) {
      document.rows.push_back(std::move(*record));
      document.lines.push_back(reader.line());
    } else {
      return Status::Error("line " + std::to_string(reader.line()) + ": " + std::to_string(record->size()) +
                           " fields, the header has " + std::to_string(document.header.size()));
    }
  }
  if (document.header.empty()) return Status::Error("found nothing, expected a line with the names of columns");
  return document;
}

StatusOr<CsvDocument> ReadCsv(const std::string& path) {
  const StatusOr<std::string> text = ReadFile(path);
  if (!text.ok()) return text.status();
  StatusOr<CsvDocument> document = ParseCsv(*text);
  if (!document.ok()) return Status::Error(path + ": " + document.status().message());
  return document;
}

}  // namespace saltus
