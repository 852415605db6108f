// The figures of the paper, from the experiments.
#pragma once

#include <string>
#include <vector>

#include "output/figure.h"
#include "paper/experiments.h"

namespace saltus {

struct PaperFigure {
  std::string name;     // of its files
  std::string caption;  // one or two sentences
  Figure figure;
};

std::vector<PaperFigure> MakePaperFigures(const Experiments& experiments);

}  // namespace saltus
