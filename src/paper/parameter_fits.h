// Fits of one recording under every contact model: wrong gradients lead to wrong parameters. There are two fits: one to
// a recording of exact motion, in which both a model's motion and its gradient matter, and one to a recording of the
// model's motion, in which only its gradient matters.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "output/progress.h"
#include "paper/section.h"

namespace saltus {

// Fits under contact models. Those that cannot simulate the scene are left out, and plastic ones, which cannot explain
// a bounce. Returns std::nullopt if interrupted.
std::optional<Section> FitParameters(const std::vector<std::string>& contacts, int threads, ProgressMode mode);

// Learns the law of a ball dropped from four heights, whose restitution falls with speed. std::nullopt if interrupted.
std::optional<PaperFigure> LearnALaw();

}  // namespace saltus
