#include "step_solver.h"

#include "ceres_common.h"

namespace saltus {

std::unique_ptr<StepCost> MakeStepCost(const Simulator& simulator) {
  return std::make_unique<StepCost>(std::shared_ptr<const Simulator>(std::shared_ptr<void>(), &simulator));
}

std::unique_ptr<TerminalCost> MakeTerminalCost(const Simulator& simulator) {
  const Objective& objective = simulator.scene().objective;
  if (objective.terminal.empty()) return nullptr;
  return std::make_unique<TerminalCost>(objective, simulator.num_bodies(), simulator.body_size());
}

ceres::Solver::Options SparseOptions(int iterations) {
  ceres::Solver::Options options;
  options.trust_region_strategy_type = ceres::LEVENBERG_MARQUARDT;
  options.linear_solver_type = ceres::SPARSE_NORMAL_CHOLESKY;
  options.sparse_linear_algebra_library_type = ceres::EIGEN_SPARSE;
  options.logging_type = ceres::SILENT;
  options.max_num_iterations = iterations;
  options.gradient_tolerance = kGradientTolerance;
  options.function_tolerance = kFunctionTolerance;
  options.parameter_tolerance = kParameterTolerance;
  options.update_state_every_iteration = true;  // the callbacks read it; dropped otherwise if Ceres fails
  return options;
}

}  // namespace saltus
