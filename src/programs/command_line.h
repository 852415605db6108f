// Command lines, checked before gflags reads them: it would crash, or end the program without saying what was expected.
#pragma once

#include <string>
#include <vector>

#include "programs/program_flags.h"

namespace saltus {

// The items of a comma-separated list; none of an empty one.
std::vector<std::string> SplitAtCommas(const std::string& list);

// Throws InputError for a flag that the program does not have, and for flag files that cannot be read.
void CheckCommandLine(int argc, char** argv, const Program& program);

// Whatever way a flag was given: what the program would ignore is an error. To be called once flags are read. Throws
// InputError.
void RefuseFlagsOfOthers(const Program& program);

}  // namespace saltus
