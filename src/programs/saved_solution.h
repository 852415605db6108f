// A control or a solution from a file, of saltus or of another solver.
#pragma once

#include <string>
#include <vector>

#include "saltus/scene/scene.h"

namespace saltus {

struct SavedSolution {
  std::vector<double> control;        // K x C x 2, N, for any K; empty if there is none
  std::vector<double> durations;      // s, of the K intervals; empty: equally long
  std::vector<double> initial_state;  // B x 4; empty if the file does not have it
};

// Reads JSON (a run of saltus_solve --json, a document with one run, or an object with the keys "control", "durations",
// "position" and "velocity", all optional) or NPZ ("control" of K x C x 2 or, of one disc, K x 2 numbers, "durations"
// of K, "initial_state" of B x 4). Other keys are not looked at. Throws InputError, which begins with `flag`, if sizes
// are not those of the scene.
SavedSolution ReadSolution(const std::string& flag, const std::string& path, const Scene& scene);

// Parses JSON that is not in a file; messages begin with `name`.
SavedSolution ParseSolution(const std::string& name, const std::string& json, const Scene& scene);

// Takes over the velocities or positions that the scene leaves free. Throws InputError if the others are not those of
// the scene: then it is a solution of another problem.
void StartFrom(const std::string& flag, const SavedSolution& solution, Scene* scene);

}  // namespace saltus
