// Runs gnuplot.
#pragma once

#include <string>

#include "base/status.h"

namespace saltus::internal {

// Feeds `script` to `executable` (a path, or a name to be found on PATH) on its standard input; no shell is involved.
// Returns what it wrote to its standard output, or an error with what it said on its standard error. It does not
// outlive the grace of an interrupt (base/interrupt.h).
StatusOr<std::string> RunGnuplot(const std::string& executable, const std::string& script);

}  // namespace saltus::internal
