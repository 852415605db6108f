// The main of the problem executables: gradient table, then optimisation.
#pragma once

#include "tools/program.h"

namespace saltus {

int ProblemMain(int argc, char** argv, const ProgramDefaults& defaults);

}  // namespace saltus
