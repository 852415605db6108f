// Identification of parameters and initial states of hybrid systems from measurements, by the fits of identify.h.
//
// Experiments are motions of one system or of several. They share the unknowns that are common, and each may have
// unknowns of its own. Data are costs of the problem, as for Solve(): each residual of its terms is (predicted -
// measured) / sigma. Derivatives are exact through every event. Each measured number is judged as an outlier by itself.
#pragma once

#include <functional>
#include <limits>
#include <string>
#include <vector>

#include "saltus/hybrid/hybrid_problem.h"
#include "saltus/identify/identify.h"

namespace saltus {

// A number that was measured.
struct HybridDatum {
  std::string quantity;  // name of what was measured, such as that of a state; in its unit are value and sigma
  double time = 0;       // of the measurement, in the system's unit of time; fits begin with the first ones
  double value = 0;
  double sigma = 1;  // by which the residual of the term is divided already
  // Whether sigma is the standard deviation of the value. Otherwise this is estimated; of all numbers or of none.
  bool states_sigma = true;
};

struct HybridExperiment {
  std::string name;
  // The motion. Each of its terms is a cost that counts at one place: at the beginning of one interval, at the end or
  // at one event. What is free in it does not matter.
  HybridProblem problem;
  std::vector<HybridDatum> data;  // one for each residual of the terms, in their order
  // Sets the mode in which a motion with this input begins, or returns why there is none; none: that of the guess.
  std::function<std::string(HybridInput*)> begin = nullptr;
};

// A number to identify, whose fit starts from the guess of the first experiment that has it.
struct HybridUnknown {
  std::string name;
  bool is_initial = false;  // whether it is a component of the initial state, and not a parameter
  int index = 0;            // of the component of the state or of the parameter
  int experiment = -1;      // the only one that has it; -1: all have it in common
  // Its bounds. An unknown is not determined if its standard error is above half of the distance between the bounds;
  // with one bound, half of the distance from it; without any, half of its size, that of the guess or the fitted one (1
  // if both are zero). For a component of the initial state its range in the motion of the guess counts, too.
  double min = -std::numeric_limits<double>::infinity(), max = std::numeric_limits<double>::infinity();
};

// Fits unknowns to experiments. Errors in the arguments are reported as kNotApplicable. IdentifyOptions::segment,
// `initial_states`, `law` and `events` are not used. Without a stated sigma that of each quantity is estimated as one
// share of the range of its data. The report has no initial states; its recordings are the experiments, and its samples
// their data.
IdentifyReport Identify(const std::vector<HybridExperiment>& experiments, const std::vector<HybridUnknown>& unknowns,
                        const IdentifyOptions& options = {});

}  // namespace saltus
