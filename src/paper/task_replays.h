// The three tasks of the paper as replays.
#pragma once

#include <string>

#include "output/replay.h"
#include "paper/experiments.h"

namespace saltus {

// What gradient descent has made of a task under each model, as the model sees it, and the exact motion of the same
// control or velocity under the first; of a task that is not optimised, its start.
Replay TaskReplay(const Experiments& experiments, const std::string& problem);

}  // namespace saltus
