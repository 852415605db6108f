// A law of impact learned from noisy recordings, beside the law that made them.
#pragma once

#include <optional>

#include "paper/paper_figures.h"

namespace saltus {

// A ball is dropped from four heights on a floor whose restitution falls with the speed. Nothing if interrupted.
std::optional<PaperFigure> LearnALaw();

}  // namespace saltus
