// Externally computed gradients, by another simulator or by hand, compared with the exact gradient entry by entry.
#pragma once

#include <string>
#include <vector>

#include "saltus/audit/refinement.h"

namespace saltus {

// An externally computed gradient. Numbers that are not known are NaN, and lists may end early.
struct GivenGradient {
  std::string name;
  double tolerance = 0;                    // absolute, for numbers that were rounded when they were printed
  std::vector<double> position, velocity;  // B x 2, by x and y of each disc of the scene
  // B, by those of each disc that spins, in scenes with such discs.
  std::vector<double> angle, angular_velocity;
  std::vector<double> control;  // by the rows of a control (control_rows.h)
  int intervals = 0;            // of the control, equal parts of the horizon; 0: one a step
};

struct GivenEntry {
  std::string entry;  // a name of EntryNames(), of controls by step
  double given = 0, exact = 0;
  // kRight within the tolerance, or within 1e-6 of the quantity's largest entry; else kWrongSign or kWrong. kAmbiguous
  // if the exact gradient is. Never kConsistent: one gradient does not show whether its error decreases with the step.
  Verdict verdict = Verdict::kUnknown;
};

// Compares each entry. Precondition: `exact` is ok() and of this scene; the lists of `given` are not longer than those
// of `exact`, whose number of steps is a multiple of `intervals`.
std::vector<GivenEntry> JudgeGiven(const Scene& scene, const GivenGradient& given, const ModelGradient& exact);

// Returns the worst verdict; kUnknown if there are no entries.
Verdict WorstOf(const std::vector<GivenEntry>& entries);

}  // namespace saltus
