// The document of a problem of a hybrid system, as JSON: the system, its motion from the guess, gradients and
// solutions. The programs print it, their pages show it, and Python reads it.
#pragma once

#include "programs/json_output.h"
#include "saltus/audit/hybrid_audit.h"
#include "saltus/hybrid/hybrid_problem.h"
#include "saltus/solve/hybrid_solver.h"

namespace saltus {

// {"modes": [{"name", "states", "guards"}], "controls": [name, ...], "parameters": [name, ...]}
Json HybridSystemToJson(const HybridSystem& system);

// Returns the input of a motion: {"mode", "initial", "parameters", "duration", "intervals", "control"}.
Json HybridInputToJson(const HybridSystem& system, const HybridInput& input);

// The simulator's last rollout: {"mode", "final", "events": [{"time", "mode", "guard", "next_mode", "rate"}],
// "steps_per_interval"}, and if it failed "failed" with the reason and "accumulation" with the time at which events
// accumulate. "remark" states why there is no derivative or only a one-sided one; "remarks" is the list of all remarks
// (remarks.h). With `states` also "times", "modes",
// "states" and "guards" (the values of the mode's guards): at every step of the integration, and before and after every
// event.
Json HybridMotionToJson(const HybridSimulator& simulator, const HybridInput& input, bool ok, bool states);

// The motion from an input with as many states as a figure needs.
Json DrawnMotionToJson(const HybridProblem& problem, const HybridInput& input);

// Adds "integration_error" of the simulator's last rollout, which succeeded, and the remarks on it. Costs a rollout.
void AddIntegrationError(const HybridProblem& problem, HybridSimulator* simulator, Json* motion);

// The loss at the guess and its gradient by all that the motion depends on: {"loss", "gradient"}, or {"failed"} with
// the reason. `motion`, if given, becomes that of the guess.
Json HybridLossToJson(const HybridProblem& problem, bool states, Json* motion = nullptr);

// {"solver", "termination", "reason", "initial_loss", "final_loss", "losses", "iterations", "evaluations", "seconds",
// "integration_error", "solution", "durations", "motion", "certificate"}; of what is not applicable, the first three.
Json HybridRunToJson(const HybridProblem& problem, const SolveReport& report, bool states);

// {"scheme", "verdict", "reason", "steps", "loss", "exact_loss", "order", "gradient", "exact_gradient", "parts",
// "segments", "first_wrong", "width_sweep"}, as in hybrid_audit.h.
Json HybridAuditToJson(const HybridProblem& problem, const HybridAudit& audit);

}  // namespace saltus
