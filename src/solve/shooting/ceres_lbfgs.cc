#include "solve/shooting/ceres_lbfgs.h"

#include <ceres/gradient_problem.h>
#include <ceres/gradient_problem_solver.h>

#include <algorithm>
#include <cmath>

#include "solve/ceres_common.h"

namespace saltus {
namespace {

class Loss final : public ceres::FirstOrderFunction {
 public:
  explicit Loss(ShootingFunction* shooting) : shooting_(shooting) {}

  bool Evaluate(const double* z, double* loss, double* gradient) const override {
    if (!shooting_->Evaluate({z, static_cast<size_t>(NumParameters())}, loss, gradient)) return false;
    return gradient == nullptr ||
           std::all_of(gradient, gradient + NumParameters(), [](double g) { return std::isfinite(g); });
  }
  int NumParameters() const override { return shooting_->num_variables(); }

 private:
  ShootingFunction* shooting_;
};

}  // namespace

SolveReport MinimizeByLbfgs(ShootingRun* run) {
  std::vector<double> z = run->initial_guess();
  double guess_loss = 0;
  if (!run->function().Evaluate(z, &guess_loss, nullptr)) {
    return run->Finish(z, Termination::kFailed, "loss not finite at iteration 0");
  }
  RecordIteration record(run, LossOfCost{}, &z);
  ceres::GradientProblemSolver::Options ceres_options;
  ceres_options.line_search_direction_type = ceres::LBFGS;
  ceres_options.line_search_type = ceres::WOLFE;
  ceres_options.logging_type = ceres::SILENT;
  ceres_options.max_num_iterations = run->options().iterations;
  ceres_options.gradient_tolerance = kGradientTolerance;
  ceres_options.function_tolerance = kFunctionTolerance;
  ceres_options.parameter_tolerance = kParameterTolerance;
  ceres_options.callbacks = {&record};
  ceres_options.update_state_every_iteration = true;  // the callback reads it; dropped otherwise if Ceres fails

  const ceres::GradientProblem problem(new Loss(&run->function()));
  ceres::GradientProblemSolver::Summary summary;
  ceres::Solve(ceres_options, problem, z.data(), &summary);
  return Conclude(run, &record, z, {summary.termination_type, summary.iterations, true});
}

SolveReport SolveByCeresLbfgs(const SolveRequest& request, const SolverOptions& options) {
  SolveRun run("ceres_lbfgs", request, options);
  return MinimizeByLbfgs(&run);
}

}  // namespace saltus
