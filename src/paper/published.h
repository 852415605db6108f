// The paper's printed numbers beside ours and the exact ones.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "output/table.h"
#include "paper/experiments.h"

namespace saltus {

// One row of data/published.csv, with what we compute for it.
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

// Fills in `ours` and `exact`.
void CompareWithPublished(const Experiments& experiments, std::vector<PublishedRow>* rows);

// The names of the tables, in order ("T1", "T2", ...), and their captions.
std::vector<std::pair<std::string, std::string>> PublishedTables();

// Whether ours is what a faithful implementation gives, and what is wrong with the printed number.
std::string VerdictInWords(const PublishedRow& row);

// published | ours | exact | verdict, for the rows of one table.
Table ToTable(const std::vector<PublishedRow>& rows, const std::string& name);

// As the paper prints it: a row a model and a column a quantity, the published number above ours; a colour where they
// differ. Adds the notes that the cells refer to by number. The last row has the values of exact dynamics.
Table PaperTable(const std::vector<PublishedRow>& rows, const std::string& name, std::vector<std::string>* notes);

}  // namespace saltus
