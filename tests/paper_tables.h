// Access to the tables of the report for tests.
#pragma once

#include <gtest/gtest.h>

#include <string>
#include <vector>

#include "base/csv.h"
#include "paper/experiments.h"

namespace saltus {

// Returns a table as CSV: the cells without their colours.
inline CsvDocument FindTable(const std::vector<CaptionedTable>& tables, const std::string& name) {
  for (const CaptionedTable& table : tables) {
    if (table.name == name) return *ParseCsv(table.table.ToCsv());
  }
  ADD_FAILURE() << "no table " << name;
  return {};
}

inline std::string Get(const CsvDocument& csv, size_t row, const std::string& column) {
  return csv.rows[row][*csv.Find(column)];
}

// Returns the cell of the run of that model and solver; "" if there is none.
inline std::string Get(const CsvDocument& csv, const std::string& contact, const std::string& solver,
                       const std::string& column) {
  for (size_t row = 0; row < csv.rows.size(); ++row) {
    if (Get(csv, row, "contact") == contact && Get(csv, row, "solver") == solver) return Get(csv, row, column);
  }
  return "";
}

}  // namespace saltus
