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
#pragma once

#include <string>
#include <vector>

#include "saltus/scene/scene.h"
#include "sweep/options.h"

namespace saltus {

// Some options, and the values that they take together: a table with one column for each option.
struct SweepBlock {
  std::vector<std::string> options;
  std::vector<SweepRow> rows;
};

// Reads the text above. Values of real options are doubles, those of whole-number options too (a range is rounded to
// whole numbers). Throws InputError, which names the place and what was expected: options must exist for `scene` and
// appear once, words be known, numbers finite, and there is at least one value.
std::vector<SweepBlock> ParseSweep(const std::string& text, const Scene& scene);

}  // namespace saltus
