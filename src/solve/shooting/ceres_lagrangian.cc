#include <Eigen/Core>
#include <algorithm>
#include <sstream>

#include "control/step_shooting.h"
#include "solve/phases/augmented_lagrangian.h"
#include "solve/shooting/step_shooting_solvers.h"
#include "solve/solve_run.h"

namespace saltus {
namespace {

struct Gradient {
  bool ok = false;
  double loss = 0;
  double norm = 0;  // largest component
};

Gradient GradientAt(SingleShooting* shooting, const std::vector<double>& z) {
  Eigen::VectorXd values(z.size());
  Gradient gradient;
  gradient.ok = shooting->Evaluate(z, &gradient.loss, values.data()) && values.allFinite();
  gradient.norm = values.lpNorm<Eigen::Infinity>();
  return gradient;
}

std::string DefectsOpen(double largest) {
  std::ostringstream text;
  text << "defects are open: the largest is " << largest;
  return text.str();
}

}  // namespace

SolveReport SolveByCeresLagrangian(const SolveRequest& request, const SolverOptions& options) {
  SolveRun run("ceres_lagrangian", request, options);
  SingleShooting& shooting = run.shooting();
  std::vector<double> z = run.initial_guess();
  const Gradient first = GradientAt(&shooting, z);
  if (!first.ok) return run.Finish(z, Termination::kFailed, "loss not finite at iteration 0");
  if (!run.Record(first.loss, z)) return run.Finish(z, Termination::kInterrupted);

  const Simulator& simulator = shooting.simulator();
  StepShooting variables(&shooting, z);
  AugmentedLagrangian problem;
  for (int k = 0; k < variables.num_steps(); ++k) {
    problem.Add(MakeStepCost(simulator), {.equalities = variables.state_size()}, variables.StepBlocks(k));
  }
  if (auto terminal = MakeTerminalCost(simulator)) {
    problem.Add(std::move(terminal), {}, {variables.State(variables.num_steps())});
  }
  variables.AddEffort(
      [&](std::unique_ptr<ceres::CostFunction> cost, double* forces) { problem.Add(std::move(cost), {}, {forces}); });
  variables.HoldConstants(&problem.problem());

  bool finite = true;
  double open = 0;
  std::vector<std::vector<double>> defects;
  AugmentedLagrangian::Options rounds;
  rounds.iterations = options.limits.iterations;
  rounds.equality_weight = 1 / simulator.step();
  rounds.callback = [&](double) {
    const std::vector<double> next = variables.Decisions();
    double loss = 0;
    finite = shooting.Evaluate(next, &loss, nullptr);
    if (!finite) return false;
    z = next;
    return run.Record(loss, z);
  };
  rounds.after_round = [&] {
    const std::span<const double> states(variables.State(0), variables.State(variables.num_steps() + 1));
    defects.push_back(LargestDefects(simulator, states, shooting.ControlAt(variables.Decisions())));
    open = *std::max_element(defects.back().begin(), defects.back().end());
  };
  const AugmentedLagrangian::Summary summary = problem.Minimize(rounds);

  Termination termination = finite ? TerminationOf(summary, options.limits.iterations) : Termination::kFailed;
  std::string reason;
  if (open > rounds.tolerance) {
    reason = DefectsOpen(open);
  } else if (termination == Termination::kConverged &&
             !(GradientAt(&shooting, z).norm <= std::max(kGradientTolerance, kGradientReduction * first.norm))) {
    termination = Termination::kNoProgress;
    reason = "defects are closed, but the gradient of the rollout has not vanished";
  }
  SolveReport report = run.Finish(z, termination, reason);
  report.work.evaluations = summary.jacobians;
  report.history.defects = std::move(defects);
  return report;
}

}  // namespace saltus
