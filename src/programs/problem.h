// The main of the problem executables: gradient table, then optimisation.
#pragma once

#include "programs/program.h"

namespace saltus {

int ProblemMain(int argc, char** argv, const ProgramDefaults& defaults);

}  // namespace saltus
