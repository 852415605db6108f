// A scene drawn to scale in a figure, with trajectories.
#pragma once

#include <string>

#include "output/figure.h"
#include "programs/motion.h"

namespace saltus {

// Discs at their start, walls and targets.
Panel ScenePanel(const Scene& scene, const std::string& title);

// The paths of all discs that move, one line each. At most so many discs are drawn as a figure can show.
void AddPaths(const Scene& scene, const Motion& motion, const std::string& label, const std::string& colour, Dash dash,
              Panel* panel);

}  // namespace saltus
