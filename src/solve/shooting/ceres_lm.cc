#include "solve/shooting/ceres_lm.h"

#include <ceres/autodiff_cost_function.h>
#include <ceres/cost_function.h>
#include <ceres/problem.h>
#include <ceres/solver.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <span>

#include "control/control_bounds.h"
#include "control/objective_cost.h"
#include "control/phase_costs.h"
#include "solve/ceres_common.h"

namespace saltus {
namespace {

constexpr int kBlockSize = 8;        // variables
constexpr int kMostInOneBlock = 16;  // up to here a dense factorization is cheaper than conjugate gradients

// The variables, cut into blocks, some of which may be smaller; the last `num_times` have blocks of their own.
std::vector<int> BlockSizes(int num_variables, int num_times) {
  num_variables -= num_times;
  std::vector<int> sizes;
  if (num_variables > kMostInOneBlock) {
    sizes.assign(num_variables / kBlockSize, kBlockSize);
    if (num_variables % kBlockSize != 0) sizes.push_back(num_variables % kBlockSize);
  } else if (num_variables > 0) {
    sizes = {num_variables};
  }
  sizes.insert(sizes.end(), num_times, 1);
  return sizes;
}

// sqrt(effort T / steps) u, with the final time T a variable too. Blocks: u, T.
class ScaledEffortCost final : public ceres::CostFunction {
 public:
  ScaledEffortCost(double effort_of_step, int size) : weight_(effort_of_step) {
    set_num_residuals(size);
    *mutable_parameter_block_sizes() = {size, 1};
  }
  bool Evaluate(double const* const* parameters, double* residuals, double** jacobians) const override {
    const double time = parameters[1][0];
    if (!(time > 0)) return false;
    const double scale = std::sqrt(weight_ * time);
    for (int i = 0; i < num_residuals(); ++i) {
      residuals[i] = scale * parameters[0][i];
      if (jacobians == nullptr) continue;
      if (jacobians[1] != nullptr) jacobians[1][i] = 0.5 * residuals[i] / time;
      for (int j = 0; jacobians[0] != nullptr && j < num_residuals(); ++j) {
        jacobians[0][i * num_residuals() + j] = i == j ? scale : 0.0;
      }
    }
    return true;
  }

 private:
  double weight_;
};

// The residuals of all terms but the effort, as one vector, as a function of all variables.
class ShootingCost final : public ceres::CostFunction {
 public:
  ShootingCost(ShootingFunction* shooting, const std::vector<int>& block_sizes)
      : shooting_(shooting),
        z_(shooting->num_variables()),
        residuals_(shooting->num_residuals()),
        jacobian_(residuals_.size() * z_.size()) {
    set_num_residuals(static_cast<int>(residuals_.size()));
    *mutable_parameter_block_sizes() = block_sizes;
  }

  bool Evaluate(double const* const* parameters, double* residuals, double** jacobians) const override {
    Rollout(parameters);
    if (!finite_) return false;
    std::copy(residuals_.begin(), residuals_.end(), residuals);
    if (jacobians != nullptr) EvaluateJacobians(jacobians);
    return !shooting_->stopped();
  }

  int num_jacobians() const { return num_jacobians_; }

 private:
  // Ceres asks for the residuals at a candidate first, and for the Jacobian at the same point once it has taken the
  // step: the rollout still stands then.
  void Rollout(double const* const* parameters) const {
    bool stands = evaluated_;
    double* z = z_.data();
    for (size_t i = 0; i < parameter_block_sizes().size(); ++i) {
      const int size = parameter_block_sizes()[i];
      stands = stands && std::equal(z, z + size, parameters[i]);
      z = std::copy_n(parameters[i], size, z);
    }
    if (stands) return;
    finite_ = shooting_->EvaluateResiduals(z_, residuals_.data(), nullptr);
    evaluated_ = true;
  }

  void EvaluateJacobians(double** jacobians) const {
    shooting_->ResidualJacobian(jacobian_.data());
    ++num_jacobians_;
    int first = 0;
    for (size_t i = 0; i < parameter_block_sizes().size(); ++i) {
      const int size = parameter_block_sizes()[i];
      for (int row = 0; jacobians[i] != nullptr && row < num_residuals(); ++row) {
        std::copy_n(&jacobian_[row * z_.size() + first], size, jacobians[i] + row * size);
      }
      first += size;
    }
  }

  ShootingFunction* shooting_;
  // One problem, one thread: Ceres' interface is const, its evaluation here is a rollout of shooting_.
  mutable bool evaluated_ = false, finite_ = false;
  mutable std::vector<double> z_, residuals_, jacobian_;
  mutable int num_jacobians_ = 0;
};

// Adds what the scene's objective has beside the residuals of the shooting.
void AddEffort(const SingleShooting& shooting, const VariableBlocks& variables, ceres::Problem* problem) {
  const auto& [sizes, blocks] = variables;
  const Scene& scene = shooting.scene();
  if (shooting.has_duration()) {
    const FreeDuration& free = *scene.objective.duration;
    if (free.weight > 0) {
      using Price = ceres::AutoDiffCostFunction<DurationPrice, DurationPrice::kRows, 1>;
      problem->AddResidualBlock(new Price(new DurationPrice{free.weight}), nullptr, blocks.back());
    }
    problem->SetParameterLowerBound(blocks.back(), 0, free.min);
    problem->SetParameterUpperBound(blocks.back(), 0, free.max);
    for (size_t i = 0; i + 1 < blocks.size() && scene.objective.effort > 0; ++i) {
      const double weight = scene.objective.effort / shooting.simulator().num_steps();
      problem->AddResidualBlock(new ScaledEffortCost(weight, sizes[i]), nullptr, blocks[i], blocks.back());
    }
    return;
  }
  if (scene.optimize != Optimize::kControl || scene.objective.effort == 0) return;
  const double scale = std::sqrt(scene.objective.effort * shooting.simulator().step());
  for (size_t i = 0; i < blocks.size(); ++i) {
    problem->AddResidualBlock(new EffortCost(scale, sizes[i]), nullptr, blocks[i]);
  }
}

// The largest magnitude of an entry of the rows of a control; infinity without a bound.
double LargestComponent(const Scene& scene, int entry) {
  const int turn = entry - 2 * scene.num_controlled();
  if (turn >= 0) return MostTurn(scene, turn);
  return scene.control.max.empty() ? std::numeric_limits<double>::infinity() : scene.control.max[entry / 2];
}

// Bounds on each component of each force, and on torques; the variables are within them.
void SetBounds(const SingleShooting& shooting, const VariableBlocks& variables, ceres::Problem* problem) {
  const Scene& scene = shooting.scene();
  if (scene.optimize != Optimize::kControl || !scene.control.IsBounded()) return;
  int at = 0;
  for (size_t block = 0; block < variables.sizes.size(); ++block) {
    for (int i = 0; i < variables.sizes[block] && at + i < shooting.num_variables() - shooting.has_duration(); ++i) {
      const double most = LargestComponent(scene, (at + i) % scene.control_width());
      if (std::isinf(most)) continue;
      problem->SetParameterLowerBound(variables.blocks[block], i, -most);
      problem->SetParameterUpperBound(variables.blocks[block], i, most);
    }
    at += variables.sizes[block];
  }
}

ceres::Solver::Options LeastSquaresOptions(const SolverOptions& options, int num_blocks) {
  ceres::Solver::Options ceres_options;
  ceres_options.trust_region_strategy_type = ceres::LEVENBERG_MARQUARDT;
  if (num_blocks == 1) {
    ceres_options.linear_solver_type = ceres::DENSE_QR;
  } else {
    // Scaling or a preconditioner would only spread the few distinct eigenvalues.
    ceres_options.linear_solver_type = ceres::CGNR;
    ceres_options.preconditioner_type = ceres::IDENTITY;
    ceres_options.jacobi_scaling = false;
    ceres_options.eta = 1e-6;
  }
  ceres_options.logging_type = ceres::SILENT;
  ceres_options.max_num_iterations = options.iterations;
  ceres_options.gradient_tolerance = kGradientTolerance;
  ceres_options.function_tolerance = kFunctionTolerance;
  ceres_options.parameter_tolerance = kParameterTolerance;
  ceres_options.update_state_every_iteration = true;  // the callback reads it; dropped otherwise if Ceres fails
  return ceres_options;
}

}  // namespace

SolveReport MinimizeLeastSquares(
    ShootingRun* run, std::vector<double> z, int num_times, double offset,
    const std::function<void(const VariableBlocks& variables, ceres::Problem* problem)>& add_terms) {
  double guess_loss = 0;
  if (!run->function().Evaluate(z, &guess_loss, nullptr)) {
    return run->Finish(z, Termination::kFailed, "loss not finite at iteration 0");
  }
  ceres::Problem problem;
  VariableBlocks variables{BlockSizes(run->function().num_variables(), num_times), {}};
  double* next = z.data();
  for (const int size : variables.sizes) {
    variables.blocks.push_back(next);
    next += size;
  }
  auto* shot = new ShootingCost(&run->function(), variables.sizes);  // owned by the problem
  problem.AddResidualBlock(shot, nullptr, variables.blocks);
  add_terms(variables, &problem);

  const LossOfCost loss{.scale = 2, .offset = offset};  // Ceres minimizes half the sum of squares
  RecordIteration record(run, loss, &z);
  ceres::Solver::Options ceres_options = LeastSquaresOptions(run->options(), problem.NumParameterBlocks());
  ceres_options.callbacks = {&record};
  ceres::Solver::Summary summary;
  ceres::Solve(ceres_options, &problem, &summary);
  SolveReport report = Conclude(run, &record, z, {summary.termination_type, summary.iterations, false});
  report.evaluations = shot->num_jacobians();
  return report;
}

SolveReport SolveByCeresLm(const SolveRequest& request, const SolverOptions& options) {
  SolveRun run("ceres_lm", request, options);
  const SingleShooting& shooting = run.shooting();
  std::vector<double> z = run.initial_guess();
  if (shooting.scene().optimize == Optimize::kControl) {
    MoveWithinBounds(shooting.scene(), std::span(z).first(z.size() - shooting.has_duration()));
  }
  return MinimizeLeastSquares(&run,
                              std::move(z),
                              shooting.has_duration(),
                              GivenEffort(shooting),
                              [&](const VariableBlocks& variables, ceres::Problem* problem) {
                                AddEffort(shooting, variables, problem);
                                SetBounds(shooting, variables, problem);
                              });
}

}  // namespace saltus
