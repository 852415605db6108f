// All points of a sweep, by number: every combination of the rows of some blocks, the last block fastest.
//
// A row of a study's table is one value for each swept option (numbers first, then the contact model and the solver)
// and then the results.
#pragma once

#include <cstdint>
#include <map>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "programs/program.h"
#include "sweep/spec.h"

namespace saltus {

enum class PointStatus { kComputed, kFailed, kNotApplicable };

// "done", "failed", "not_applicable"; and back.
const char* ToString(PointStatus status);
std::optional<PointStatus> FindPointStatus(const std::string& text);  // none if there is no such

// One row of a sweep's table, with an entry per column.
struct PointResult {
  PointStatus status = PointStatus::kComputed;
  SweepRow row;

  bool operator==(const PointResult&) const = default;
};

// The column of the status, after all others in tables and files.
inline constexpr char kStatusColumn[] = "status";
// Follows the name of a result in the header of its column where an option has that name, too.
inline constexpr std::string_view kDoneSuffix = "_done";

// A contiguous part of the points of a study.
struct PointRange {
  int64_t begin = 0, end = 0;  // `end` is not one of them
};

class SweepStudy {
 public:
  // Sweeps `blocks` and, fastest, the contact models (unless a program is kept, options.h) and solvers of `request`
  // unless a block has them. Without solvers a point is the loss and its gradient at the initial guess. Preconditions:
  // the blocks are ParseSweep's for the scene of `request`. Throws InputError if there are too many points.
  SweepStudy(Request request, std::vector<SweepBlock> blocks);

  int64_t size() const { return size_; }
  bool solving() const { return solving_; }
  // Whether each point has a scene of its own, by its seed.
  bool generates() const { return generates_; }
  const Request& request() const { return request_; }

  // The options that vary from point to point, in the order of the columns.
  const std::vector<std::string>& options() const { return options_; }
  // All headers: options, then results.
  const std::vector<std::string>& columns() const { return columns_; }
  // Where a header stands among them.
  std::optional<size_t> FindColumn(const std::string& name) const;

  // Whether the gradient at a point, or at any, is biased: by a surrogate or by options of the contact model.
  bool IsBiased(int64_t point) const;
  bool any_bias() const { return any_bias_; }

  // The values of options() at a point. Precondition, here and below: 0 <= point < size().
  SweepRow Values(int64_t point) const;

  // The first point whose options have the same values: an option may list a value twice.
  int64_t FirstLike(int64_t point) const;
  // The first point whose options are written so in a CSV file, in the order of options(), if there is one.
  std::optional<int64_t> FindPoint(const std::vector<std::string>& cells) const;

  // Returns the task at a point: one contact model and, if solving, one solver. Throws InputError, with key and
  // expectation, if the values make no valid scene or are impossible for a solver.
  Request At(int64_t point) const;

  // Everything that the results depend on, as JSON text: equal for equal studies.
  std::string Description() const;

 private:
  Request request_;
  std::vector<SweepBlock> blocks_;
  bool solving_;
  bool generates_ = false;
  bool any_bias_;
  int64_t size_ = 1;
  std::vector<std::string> options_;
  std::vector<std::string> columns_;
  // The first row of each block by its cells, and the first row like each row.
  std::vector<std::map<std::string, int64_t>> row_of_cells_;
  std::vector<std::vector<int64_t>> first_rows_;
  // Where each of options_ stands.
  struct Place {
    size_t block, column;
  };
  std::vector<Place> places_;
};

// The first difference between two descriptions, for a person: "scene/steps: 480 is now 240". Precondition: both are
// JSON and differ.
std::string DescribeDifference(const std::string& before, const std::string& now);

}  // namespace saltus
