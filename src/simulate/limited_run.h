// SimulateExactly() with a limit of impacts, for motions that nobody has looked at: an endless series of them takes
// neither the time nor the memory.
#pragma once

#include "saltus/simulate/exact_run.h"

namespace saltus {

// A motion with more than so many impacts is cut in the step in which it has them, and that is the reason. Shapes as
// those of SimulateExactly().
ExactRun SimulateUpTo(std::optional<int> most_impacts, const Scene& scene, const std::vector<double>& initial,
                      const std::vector<double>& control, const std::vector<double>& durations = {},
                      const StopRequest& stop = nullptr);

}  // namespace saltus
