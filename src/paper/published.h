// The paper's printed numbers beside those of this library and the exact ones.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "base/table.h"
#include "paper/experiments.h"

namespace saltus {

// One row of data/published.csv, with the value that this library computes for it.
struct PublishedRow {
  std::string table, problem, contact, quantity, note;
  double friction = 0;
  Precision precision = Precision::kDouble;
  std::string published;  // as printed; empty if the paper gives no number
  double expected = 0;    // what a faithful implementation gives
  double tolerance = 0;   // absolute, on |ours - expected|
  std::string verdict;    // of the printed number: match, published_misprint, solver_error, chaotic, ...

  std::optional<double> ours;
  std::optional<double> exact;  // the same quantity under exact dynamics

  // A number that rounding decides is shown but not judged.
  bool IsJudged() const { return verdict != "chaotic"; }
  bool Matches() const;
};

// Reads data/published.csv. Throws InputError.
std::vector<PublishedRow> ReadPublished(const std::string& path);

// Sets `ours` and `exact`.
void CompareWithPublished(const Experiments& experiments, std::vector<PublishedRow>* rows);

// Returns the names of the tables, in order ("T1", "T2", ...), and their captions.
std::vector<std::pair<std::string, std::string>> PublishedTables();

// Says whether our number is that of a faithful implementation, and what is wrong with the printed one.
std::string VerdictInWords(const PublishedRow& row);

// Returns a table published | ours | exact | verdict, for the rows of one table of the paper.
Table ToTable(const std::vector<PublishedRow>& rows, const std::string& name);

// Returns a table in the paper's layout: a row for each model and a column for each quantity, the published number
// above ours, coloured where they differ. Adds the notes that the cells refer to by number. The last row has the exact
// values.
Table PaperTable(const std::vector<PublishedRow>& rows, const std::string& name, std::vector<std::string>* notes);

}  // namespace saltus
