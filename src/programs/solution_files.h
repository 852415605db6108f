// Solutions with their states over time, as JSON and as NPZ files.
#pragma once

#include "programs/json_output.h"
#include "programs/program.h"
#include "programs/solve.h"

namespace saltus {

// Adds "final_state" and "exact_final_state", and if --states asks for it "times", "states", "exact_times" and
// "exact_states". Where states do not fit into --memory_limit they are left out, and stderr says so.
void AddStates(const Request& request, const SolvedRun& run, Json* item);

// Adds what is needed to draw states: "bodies" with names and radii, "planes", and the walls that end, if there are
// any, by their keys in scene files.
void AddDrawn(const Scene& scene, Json* document);

// <scene>_<contact>_<solver>.npz
std::string SolutionFileName(const Scene& scene, const SolveReport& report);

// Every solution as an NPZ file in --output_dir, if there is one. Throws OutputError.
void WriteSolutions(const Request& request, const SolvedRuns& solved);

}  // namespace saltus
