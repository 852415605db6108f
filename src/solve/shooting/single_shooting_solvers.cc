#include "solve/shooting/single_shooting_solvers.h"

#include <ceres/autodiff_cost_function.h>
#include <ceres/cost_function.h>
#include <ceres/gradient_problem.h>
#include <ceres/gradient_problem_solver.h>
#include <ceres/problem.h>
#include <ceres/solver.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <optional>
#include <span>

#include "base/number_text.h"
#include "base/statistics.h"
#include "control/control_bounds.h"
#include "control/phase_costs.h"
#include "control/smoothed_gradient.h"
#include "control/step_shooting.h"
#include "saltus/control/objective.h"
#include "saltus/scene/scene_parameter.h"
#include "solve/solve_run.h"

namespace saltus {
namespace {

// Updates `count` variables from number `first` on.
template <typename S>
void Update(double learning_rate, const std::vector<double>& gradient, size_t first, size_t count,
            std::vector<double>* z) {
  for (size_t i = first; i < first + count; ++i) {
    (*z)[i] = static_cast<S>((*z)[i]) - static_cast<S>(learning_rate) * static_cast<S>(gradient[i]);
  }
}

// The step of one iteration: along the gradient, and back to the bounds. A final time that is free takes the rate of
// forces times the length of a step, so that its unit is that of the rate per unit of time.
class Step {
 public:
  Step(const SingleShooting& shooting, const SolverOptions& options)
      : scene_(shooting.scene()),
        design_(shooting.num_design()),
        forces_(shooting.num_variables() - shooting.has_duration() - design_),
        rate_(options.descent.learning_rate),
        rate_of_time_(options.descent.learning_rate),
        rate_of_design_(options.descent.learning_rate) {
    const double length = shooting.simulator().step();
    if (options.descent.rate_per_time) {
      rate_ /= length;
    } else {
      rate_of_time_ *= length;
    }
    update_ = shooting.simulator().precision() == Precision::kFloat ? Update<float> : Update<double>;
  }

  void operator()(const std::vector<double>& gradient, std::vector<double>* z) const {
    update_(rate_, gradient, 0, forces_, z);
    if (forces_ + design_ < z->size()) update_(rate_of_time_, gradient, forces_, 1, z);
    update_(rate_of_design_, gradient, z->size() - design_, design_, z);
    MoveWithin(z);
  }

  void MoveWithin(std::vector<double>* z) const {
    if (scene_.optimize == Optimize::kControl) MoveWithinBounds(scene_, std::span(*z).first(forces_));
    for (size_t i = 0; i < design_; ++i) {
      const ParameterRange range = RangeOf(scene_.design[i]);
      double& value = (*z)[z->size() - design_ + i];
      value = std::clamp(value, range.min, range.max);
    }
    if (forces_ + design_ == z->size()) return;
    (*z)[forces_] = std::clamp((*z)[forces_], scene_.objective.duration->min, scene_.objective.duration->max);
  }

 private:
  Scene scene_;
  size_t design_, forces_;
  double rate_, rate_of_time_, rate_of_design_;
  void (*update_)(double, const std::vector<double>&, size_t, size_t, std::vector<double>*);
};

// The best iterate so far; copied only when the descent leaves it.
class Best {
 public:
  // `last` is the iterate before.
  void ConsiderIterate(double loss, int iteration, const std::vector<double>& last) {
    if (iteration == 0 || loss < best_.solution.loss) {
      best_.solution.loss = loss;
      best_.iteration = iteration;
    } else if (best_.iteration == iteration - 1) {
      z_ = last;
    }
    last_ = iteration;
  }

  SolveReport AddTo(SolveReport report, const ShootingFunction& shooting) {
    if (last_ < 0) return report;
    if (best_.iteration < last_) SetSolution(shooting, z_, &best_.solution);
    report.history.best = std::move(best_);
    return report;
  }

 private:
  SolveReport::History::Best best_;
  std::vector<double> z_;
  int last_ = -1;
};

SolveReport Fail(ShootingRun* run, const char* what, int iteration, const std::vector<double>& z) {
  return run->Finish(
      z, Termination::kFailed, std::string(what) + " not finite at iteration " + std::to_string(iteration));
}

// Returns the estimator that replaces the gradient of the model's adjoint, if asked for.
std::optional<SmoothedGradient> MakeSmoothedGradient(const SolveRequest& request, const SolverOptions& options) {
  if (!options.surrogate || !options.surrogate->smooths()) return std::nullopt;
  std::optional<SmoothedGradient> smoothed;
  smoothed.emplace(request.contact, request.scene, request.precision, *options.surrogate, options.threads);
  smoothed->set_memory_limit(options.limits.memory);
  smoothed->set_stop(options.monitor.stop);
  return smoothed;
}

// At rest the gradient has fallen to this part of the largest one met; less in single precision would be rounding.
constexpr double kRestReduction = 1e-3;

// Whether every component of the gradient above `most` points out of the bounds.
bool IsBlocked(const DescentRule& rule, const std::vector<double>& z, const std::vector<double>& gradient,
               double most) {
  constexpr double kStep = 1e-6;  // of the largest variable, or of 1
  const double step = kStep * std::max(1.0, Largest(z)), rate = step / Largest(gradient);
  std::vector<double> moved = z;
  for (size_t i = 0; i < z.size(); ++i) moved[i] -= std::abs(gradient[i]) > most ? rate * gradient[i] : 0;
  rule.move_within(&moved);
  for (size_t i = 0; i < z.size(); ++i) moved[i] -= z[i];
  return Largest(moved) <= 1e-3 * step;
}

SolveReport Descend(ShootingRun* run, const DescentRule& rule, Best* best) {
  ShootingFunction& function = run->function();
  const int iterations = run->options().limits.iterations;
  std::vector<double> z = run->initial_guess();
  rule.move_within(&z);
  std::vector<double> last = z, gradient(z.size()), standard_error(z.size());
  double largest = 0;
  for (int k = 0;; ++k) {
    const bool more = k < iterations;
    double loss = 0;
    if (!function.Evaluate(z, &loss, more && !rule.estimate ? gradient.data() : nullptr)) {
      return Fail(run, "loss", k, last);
    }
    best->ConsiderIterate(loss, k, last);
    if (!run->Record(loss, z)) return run->Finish(z, Termination::kInterrupted);
    if (!more) break;
    if (rule.estimate) {
      if (!rule.estimate(z, k, &gradient, &standard_error)) return Fail(run, "loss of a sample", k, z);
      run->RecordEstimate(standard_error);
    }
    if (!AllFinite(gradient)) return Fail(run, "gradient", k, z);
    largest = std::max(largest, Largest(gradient));
    last = z;
    rule.step(gradient, &z);
  }
  if (iterations == 0 || z != last) return run->Finish(z, Termination::kIterationLimit);
  if (IsBlocked(rule, z, gradient, std::max(kGradientTolerance, kRestReduction * largest))) {
    return run->Finish(z, Termination::kConverged);
  }
  return run->Finish(z, Termination::kNoProgress, "steps at this learning rate are below rounding");
}

class Loss final : public ceres::FirstOrderFunction {
 public:
  explicit Loss(ShootingFunction* shooting) : shooting_(shooting) {}

  bool Evaluate(const double* z, double* loss, double* gradient) const override {
    if (!shooting_->Evaluate({z, static_cast<size_t>(NumParameters())}, loss, gradient)) return false;
    return gradient == nullptr || AllFinite({gradient, static_cast<size_t>(NumParameters())});
  }
  int NumParameters() const override { return shooting_->num_variables(); }

 private:
  ShootingFunction* shooting_;
};

constexpr double kWeightOfCosts = 1;  // of constraints beside the costs ahead, in the first solve
constexpr int kBlockSize = 8;         // variables, at most or one row of a control
constexpr int kMostInOneBlock = 16;   // up to here a dense factorization is cheaper than conjugate gradients

// The variables, cut into blocks, none within a row of the control, of `width` numbers; the last `num_own` have blocks
// of their own.
std::vector<int> BlockSizes(int num_variables, int num_own, int width) {
  num_variables -= num_own;
  const int most = width * std::max(1, kBlockSize / width);
  std::vector<int> sizes;
  if (num_variables > kMostInOneBlock) {
    sizes.assign(num_variables / most, most);
    if (num_variables % most != 0) sizes.push_back(num_variables % most);
  } else if (num_variables > 0) {
    sizes = {num_variables};
  }
  sizes.insert(sizes.end(), num_own, 1);
  return sizes;
}

// The residual sqrt(effort T / steps) u, with the final time T a variable too. Blocks: u, T.
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
  // Costs are divided by a loss.
  ShootingCost(ShootingFunction* shooting, const std::vector<int>& block_sizes, const RowRoles& roles = {},
               double loss = 1)
      : shooting_(shooting),
        scale_(Eigen::VectorXd::Ones(shooting->num_residuals())),
        z_(shooting->num_variables()),
        residuals_(shooting->num_residuals()),
        jacobian_(residuals_.size() * z_.size()) {
    const int first_cost = roles.equalities + roles.inequalities;
    scale_.segment(first_cost, roles.values).setConstant(1 / loss);
    scale_.tail(scale_.size() - first_cost - roles.values).setConstant(1 / std::sqrt(loss));
    set_num_residuals(static_cast<int>(residuals_.size()));
    *mutable_parameter_block_sizes() = block_sizes;
  }

  bool Evaluate(double const* const* parameters, double* residuals, double** jacobians) const override {
    Rollout(parameters);
    if (!finite_) return false;
    for (int row = 0; row < num_residuals(); ++row) residuals[row] = scale_[row] * residuals_[row];
    return (jacobians == nullptr || EvaluateJacobians(jacobians)) && !shooting_->stopped();
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

  // Returns false if the Jacobians are not finite.
  bool EvaluateJacobians(double** jacobians) const {
    shooting_->ResidualJacobian(jacobian_.data());
    ++num_jacobians_;
    if (!AllFinite(jacobian_)) {
      // Finds the reason.
      shooting_->EvaluateResiduals(z_, residuals_.data(), jacobian_.data());
      return false;
    }
    int first = 0;
    for (size_t i = 0; i < parameter_block_sizes().size(); ++i) {
      const int size = parameter_block_sizes()[i];
      for (int row = 0; jacobians[i] != nullptr && row < num_residuals(); ++row) {
        const double* entry = &jacobian_[row * z_.size() + first];
        for (int k = 0; k < size; ++k) jacobians[i][row * size + k] = scale_[row] * entry[k];
      }
      first += size;
    }
    return true;
  }

  ShootingFunction* shooting_;
  Eigen::VectorXd scale_;
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
    const size_t num_forces = blocks.size() - 1 - shooting.num_design();
    double* const time = blocks[num_forces];
    if (free.weight > 0) {
      using Price = ceres::AutoDiffCostFunction<DurationCost, DurationCost::kRows, 1>;
      problem->AddResidualBlock(new Price(new DurationCost{free.weight}), nullptr, time);
    }
    problem->SetParameterLowerBound(time, 0, free.min);
    problem->SetParameterUpperBound(time, 0, free.max);
    for (size_t i = 0; i < num_forces && scene.objective.effort > 0; ++i) {
      const double weight = scene.objective.effort / shooting.simulator().num_steps();
      problem->AddResidualBlock(new ScaledEffortCost(weight, sizes[i]), nullptr, blocks[i], time);
    }
    return;
  }
  if (scene.optimize != Optimize::kControl || scene.objective.effort == 0) return;
  const double scale = std::sqrt(scene.objective.effort * shooting.simulator().step());
  for (size_t i = 0; i < blocks.size() - shooting.num_design(); ++i) {
    problem->AddResidualBlock(new EffortCost(scale, sizes[i]), nullptr, blocks[i]);
  }
}

// The largest magnitude of an entry of the rows of a control; infinity without a bound.
double LargestComponent(const Scene& scene, int entry) {
  const int turn = entry - 2 * scene.num_controlled();
  if (turn >= 0) return MaxTorqueForce(scene, turn);
  return scene.control.max.empty() ? std::numeric_limits<double>::infinity() : scene.control.max[entry / 2];
}

// Sets bounds on design parameters, on each component of each force, and on torques; the variables are within them.
void SetBounds(const SingleShooting& shooting, const VariableBlocks& variables, ceres::Problem* problem) {
  const Scene& scene = shooting.scene();
  const size_t design = variables.blocks.size() - shooting.num_design();
  for (size_t i = 0; design + i < variables.blocks.size(); ++i) {
    const ParameterRange range = RangeOf(scene.design[i]);
    if (std::isfinite(range.min)) problem->SetParameterLowerBound(variables.blocks[design + i], 0, range.min);
    if (std::isfinite(range.max)) problem->SetParameterUpperBound(variables.blocks[design + i], 0, range.max);
  }
  if (scene.optimize != Optimize::kControl || !scene.control.IsBounded()) return;
  const int forces = shooting.num_variables() - shooting.has_duration() - shooting.num_design();
  int at = 0;
  for (size_t block = 0; block < variables.sizes.size(); ++block) {
    for (int i = 0; i < variables.sizes[block] && at + i < forces; ++i) {
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
  SetCommonOptions(options.limits.iterations, &ceres_options);
  return ceres_options;
}

}  // namespace

SolveReport DescendGradient(ShootingRun* run, const DescentRule& rule) {
  Best best;
  SolveReport report = Descend(run, rule, &best);
  return best.AddTo(std::move(report), run->function());
}

SolveReport SolveByGradientDescent(const SolveRequest& request, const SolverOptions& options) {
  SolveRun run("gd", request, options);
  std::optional<SmoothedGradient> smoothed = MakeSmoothedGradient(request, options);
  const Step step(run.shooting(), options);
  DescentRule rule;
  rule.step = step;
  rule.move_within = [&](std::vector<double>* z) { step.MoveWithin(z); };
  if (smoothed) {
    rule.estimate =
        [&](const std::vector<double>& z, int k, std::vector<double>* gradient, std::vector<double>* standard_error) {
          return smoothed->Evaluate(z, k, *gradient, *standard_error);
        };
  }
  return DescendGradient(&run, rule);
}

SolveReport MinimizeByLbfgs(ShootingRun* run) {
  std::vector<double> z = run->initial_guess();
  double guess_loss = 0;
  if (!run->function().Evaluate(z, &guess_loss, nullptr)) {
    return run->Finish(z, Termination::kFailed, "loss not finite at iteration 0");
  }
  RecordIteration record(
      run, [](double cost) { return cost; }, &z);
  ceres::GradientProblemSolver::Options ceres_options;
  ceres_options.line_search_direction_type = ceres::LBFGS;
  ceres_options.line_search_type = ceres::WOLFE;
  SetCommonOptions(run->options().limits.iterations, &ceres_options);
  ceres_options.callbacks = {&record};

  const ceres::GradientProblem problem(new Loss(&run->function()));
  ceres::GradientProblemSolver::Summary summary;
  ceres::Solve(ceres_options, problem, z.data(), &summary);
  return Conclude(run, &record, z, {summary.termination_type, summary.iterations, true});
}

SolveReport SolveByCeresLbfgs(const SolveRequest& request, const SolverOptions& options) {
  SolveRun run("ceres_lbfgs", request, options);
  return MinimizeByLbfgs(&run);
}

SolveReport MinimizeLeastSquares(
    ShootingRun* run, std::vector<double> z, int num_own, double offset,
    const std::function<void(const VariableBlocks& variables, ceres::Problem* problem)>& add_terms, int width) {
  double guess_loss = 0;
  if (!run->function().Evaluate(z, &guess_loss, nullptr)) {
    return run->Finish(z, Termination::kFailed, "loss not finite at iteration 0");
  }
  ceres::Problem problem;
  VariableBlocks variables{BlockSizes(run->function().num_variables(), num_own, std::max(1, width)), {}};
  double* next = z.data();
  for (const int size : variables.sizes) {
    variables.blocks.push_back(next);
    next += size;
  }
  auto* shot = new ShootingCost(&run->function(), variables.sizes);  // owned by the problem
  problem.AddResidualBlock(shot, nullptr, variables.blocks);
  add_terms(variables, &problem);

  const auto loss = [offset](double cost) { return 2 * cost + offset; };  // Ceres minimizes half the sum of squares
  RecordIteration record(run, loss, &z);
  ceres::Solver::Options ceres_options = LeastSquaresOptions(run->options(), problem.NumParameterBlocks());
  ceres_options.callbacks = {&record};
  ceres::Solver::Summary summary;
  ceres::Solve(ceres_options, &problem, &summary);
  if (!summary.IsSolutionUsable() && record.iterate()) z = *record.iterate();
  SolveReport report = Conclude(run, &record, z, {summary.termination_type, summary.iterations, false});
  report.work.evaluations = shot->num_jacobians();
  return report;
}

SolveReport MinimizeWithConstraints(
    ShootingRun* run, std::vector<double> z, const RowRoles& roles, AugmentedLagrangian::Algorithm algorithm,
    const std::function<void(const VariableBlocks& variables, ceres::Problem* problem)>& set_bounds) {
  double guess_loss = 0;
  if (!run->function().Evaluate(z, &guess_loss, nullptr)) {
    return run->Finish(z, Termination::kFailed, "loss not finite at iteration 0");
  }
  if (!run->Record(guess_loss, z)) return run->Finish(z, Termination::kInterrupted);
  const double scale = guess_loss != 0 ? std::abs(guess_loss) : 1;
  AugmentedLagrangian problem;
  const std::vector<int> sizes = {static_cast<int>(z.size())};
  auto shot = std::make_unique<ShootingCost>(&run->function(), sizes, roles, scale);
  problem.Add(std::move(shot), roles, {z.data()});
  set_bounds({sizes, {z.data()}}, &problem.problem());

  double loss = guess_loss;
  AugmentedLagrangian::Options rounds;
  rounds.algorithm = algorithm;
  rounds.is_shooting = true;
  rounds.iterations = run->options().limits.iterations;
  rounds.weight_of_costs = kWeightOfCosts;
  rounds.callback = [&](double cost) {
    loss = scale * cost;
    return run->Record(loss, z);
  };
  const AugmentedLagrangian::Summary summary = problem.Minimize(rounds);
  const Termination termination = TerminationOf(summary, rounds.iterations);
  const bool is_open = termination != Termination::kInterrupted && summary.violation > rounds.tolerance;
  SolveReport report =
      run->Finish(z,
                  termination,
                  is_open ? "constraints are not met: the largest violation is " + ToText(summary.violation, 3) : "",
                  scale * summary.cost);
  report.work.evaluations = summary.jacobians;
  return report;
}

SolveReport SolveByCeresLm(const SolveRequest& request, const SolverOptions& options) {
  SolveRun run("ceres_lm", request, options);
  const SingleShooting& shooting = run.shooting();
  const Scene& scene = shooting.scene();
  std::vector<double> z = run.initial_guess();
  const int num_own = shooting.has_duration() + shooting.num_design();
  double given_effort = 0;  // of a control that is not optimized: a constant that Ceres does not see
  if (scene.optimize == Optimize::kControl) {
    MoveWithinBounds(scene, std::span(z).first(z.size() - num_own));
  } else {
    given_effort = EffortLoss(scene.objective, shooting.ControlAt(z), shooting.simulator().step());
  }
  return MinimizeLeastSquares(
      &run, std::move(z), num_own, given_effort, [&](const VariableBlocks& variables, ceres::Problem* problem) {
        AddEffort(shooting, variables, problem);
        SetBounds(shooting, variables, problem);
      });
}

}  // namespace saltus
