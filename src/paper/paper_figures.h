// The figures of the paper, from the experiments.
#pragma once

#include <string>
#include <vector>

#include "paper/experiments.h"
#include "output/figure.h"

namespace saltus {

struct PaperFigure {
  std::string name;     // of its files
  std::string caption;  // one or two sentences
  Figure figure;
};

std::vector<PaperFigure> MakePaperFigures(const Experiments& experiments);

}  // namespace saltus
