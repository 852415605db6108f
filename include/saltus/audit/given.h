// A gradient that was computed elsewhere, by another simulator or on paper, entry by entry beside the exact one.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "saltus/audit/refinement.h"

namespace saltus {

// Numbers that are not known are NaN, and lists may end early.
struct GivenGradient {
  std::string name;
  double tolerance = 0;                    // absolute, for numbers that were rounded when they were printed
  std::vector<double> position, velocity;  // B x 2, by x and y of each disc of the scene
  std::vector<double> control;             // by the rows of a control (control_rows.h)
  int intervals = 0;                       // of the control, equal parts of the horizon; 0: one a step
};

struct GivenEntry {
  std::string entry;  // as of EntryNames, controls by step
  double given = 0, exact = 0;
  // kRight within the tolerance, or 1e-6 of the quantity's largest entry; else kWrongSign or kWrong. One gradient
  // cannot show whether its error falls with the step: none is merely consistent. kAmbiguous if the exact gradient is.
  Verdict verdict = Verdict::kUnknown;
};

// Precondition: `exact` is ok and of the scene; lists are no longer than its, and its steps a multiple of `intervals`.
std::vector<GivenEntry> JudgeGiven(const Scene& scene, const GivenGradient& given, const ModelGradient& exact);

// The worst verdict of all; kUnknown if there are no entries.
Verdict WorstOf(const std::vector<GivenEntry>& entries);

}  // namespace saltus
