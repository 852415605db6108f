// A comparison of every solver under every contact model.
//
// Tasks 2 (without and with friction) and 3 under the models that the published comparisons report, and task 3 under
// all others. Losses under a contact model may not be compared between models; exact losses may, and their gap to the
// optimum is what is left to gain. Solvers that know exact dynamics only (optima on the grid, phases between events,
// the minimum principle) appear with the event-driven model.
#pragma once

#include <map>
#include <optional>
#include <set>
#include <string>
#include <vector>

#include "paper/experiments.h"
#include "paper/section.h"

namespace saltus {

// The solvers that run under models without experiments: none; those that take a second or two; or every general
// solver, however slow the model.
enum class OtherSolvers { kNone, kQuick, kEverySolver };

struct ComparedSolvers : Section {
  Table headline;              // of task 3 under exact dynamics: three solvers compared with the optimum
  std::set<std::string> slow;  // contact models whose gradients take so long that gradient descent was left out
  // The iterates that AuditDescents() examines, of gradient descent on task 3 under models without experiments.
  std::map<std::string, std::vector<std::vector<double>>> iterates;
};

// Takes the results that `experiments`, which have been run, contain, and computes the rest. Returns std::nullopt if
// interrupted.
std::optional<ComparedSolvers> CompareSolvers(const Experiments& experiments, OtherSolvers others, int threads,
                                              ProgressMode mode);

}  // namespace saltus
