// Names that the targets refer to, in place of the solvers and contact models behind them: readers want no more, and
// those would take long to compile.
#include "dynamics/registry_entry.h"
#include "saltus/solve/solver.h"

namespace saltus {

const std::vector<SolverEntry>& AllSolvers() {
  static const std::vector<SolverEntry>& solvers =
      *new std::vector<SolverEntry>{{.name = "gd", .summary = ""}, {.name = "ceres_lm", .summary = ""}};
  return solvers;
}

template <>
RegistryEntry EntryOf<0>() {
  return {{.name = "direct"}, {}, [](const Scene&) { return std::string(); }, nullptr};
}

template <>
RegistryEntry EntryOf<1>() {
  const ListedOption kappa = {{"kappa", "a number", 1e-12, 1, true}, 1e-6, false};
  const ListedOption substeps = {{"substeps", "a whole number", 1, 1000}, 10, true};
  return {{.name = "ncp"}, {kappa, substeps}, [](const Scene&) { return std::string(); }, nullptr};
}

}  // namespace saltus
