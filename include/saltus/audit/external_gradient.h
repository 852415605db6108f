// Externally computed gradients, by another simulator or by hand, compared with the exact gradient entry by entry.
#pragma once

#include <string>
#include <vector>

#include "saltus/audit/refinement.h"

namespace saltus {

// An externally computed gradient. Numbers that are not known are NaN, and lists may end early.
struct ExternalGradient {
  std::string name;                        // for outputs
  double tolerance = 0;                    // absolute, for numbers that were rounded when they were printed
  std::vector<double> position, velocity;  // B x 2, by x and y of each disc of the scene
  // B numbers each, in scenes with discs that spin; entries of discs that do not are not read.
  std::vector<double> angle, angular_velocity;
  std::vector<double> control;  // by the rows of a control (control_rows.h): by torques, not by torque / radius
  int intervals = 0;            // number of equal parts of the horizon that `control` is for; 0: one for each step
};

struct ExternalGradientEntry {
  std::string entry;  // its name, such as "px ball", "angle ball" or "ux[3] ball" (interval 3)
  double given = 0, exact = 0;
  // kRight within the tolerance, or within 1e-6 of the quantity's largest entry; else kWrongSign or kWrong. kAmbiguous
  // if the exact gradient is. Never kConsistent: one gradient does not show whether its error decreases with the step.
  Verdict verdict = Verdict::kUnknown;
};

// Compares each entry that is not NaN. Precondition: `exact` is ok() and of this scene; the lists of `given` are not
// longer than those of `exact`, whose number of steps is a multiple of `intervals`.
std::vector<ExternalGradientEntry> JudgeExternalGradient(const Scene& scene, const ExternalGradient& given,
                                                         const ModelGradient& exact);

// Returns the worst verdict; kUnknown if there are no entries.
Verdict WorstVerdict(const std::vector<ExternalGradientEntry>& entries);

}  // namespace saltus
