// A part of the report of the paper.
#pragma once

#include <string>
#include <vector>

#include "base/table.h"
#include "output/figure.h"

namespace saltus {

struct CaptionedTable {
  std::string name;  // of its files
  std::string caption;
  Table table;
};

struct PaperFigure {
  std::string name;     // of its files
  std::string caption;  // one or two sentences
  Figure figure;
};

struct Section {
  std::vector<std::string> findings;  // in a sentence or two each
  std::vector<CaptionedTable> tables;
  std::vector<PaperFigure> figures;
};

}  // namespace saltus
