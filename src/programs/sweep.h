// Every combination of some numeric options, with every contact model and solver: one row each.
#pragma once

#include <string>
#include <vector>

#include "programs/program.h"
#include "saltus/io/table.h"

namespace saltus {

// One axis of a sweep: the option's name and its values.
struct SweepAxis {
  std::string option;
  std::vector<double> values;
};

// Reads "stiffness=1e2:1e5:log:7;steps=120,240,480": axes separated by ';', each a list of values or a range
// first:last:lin|log:count. Throws InputError that names the axis and what was expected.
std::vector<SweepAxis> ParseSweep(const std::string& text);

// The options that can be swept.
std::vector<std::string> SweepOptions();

// Sets one option of a request. Throws InputError if the name is unknown or the value impossible for the option.
void SetSweepOption(const std::string& option, double value, Request* request);

// Runs the grid; rows in the order of the grid (last axis fastest), then contact models, then solvers. A point that
// cannot be computed is a row with its reason. Without solvers, a row is the loss and its gradient's norms at the
// initial guess.
Table RunSweep(const Request& request, const std::vector<SweepAxis>& axes);

// `saltus_sweep`.
int SweepMain(int argc, char** argv);

}  // namespace saltus
