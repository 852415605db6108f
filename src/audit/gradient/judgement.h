// Verdicts from measurements: from errors at several refinements, and from differences of several widths.
#pragma once

#include <string>
#include <vector>

#include "saltus/audit/refinement.h"
#include "saltus/audit/width_sweep.h"

namespace saltus {

// The levels of the error of a quantity, added one after the other.
struct QuantityLevels {
  std::vector<std::string> names;  // of the entries
  double scale = 1;                // that errors are relative to
  std::vector<double> coarsest = {};

  // Returns the distance of the judged entries from the exact ones, relative to the scale.
  double ErrorOf(const std::vector<double>& entries, const QuantityStudy& study) const;
  // Adds a level of so many steps (the mean), given the entries at each of its samples, and judges what there is.
  // Precondition: study->exact and study->one_sided are set.
  void Add(double steps, const std::vector<std::vector<double>>& samples, const RefinementOptions& options,
           QuantityStudy* study);
};

// Returns the scale of errors; where the exact gradient is zero, errors are absolute, on the scale of the loss.
double ScaleOf(const QuantityStudy& study, const std::vector<std::string>& names, double loss);

// Whether an error that falls may converge to a positive limit, as that of a stiff spring does.
bool MayHaveAFloor(const QuantityStudy& study);

// Finds plateaus and findings of the sweeps, given the widths and slopes. `loss` is that of the refined simulation.
Verdict JudgeSweeps(double loss, const WidthSweepOptions& options, std::vector<WidthSweep>* sweeps);

// Returns the widths of a sweep.
std::vector<double> WidthsOf(const WidthSweepOptions& options, double grid_width);

}  // namespace saltus
