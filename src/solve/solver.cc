#include "saltus/solve/solver.h"

#include <glog/logging.h>

#include "ceres_event.h"
#include "ceres_lagrangian.h"
#include "ceres_lbfgs.h"
#include "ceres_lm.h"
#include "ceres_phases.h"
#include "ceres_shooting.h"
#include "gradient_descent.h"
#include "grid_solver.h"
#include "hmp.h"
#include "mode_search.h"
#include "phase_solution.h"
#include "saltus/dynamics/registry.h"
#include "solve_run.h"

namespace saltus {
namespace {

std::string WhyNotSingleShooting(const SolveRequest& request) { return WhyNothingToOptimize(request.scene); }

std::string WhyNotLeastSquares(const SolveRequest& request) {
  if (!request.scene.objective.IsSumOfSquares()) return "least squares needs a sum of squares";
  return WhyNothingToOptimize(request.scene);
}

// What only a solver with constraints and states on the way can take.
std::string WhyNotPlain(const Scene& scene) {
  const Objective& objective = scene.objective;
  const char* found = nullptr;
  if (!scene.control.max.empty() || !scene.control.max_norm.empty()) found = "bounds on the control";
  if (objective.HasConstraints()) found = "hard terms";
  if (!objective.running.empty()) found = "running terms";
  if (!objective.via.empty()) found = "via terms";
  if (objective.duration) found = "a free duration";
  if (!scene.no_contact.empty()) found = "pairs that must not touch";
  return found == nullptr ? "" : std::string("the scene has ") + found + ", which ceres_phases takes";
}

std::string WhyNotSurrogate(const SolverEntry& entry, const SolveRequest& request, const Surrogate& surrogate) {
  if (!entry.takes_surrogate) return "a surrogate is not the derivative of the loss, which this solver relies on";
  return WhyNotApplicable(surrogate, request.contact, request.scene);
}

}  // namespace

const std::vector<SolverEntry>& AllSolvers() {
  // clang-format off
  static const std::vector<SolverEntry>& solvers = *new std::vector<SolverEntry>{
      {"gd", "gradient descent at a fixed rate", WhyNotSingleShooting, SolveByGradientDescent, false, true},
      {"ceres_lbfgs", "L-BFGS of Ceres on the adjoint gradient", WhyNotSingleShooting, SolveByCeresLbfgs},
      {"ceres_lm", "Levenberg-Marquardt of Ceres, single shooting", WhyNotLeastSquares, SolveByCeresLm},
      {"ceres_shooting", "Levenberg-Marquardt of Ceres, step shooting, every iterate a rollout", WhyNotLeastSquares, SolveByCeresShooting},
      {"ceres_lagrangian", "step shooting of Ceres, augmented Lagrangian; not for collisions", WhyNotLeastSquares, SolveByCeresLagrangian},
      {"grid_optimum", "best control on the time grid, two discs in closed form", WhyNotGridOptimum, SolveByGridOptimum, true},
      {"ceres_event", "Ceres on phases between the impacts of a given sequence", WhyNotEventPhases, SolveByCeresEvent, true},
      {"ceres_phases", "Ceres through impacts, a cost for every step: bounds, constraints, running costs, free time", WhyNotPhases, SolveByCeresPhases, true},
      {"hmp", "hybrid minimum principle: costates through impacts, continuous time", WhyNotEventPhases, SolveByHmp, true},
      {"mode_search", "as ceres_event, and searches for the sequence of impacts", WhyNotEventPhases, SolveByModeSearch, true},
  };
  // clang-format on
  return solvers;
}

const SolverEntry* FindSolver(std::string_view name) {
  for (const SolverEntry& solver : AllSolvers()) {
    if (solver.name == name) return &solver;
  }
  return nullptr;
}

SolveReport Solve(std::string_view solver, const SolveRequest& request, const SolverOptions& options) {
  const SolverEntry* entry = FindSolver(solver);
  CHECK(entry != nullptr) << "unknown solver " << solver;
  std::string reason = WhyNotApplicable(request.contact, request.scene);
  if (reason.empty() && entry->solve != SolveByCeresPhases) reason = WhyNotPlain(request.scene);
  if (reason.empty()) reason = entry->why_not(request);
  if (reason.empty() && options.surrogate) reason = WhyNotSurrogate(*entry, request, *options.surrogate);
  if (reason.empty()) return entry->solve(request, options);
  SolveReport report;
  report.contact = request.contact;
  report.solver = solver;
  report.surrogate = options.surrogate;
  report.termination = Termination::kNotApplicable;
  report.reason = std::move(reason);
  return report;
}

const char* TerminationToString(Termination termination) {
  switch (termination) {
    case Termination::kConverged:
      return "converged";
    case Termination::kIterationLimit:
      return "iteration_limit";
    case Termination::kNoProgress:
      return "no_progress";
    case Termination::kFailed:
      return "failed";
    case Termination::kInterrupted:
      return "interrupted";
    case Termination::kNotApplicable:
      return "not_applicable";
  }
  return "";
}

}  // namespace saltus
