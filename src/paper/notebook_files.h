// The files that the authors' published analysis notebooks read, under the same names and keys.
#pragma once

#include <string>

#include "paper/experiments.h"

namespace saltus {

// Writes results/*.npz below `output_dir`. Throws InputError if a file cannot be written.
void WriteNotebookFiles(const Experiments& experiments, const std::string& output_dir);

// The positions of the first disc under one iterate: before each step, and after the last but for the Brax models,
// whose files have only those before. T x 2.
std::vector<double> TrajectoryAt(const Experiment& experiment, std::span<const double> z);

}  // namespace saltus
