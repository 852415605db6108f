// One line of a CSV file (RFC 4180).
#pragma once

#include <string>
#include <vector>

namespace saltus {

// The fields as a line, with its end. What reads it is base/csv.h.
std::string CsvLine(const std::vector<std::string>& fields);

}  // namespace saltus
