// The main of the problem executables: gradient table, then optimisation.
#pragma once

#include <vector>

#include "exact/launch_solutions.h"
#include "output/table.h"
#include "programs/json_output.h"
#include "programs/program.h"

namespace saltus {

// Slowest first, which is the one of least effort. Empty if the scene is not of this kind (see FindLaunchSolutions) or
// optimizes something else than velocities.
std::vector<LaunchSolution> FindLaunches(const Scene& scene);

// One object a launch: velocity, speed_squared, events, and minimum_effort: true for the slowest.
Json LaunchesToJson(const std::vector<LaunchSolution>& launches);
Table LaunchTable(const std::vector<LaunchSolution>& launches);

int ProblemMain(int argc, char** argv, const ProgramDefaults& defaults);

}  // namespace saltus
