#include "solve/hmp_roots.h"

#include <ceres/dynamic_autodiff_cost_function.h>
#include <ceres/problem.h>
#include <ceres/solver.h>

#include <algorithm>
#include <cmath>

#include "base/linear_algebra.h"

namespace saltus {
namespace {

constexpr int kStride = 4;  // derivatives in one pass

struct Conditions {
  HmpSystem system;
  template <typename T>
  bool operator()(T const* const* y, T* residuals) const {
    Path<T> path;
    return system.Evaluate(y[0], &path, residuals);
  }
};

// The multipliers that leave the least sum of squares.
bool StartMultipliers(const HmpSystem& system, std::vector<double>* y) {
  const int n = system.num_residuals(), variables = system.phases->num_variables();
  Path<double> path;
  Eigen::VectorXd base(n), moved(n);
  if (!system.Evaluate(y->data(), &path, base.data())) return false;
  Eigen::MatrixXd columns(n, system.num_impacts());
  for (int k = 0; k < system.num_impacts(); ++k) {
    (*y)[variables + k] = 1;
    system.Evaluate(y->data(), &path, moved.data());
    (*y)[variables + k] = 0;
    columns.col(k) = moved - base;
  }
  if (system.num_impacts() == 0) return true;
  const Eigen::VectorXd best = -LeastSquaresSolution(columns, base);
  std::copy_n(best.data(), system.num_impacts(), y->begin() + variables);
  return true;
}

}  // namespace

NewtonSummary FindRoot(ceres::CostFunction* equations, std::vector<double>* y, int most_iterations) {
  ceres::Problem problem;
  problem.AddResidualBlock(equations, nullptr, y->data());
  ceres::Solver::Options options;
  options.linear_solver_type = ceres::DENSE_QR;
  options.logging_type = ceres::SILENT;
  options.max_num_iterations = most_iterations;
  options.initial_trust_region_radius = 1e12;  // Newton's method until that fails
  options.max_trust_region_radius = 1e20;
  options.min_lm_diagonal = 1e-12;
  options.gradient_tolerance = 0;
  options.function_tolerance = 0;
  options.parameter_tolerance = 0;
  options.max_num_consecutive_invalid_steps = 20;
  ceres::Solver::Summary summary;
  ceres::Solve(options, &problem, &summary);
  return {std::max(0, static_cast<int>(summary.iterations.size()) - 1), summary.num_jacobian_evaluations};
}

HmpRoot FindHmpRoot(const EventPhases& phases, std::vector<double> z, int most_iterations) {
  HmpRoot root;
  const Conditions conditions{HmpSystem(&phases)};
  const HmpSystem& system = conditions.system;
  std::vector<double> y = std::move(z);
  y.resize(system.num_variables(), 0.0);
  if (!StartMultipliers(system, &y)) return root;
  NewtonSummary summary;
  if (system.num_residuals() > 0) {
    auto* cost = new ceres::DynamicAutoDiffCostFunction<Conditions, kStride>(new Conditions(conditions));
    cost->AddParameterBlock(system.num_variables());
    cost->SetNumResiduals(system.num_residuals());
    summary = FindRoot(cost, &y, most_iterations);
  }
  Path<double> path;
  std::vector<double> r(system.num_residuals());
  if (!system.Evaluate(y.data(), &path, r.data())) return root;
  root.valid = true;
  for (double x : r) root.residual = std::max(root.residual, std::abs(x));
  for (int k = 0; k < system.num_impacts(); ++k) {
    root.scale = std::max(root.scale, std::abs(y[phases.num_variables() + k]));
  }
  for (const Arc<double>& arc : path.arcs) {
    const double mass = phases.scene().bodies[arc.body].mass;
    const double weight = 2 * phases.scene().objective.effort * mass * mass;
    root.scale = std::max({root.scale, weight * arc.slope.norm(), weight * arc.AccelerationAtStart().norm()});
  }
  root.iterations = summary.iterations;
  root.jacobians = summary.jacobians;
  root.multipliers.assign(y.begin() + phases.num_variables(), y.end());
  y.resize(phases.num_variables());
  root.z = std::move(y);
  return root;
}

}  // namespace saltus
