// The figures of a sweep. Which figures there are follows from which numbers were varied.
#pragma once

#include <string>
#include <vector>

#include "output/figure.h"
#include "sweep/output.h"

namespace saltus {

struct SweepFigure {
  std::string name;  // of its files
  Figure figure;
};

// "loss_against_<option>" for every number that was varied: the smallest loss over all others, a curve for every
// contact model and solver. "gradient_error_against_dt" if the time step was varied and gradients were computed: the
// largest relative error, with its order. "loss_map_<option>_<option>" for every two numbers of a grid. Points that
// failed are left out.
std::vector<SweepFigure> MakeSweepFigures(const SweepStudy& study, const std::vector<StoredPoint>& points);

// The slope of a straight line through (log x, log y) by least squares; points with an x or y that is not positive are
// left out. NaN if fewer than three are left.
double Order(const std::vector<double>& x, const std::vector<double>& y);

}  // namespace saltus
