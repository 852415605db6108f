// Names that the targets refer to, in place of the solvers, contact models and flags behind them: readers want no more,
// and those would take long to compile.
#include "programs/program.h"
#include "saltus/solve/hybrid_solver.h"
#include "saltus/solve/solver.h"
#include "simulate/registry_entry.h"

namespace saltus {

const std::vector<SolverEntry>& AllSolvers() {
  static const std::vector<SolverEntry>& solvers = *new std::vector<SolverEntry>{
      {.name = "gd", .summary = "", .reason_not_applicable = nullptr, .solve = nullptr},
      {.name = "ceres_lm", .summary = "", .reason_not_applicable = nullptr, .solve = nullptr}};
  return solvers;
}

const std::vector<HybridSolverEntry>& HybridSolvers() {
  static const std::vector<HybridSolverEntry> solvers;
  return solvers;
}

std::string Validate(const SearchOptions&) { return ""; }

void ApplySceneFlags(Scene*) {}

namespace {

ContactEntry Named(const char* name, std::vector<ListedOption> options) {
  ModelTraits traits = {};
  traits.name = name;
  return {traits, std::move(options), [](const Scene&) { return std::string(); }, nullptr};
}

}  // namespace

template <>
ContactEntry EntryOf<0>() {
  return Named("direct", {});
}

template <>
ContactEntry EntryOf<1>() {
  const ListedOption kappa = {{"kappa", "a number", 1e-12, 1, true}, 1e-6, false};
  const ListedOption substeps = {{"substeps", "a whole number", 1, 1000}, 10, true};
  return Named("ncp", {kappa, substeps});
}

}  // namespace saltus
