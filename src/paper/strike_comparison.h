// The task of two balls by solvers that shoot over the impact and by those that treat it as an event, on the paper's
// time grid and on a finer one; and with bounds on the force, beside the optima in continuous time.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "paper/experiments.h"
#include "paper/section.h"

namespace saltus {

// An optimum of data/constrained_references.json under a bound on the force.
struct BoundedReference {
  Vec2d target = Vec2d::Zero();         // m, where the disc that is struck starts
  std::optional<double> max, max_norm;  // N
  double loss = 0, impact_time = 0;
  Vec2d at_start = Vec2d::Zero(), at_impact = Vec2d::Zero();  // N, the force without the bound, linear between

  Vec2d Force(double time) const;  // that within the bound
};

// Reads the references that the figure shows. Throws InputError.
std::vector<BoundedReference> ReadBoundedReferences(const std::string& path);

// Compares the solvers on the scene of the task. Returns std::nullopt if interrupted.
std::optional<Section> CompareStrikes(const Scene& scene, const std::vector<BoundedReference>& references, int threads,
                                      ProgressMode mode);

}  // namespace saltus
