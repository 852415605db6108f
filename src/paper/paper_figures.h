// The figures of the paper, from the experiments.
#pragma once

#include <string>
#include <vector>

#include "paper/experiments.h"
#include "paper/section.h"
#include "programs/scene_drawing.h"

namespace saltus {

std::vector<PaperFigure> MakePaperFigures(const Experiments& experiments);

// Returns the result of gradient descent on a task under each model, as the model simulates it, and the exact motion of
// the control or velocity of the first; for a task that is not optimised, its guess.
Replay TaskReplay(const Experiments& experiments, const std::string& problem);

}  // namespace saltus
