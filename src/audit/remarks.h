// Remarks on a result: what limits it, or what its numbers do not show. They are made here once, and tables, pages,
// JSON and Python show the same ones.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "saltus/audit/gradients.h"
#include "saltus/hybrid/hybrid_simulator.h"
#include "saltus/simulate/exact_run.h"
#include "solve/checked_run.h"

namespace saltus {

struct Remark {
  // "fallback" (steps that are not resolved into events), "no exact motion", "ambiguous" (simultaneous impacts whose
  // order changes the motion), "derivative" (there is none, or a one-sided one), "integration error", "lost digits",
  // "guess" or "end" (of a solver).
  std::string kind;
  std::string text;  // with the place and the cause
};
using Remarks = std::vector<Remark>;

// Remarks on a motion that was simulated exactly, or could not be.
Remarks RemarksOn(const ExactRun& exact);
// Whether the last rollout of a simulator has ties or unresolved steps, so that there may be remarks on it. Cheap.
bool MayHaveRemarks(const Simulator& simulator);
// Remarks on the last rollout of a simulator, from an initial state (simulator.h) under its control: ties are simulated
// in other orders, which takes as many rollouts, and only those that change the motion are reported. Empty for models
// that resolve no events.
Remarks RemarksOn(const Simulator& simulator, const std::vector<double>& initial, const std::vector<double>& control,
                  const StopRequest& stop = nullptr);
// Remarks on a loss and its gradient. Precondition: gradient.ok().
Remarks RemarksOn(const Scene& scene, const ModelGradient& gradient);
// Remarks on a run of a solver, or on a simulation.
Remarks RemarksOn(const CheckedRun& run);
// Remarks on the last motion of a hybrid system, which succeeded, and on its integration error, if that is known: it
// should be at most `tolerance`, up to rounding.
Remarks RemarksOn(const HybridSimulator& simulator, std::optional<double> integration_error = std::nullopt,
                  double tolerance = 0);

}  // namespace saltus
