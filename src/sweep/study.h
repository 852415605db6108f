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
#include "saltus/scene/scene.h"

namespace saltus {

// The options of a sweep: every numeric flag of the programs, some numbers of the scene, the contact model, the solver
// and the precision; or the scene itself, by the seed of a control problem (scene/control_problems.h).
//
// Beside the names in SweepOptionNames(), "<body>.<field>" is an option for every body of the scene: mass, radius,
// position_x, position_y, velocity_x, velocity_y, and force_x, force_y (of the initial control) if it is controlled,
// torque if it is turned. In a scene with materials restitution and friction have the names of scene_parameter.h, such
// as "restitution.rubber-steel".

// One entry of a sweep's table: null, a whole number, a finite number or text.
using SweepValue = Json;
using SweepRow = std::vector<SweepValue>;

// The number, or NaN for null and for text.
double ToNumber(const SweepValue& value);

// A program of a hybrid system (programs/hybrid_program.h) that is swept in the place of a scene. Its options are
// `names`, the values of its flag --set, "solver", "steps", "iterations" and "learning_rate", and with --feedback in
// its command "feedback_scale", "feedback_samples" and "feedback_seed".
struct SweepProgram {
  std::string command;             // for /bin/sh
  std::string name;                // of what it solves
  std::vector<std::string> names;  //
  bool feedback = false;           // the command has --feedback
};
// Keeps it for the functions below and for the points of a study. To be called once, before them.
void KeepProgram(SweepProgram program);
// Returns the kept program, null if none is kept.
const SweepProgram* KeptProgram();
// The JSON that a command line of the program prints. Throws InputError with what it prints if there is none.
Json RunProgram(const std::string& arguments, double seconds);

enum class SweepOptionKind { kReal, kInteger, kWord };

// Returns the kind of an option, std::nullopt if a sweep over `scene` has no such option.
std::optional<SweepOptionKind> FindSweepOption(const std::string& name, const Scene& scene);

// The options that do not depend on the scene.
std::vector<std::string> SweepOptionNames();

// The words that solver or precision accept. A contact model may have options: see registry.h.
std::vector<std::string> SweepWords(const std::string& name);

// The option that takes the place of the scene, so that it is set before all others.
inline constexpr const char* kSeedOption = "seed";

// Sets one option of a request; the scene that results is not validated. Precondition: the option exists, the value is
// a word that it accepts, or else a number. Throws InputError if the number is impossible for an option of solvers.
void SetSweepOption(const std::string& name, const SweepValue& value, Request* request);

// The points of a sweep as a user writes them.
//
//   spec   = block *(";" block)             every combination of the blocks' rows, the last block fastest
//   block  = axis *("&" axis)               one option, or several that move together (equally many values)
//          | "(" name *("," name) ")" "=" "(" value *("," value) ")" *("," "(" ... ")")     explicit points
//          | "@" file                       explicit points: a CSV file whose header names options
//   axis   = name "=" item *("," item)
//   item   = value | first ":" last ":" ("lin" | "log") ":" count
//
// For example "stiffness=1e2:1e5:log:7; steps=120,240", "stiffness=1e3,1e4 & damping=0,10",
// "(contact,solver)=(direct_toi,gd),(event,ceres_lm)". Spaces around the parts mean nothing.

// Some options, and the values that they take together: a table with one column for each option.
struct SweepBlock {
  std::vector<std::string> options;
  std::vector<SweepRow> rows;
};

// Reads the text above. Values of real options are doubles, those of whole-number options too (a range is rounded to
// whole numbers). Throws InputError, which names the place and what was expected: options must exist for `scene` and
// appear once, words be known, numbers finite, and there is at least one value.
std::vector<SweepBlock> ParseSweep(const std::string& text, const Scene& scene);

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
  // unless a block has them. Rows of a block that are alike are one. Without solvers a point is the loss and its
  // gradient at the initial guess. Preconditions: the blocks are ParseSweep's for the scene of `request`. Throws
  // InputError if there are too many points.
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

  // The point whose options are written so in a CSV file, in the order of options(), if there is one.
  std::optional<int64_t> FindPoint(const std::vector<std::string>& cells) const;

  // Returns the task at a point: one contact model and, if solving, one solver. Throws InputError, with key and
  // expectation, if the values make no valid scene or are impossible for a solver.
  Request RequestAt(int64_t point) const;

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
  std::vector<std::map<std::string, int64_t>> row_of_cells_;  // of each block
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
