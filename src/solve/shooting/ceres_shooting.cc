#include "solve/shooting/ceres_shooting.h"

#include <sstream>

#include "control/step_shooting.h"
#include "solve/ceres_common.h"
#include "solve/shooting/node_search.h"
#include "solve/shooting/path_problem.h"

namespace saltus {
namespace {

constexpr double kBalanced = 1e-3;  // of the early gradient: what may be left of the sum of both

std::string Describe(const NodeSearch& search, const std::optional<NodeSearch::Balance>& balance) {
  std::ostringstream text;
  text << "impact on node";
  for (const Arrival& arrival : search.arrivals()) text << " " << arrival.node;
  if (balance) text << "; one-sided gradients balance at theta " << balance->theta << ", to " << balance->residual;
  return text.str();
}

// After a stall at decision variables z with that loss; replaces both.
End MoveAlongNodes(SolveRun* run, int iterations, End stall, double* loss, std::vector<double>* z, int* num_jacobians) {
  NodeSearch search(run, *z, *loss);
  if (!search.Run(iterations)) return stall;
  *z = search.z();
  *loss = search.loss();
  *num_jacobians += search.num_jacobians();
  End end{Termination::kNoProgress, ""};
  std::optional<NodeSearch::Balance> balance;
  if (search.interrupted()) {
    end.termination = Termination::kInterrupted;
  } else if (search.exhausted()) {
    end.termination = Termination::kIterationLimit;
  } else if (search.arrivals().size() == 1) {
    balance = search.BalanceGradients();
    const bool stationary = balance && balance->theta >= 0 && balance->theta <= 1 && balance->residual < kBalanced;
    if (stationary) end.termination = Termination::kConverged;
  }
  end.words = Describe(search, balance);
  return end;
}

}  // namespace

SolveReport SolveByCeresShooting(const SolveRequest& request, const SolverOptions& options) {
  SolveRun run("ceres_shooting", request, options);
  SingleShooting& shooting = run.shooting();
  std::vector<double> z = run.initial_guess();
  double loss = 0;
  if (!shooting.Evaluate(z, &loss, nullptr)) {
    return run.Finish(z, Termination::kFailed, "loss not finite at iteration 0");
  }
  PathProblem problem(&shooting, z);
  RecordIteration record(
      &run, [&problem](double) { return problem.loss(); }, &problem.z());
  const ceres::Solver::Summary summary = problem.Minimize(options.iterations, kFunctionTolerance, {&record});
  z = problem.z();
  int num_jacobians = summary.num_jacobian_evaluations;
  End end = RecordEnd(&run, &record, z, {summary.termination_type, summary.iterations, false});

  std::optional<double> final_loss;
  const bool kinks = shooting.simulator().traits().event_driven && request.scene.optimize == Optimize::kControl;
  if (kinks && end.termination == Termination::kNoProgress && shooting.Evaluate(z, &loss, nullptr)) {
    end = MoveAlongNodes(&run, options.iterations - (run.num_recorded() - 1), end, &loss, &z, &num_jacobians);
    final_loss = loss;
  }
  std::vector<std::vector<double>> defects;
  if (shooting.Evaluate(z, &loss, nullptr)) {
    final_loss = loss;
    const Simulator& simulator = shooting.simulator();
    defects.push_back(LargestDefects(simulator, StatesOf(simulator), shooting.ControlAt(z)));
  }
  SolveReport report = run.Finish(z, end.termination, end.words, final_loss);
  report.evaluations = num_jacobians;
  report.defects = std::move(defects);
  return report;
}

}  // namespace saltus
