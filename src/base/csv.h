// The reader for CSV files, and one line of such a file. What writes whole tables is base/table.h.
#pragma once

#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "base/status.h"

namespace saltus {

// A CSV file with a header line. Every row has as many fields as the header.
struct CsvDocument {
  std::vector<std::string> header;
  std::vector<std::vector<std::string>> rows;
  std::vector<int> lines;  // on which each row begins, from 1

  // Index of a column, if the header has it.
  std::optional<size_t> Find(std::string_view column) const;
};

// Reads RFC 4180 text; lines may end in LF or CRLF, empty lines are skipped. Errors name the line.
StatusOr<CsvDocument> ParseCsv(std::string_view text);

// Reads a file of such text. Errors name the file and the line.
StatusOr<CsvDocument> ReadCsv(const std::string& path);

// Returns the fields as one line of a CSV file, with its end.
std::string CsvLine(const std::vector<std::string>& fields);

}  // namespace saltus
