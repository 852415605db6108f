// A control that is given to start from, on the time grid of a solver.
#pragma once

#include <string>
#include <vector>

#include "saltus/solve/solver.h"

namespace saltus {

// Checks the sizes and numbers of a guess for the scene; returns an error, empty if it is valid.
std::string Validate(const ControlGuess& guess, const Scene& scene);

// The lengths of its intervals, and their sum.
std::vector<double> LengthsOf(const ControlGuess& guess, const Scene& scene);
double DurationOf(const ControlGuess& guess, const Scene& scene);

// Returns the mean of a guess over each of `steps` equal parts of its duration, steps x width numbers
// (Scene::control_width()): the same impulse in each. Forces that are constant over a part are kept bit by bit.
std::vector<double> MeanOverSteps(const ControlGuess& guess, int width, int steps);

}  // namespace saltus
