#include "ceres_shooting.h"

#include <ceres/evaluation_callback.h>

#include <Eigen/Core>
#include <algorithm>
#include <cmath>

#include "ceres_common.h"
#include "step_solver.h"

namespace saltus {
namespace {

constexpr double kDefectWeight = 1e4;  // w

using RowMajor = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;

// A step's defect to first order: a Jacobian a parameter block of StepCost, and its costate.
struct StepOnPath {
  std::vector<RowMajor> jacobians;
  Eigen::VectorXd costate;
};

// The rollout of Ceres' current forces, made before Ceres evaluates any cost there, and its linearization.
class Path final : public ceres::EvaluationCallback {
 public:
  // The last rollout of `shooting` is that of the variables.
  Path(SingleShooting* shooting, StepShooting* variables)
      : shooting_(shooting),
        variables_(variables),
        step_cost_(MakeStepCost(shooting->simulator())),
        terminal_cost_(MakeTerminalCost(shooting->simulator())),
        steps_(variables->num_steps()) {}

  // Linearization and costates are those of the last point at which Jacobians were asked for, and stand while Ceres
  // compares its cost with those of candidates for the next.
  void PrepareForEvaluation(bool jacobians, bool) override {
    std::vector<double> z = variables_->Decisions();
    if (z != z_) {
      z_ = std::move(z);
      finite_ = shooting_->Evaluate(z_, &loss_, nullptr);
      if (finite_) states_ = StatesOf(shooting_->simulator());
    }
    if (jacobians && finite_) finite_ = Linearize();
  }

  bool finite() const { return finite_; }
  double loss() const { return loss_; }
  const StepOnPath& step(int k) const { return steps_[k]; }
  // sum |y_k / w|^2.
  double costate_cost() const { return costate_cost_; }
  const double* State(int k) const { return &states_[static_cast<size_t>(k) * variables_->state_size()]; }
  const StepCost& step_cost() const { return *step_cost_; }
  const TerminalCost* terminal_cost() const { return terminal_cost_.get(); }

 private:
  bool Linearize() {
    Eigen::VectorXd costate = LastCostate();
    costate_cost_ = 0;
    for (int k = variables_->num_steps() - 1; k >= 0; --k) {
      if (!LinearizeStep(k)) return false;
      steps_[k].costate = costate;
      costate_cost_ += costate.squaredNorm() / (kDefectWeight * kDefectWeight);
      costate = -steps_[k].jacobians.front().transpose() * costate;
    }
    return true;
  }

  bool LinearizeStep(int k) {
    std::vector<const double*> at;
    for (double* block : variables_->StepBlocks(k)) at.push_back(block);
    at.front() = State(k);
    at.back() = State(k + 1);
    std::vector<RowMajor>& jacobians = steps_[k].jacobians;
    std::vector<double*> pointers;
    jacobians.resize(at.size());
    for (size_t i = 0; i < at.size(); ++i) {
      jacobians[i].resize(step_cost_->num_residuals(), step_cost_->parameter_block_sizes()[i]);
      pointers.push_back(jacobians[i].data());
    }
    std::vector<double> defect(step_cost_->num_residuals());
    return step_cost_->Evaluate(at.data(), defect.data(), pointers.data());
  }

  Eigen::VectorXd LastCostate() const {
    if (terminal_cost_ == nullptr) return Eigen::VectorXd::Zero(variables_->state_size());
    Eigen::VectorXd residuals(terminal_cost_->num_residuals());
    RowMajor slope(residuals.size(), variables_->state_size());
    const double* end = State(variables_->num_steps());
    double* jacobian = slope.data();
    terminal_cost_->Evaluate(&end, residuals.data(), &jacobian);
    return -slope.transpose() * residuals;
  }

  SingleShooting* shooting_;
  StepShooting* variables_;
  std::unique_ptr<StepCost> step_cost_;
  std::unique_ptr<TerminalCost> terminal_cost_;
  std::vector<double> z_, states_;
  std::vector<StepOnPath> steps_;
  double loss_ = 0, costate_cost_ = 0;
  bool finite_ = true;
};

// w c_k + y_k / w.
class DefectOnPath final : public ceres::CostFunction {
 public:
  DefectOnPath(const Path* path, int k) : path_(path), k_(k) {
    set_num_residuals(path->step_cost().num_residuals());
    *mutable_parameter_block_sizes() = path->step_cost().parameter_block_sizes();
  }

  bool Evaluate(double const* const*, double* residuals, double** jacobians) const override {
    if (!path_->finite()) return false;
    const StepOnPath& step = path_->step(k_);
    Eigen::Map<Eigen::VectorXd>(residuals, num_residuals()) = step.costate / kDefectWeight;
    for (size_t i = 0; jacobians != nullptr && i < step.jacobians.size(); ++i) {
      if (jacobians[i] == nullptr) continue;
      Eigen::Map<RowMajor>(jacobians[i], num_residuals(), step.jacobians[i].cols()) = kDefectWeight * step.jacobians[i];
    }
    return true;
  }

 private:
  const Path* path_;
  int k_;
};

// The terminal residuals where the path ends.
class EndOfPath final : public ceres::CostFunction {
 public:
  EndOfPath(const Path* path, int num_steps) : path_(path), num_steps_(num_steps) {
    set_num_residuals(path->terminal_cost()->num_residuals());
    *mutable_parameter_block_sizes() = path->terminal_cost()->parameter_block_sizes();
  }

  bool Evaluate(double const* const*, double* residuals, double** jacobians) const override {
    if (!path_->finite()) return false;
    const double* end = path_->State(num_steps_);
    return path_->terminal_cost()->Evaluate(&end, residuals, jacobians);
  }

 private:
  const Path* path_;
  int num_steps_;
};

// A constant less what costates contribute to the cost. They change whenever a step has been accepted; without this, so
// would the cost, and Ceres would hold the change against the next step.
class CostateBalance final : public ceres::CostFunction {
 public:
  CostateBalance(const Path* path, int state_size) : path_(path) {
    set_num_residuals(1);
    mutable_parameter_block_sizes()->push_back(state_size);
  }

  bool Evaluate(double const* const*, double* residual, double** jacobians) const override {
    constexpr double kMargin = 10;  // by which costates may grow
    if (sum_ == 0) sum_ = kMargin * path_->costate_cost();
    *residual = std::sqrt(std::max(0.0, sum_ - path_->costate_cost()));
    if (jacobians != nullptr && jacobians[0] != nullptr) std::fill_n(jacobians[0], parameter_block_sizes()[0], 0.0);
    return true;
  }

 private:
  const Path* path_;
  mutable double sum_ = 0;  // set by the first evaluation, at the initial guess
};

void AddCosts(const Path* path, StepShooting* variables, ceres::Problem* problem) {
  const int num_steps = variables->num_steps();
  for (int k = 0; k < num_steps; ++k) {
    problem->AddResidualBlock(new DefectOnPath(path, k), nullptr, variables->StepBlocks(k));
  }
  if (path->terminal_cost() != nullptr) {
    problem->AddResidualBlock(new EndOfPath(path, num_steps), nullptr, variables->State(num_steps));
  }
  problem->AddResidualBlock(new CostateBalance(path, variables->state_size()), nullptr, variables->State(num_steps));
  variables->AddEffort(problem);
  variables->HoldConstants(problem);
}

// Damping is the same for every variable, as if of the integral of |dx|^2 + |du|^2 over time: by their own diagonals
// (Ceres' default) states would be held by the weights of their defects.
double Damping(const Simulator& simulator) {
  const Scene& scene = simulator.scene();
  const bool effort = scene.optimize == Optimize::kControl && scene.objective.effort > 0;
  return simulator.step() * (effort ? scene.objective.effort : 1);
}

}  // namespace

SolveReport SolveByCeresShooting(const SolveRequest& request, const SolverOptions& options) {
  SolveRun run("ceres_shooting", request, options);
  SingleShooting& shooting = run.shooting();
  std::vector<double> z = shooting.initial_guess();
  double guess_loss = 0;
  if (!shooting.Evaluate(z, &guess_loss, nullptr)) {
    return run.Finish(z, Termination::kFailed, "loss not finite at iteration 0");
  }
  StepShooting variables(&shooting);
  Path path(&shooting, &variables);
  ceres::Problem::Options problem_options;
  problem_options.evaluation_callback = &path;
  ceres::Problem problem(problem_options);
  AddCosts(&path, &variables, &problem);

  ReadDecisions read(&variables, &z);
  RecordIteration record(
      &run, [&path](double) { return path.loss(); }, &z);
  ceres::Solver::Options ceres_options = SparseOptions(options.iterations);
  ceres_options.jacobi_scaling = false;
  ceres_options.min_lm_diagonal = ceres_options.max_lm_diagonal = Damping(shooting.simulator());
  ceres_options.callbacks = {&read, &record};
  ceres::Solver::Summary summary;
  ceres::Solve(ceres_options, &problem, &summary);

  z = variables.Decisions();
  SolveReport report =
      Conclude(&run, &record, z, {summary.termination_type, summary.message, summary.iterations, false});
  report.evaluations = summary.num_jacobian_evaluations;
  if (shooting.Evaluate(z, &guess_loss, nullptr)) {
    const Simulator& simulator = shooting.simulator();
    report.defects = {LargestDefects(simulator, StatesOf(simulator), report.control)};
  }
  return report;
}

}  // namespace saltus
