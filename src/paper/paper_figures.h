// The figures of the paper, from the experiments.
#pragma once

#include <string>
#include <vector>

#include "output/figure.h"
#include "output/replay.h"
#include "paper/experiments.h"

namespace saltus {

struct PaperFigure {
  std::string name;     // of its files
  std::string caption;  // one or two sentences
  Figure figure;
};

std::vector<PaperFigure> MakePaperFigures(const Experiments& experiments);

// What gradient descent has made of a task under each model, as the model sees it, and the exact motion of the same
// control or velocity under the first; of a task that is not optimised, its start.
Replay TaskReplay(const Experiments& experiments, const std::string& problem);

}  // namespace saltus
