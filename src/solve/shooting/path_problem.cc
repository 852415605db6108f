#include "solve/shooting/path_problem.h"

#include <ceres/evaluation_callback.h>
#include <ceres/problem.h>

#include <algorithm>
#include <array>
#include <cmath>

#include "control/step_shooting.h"
#include "solve/solve_run.h"

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
  // Returns the sum of |y_k / w|^2.
  double costate_cost() const { return costate_cost_; }
  const double* State(int k) const { return &states_[static_cast<size_t>(k) * variables_->state_size()]; }
  const StepCost& step_cost() const { return *step_cost_; }
  const TerminalCost* terminal_cost() const { return terminal_cost_.get(); }
  const Simulator& simulator() const { return shooting_->simulator(); }

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

// The residual w c_k + y_k / w of a defect.
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

// The gap of two discs, or of a disc and a plane, after two steps of free flight, to first order.
struct Gap {
  double value = 0;
  Eigen::VectorXd by_state;     // two nodes before
  Eigen::VectorXd by_force[2];  // in either step
};

// A position after two steps of length h is p + 2 h v + h^2 (3/2 a_0 + 1/2 a_1).
Gap GapAfterFlight(const Simulator& simulator, const Candidate& candidate, const double* x,
                   const std::array<const double*, 2>& force) {
  const Scene& scene = simulator.scene();
  const double h = simulator.step(), by_acceleration[2] = {1.5 * h * h, 0.5 * h * h};
  const std::vector<int>& controlled = scene.control.bodies;
  const auto forces_at = [&](int body) { return std::find(controlled.begin(), controlled.end(), body); };
  const auto position = [&](int body) -> Vec2d {
    const double* s = x + body * simulator.body_size();
    Vec2d p(s[0], s[1]);
    if (scene.bodies[body].fixed) return p;
    p += 2 * h * Vec2d(s[2], s[3]) + 2 * h * h * scene.gravity;
    const auto at = forces_at(body);
    for (int i = 0; i < 2 && at != controlled.end(); ++i) {
      const double* u = force[i] + 2 * (at - controlled.begin());
      p += by_acceleration[i] / scene.bodies[body].mass * Vec2d(u[0], u[1]);
    }
    return p;
  };

  Gap gap;
  gap.by_state = Eigen::VectorXd::Zero(simulator.state_size());
  for (Eigen::VectorXd& slope : gap.by_force) slope = Eigen::VectorXd::Zero(simulator.control_width());
  const auto add = [&](int body, const Vec2d& normal) {
    if (scene.bodies[body].fixed) return;
    gap.by_state.segment<2>(body * simulator.body_size()) += normal;
    gap.by_state.segment<2>(body * simulator.body_size() + 2) += 2 * h * normal;
    const auto at = forces_at(body);
    for (int i = 0; i < 2 && at != controlled.end(); ++i) {
      gap.by_force[i].segment<2>(2 * (at - controlled.begin())) +=
          by_acceleration[i] / scene.bodies[body].mass * normal;
    }
  };
  const int a = candidate.a, b = candidate.b;
  gap.value = -scene.bodies[a].radius;
  if (candidate.plane) {
    const Plane& plane = scene.planes[b];
    const Vec2d normal = plane.normal.normalized();
    gap.value += Dot(normal, Vec2d(position(a) - plane.point));
    add(a, normal);
  } else {
    const Separation<double> separation = Separate<double>(position(a), position(b));
    gap.value += separation.distance - scene.bodies[b].radius;
    add(a, separation.normal);
    add(b, -separation.normal);
  }
  return gap;
}

// The residual w times that gap, on the path. Parameter blocks: the state two nodes before, the forces of either step.
class ArrivalOnPath final : public ceres::CostFunction {
 public:
  ArrivalOnPath(const Path* path, const Arrival& arrival) : path_(path), arrival_(arrival) {
    set_num_residuals(1);
    const int forces = path->simulator().control_width();
    *mutable_parameter_block_sizes() = {path->simulator().state_size(), forces, forces};
  }

  bool Evaluate(double const* const* parameters, double* residual, double** jacobians) const override {
    if (!path_->finite()) return false;
    const Gap gap = GapAfterFlight(
        path_->simulator(), arrival_.candidate, path_->State(arrival_.node - 2), {parameters[1], parameters[2]});
    *residual = kDefectWeight * gap.value;
    const Eigen::VectorXd* slopes[] = {&gap.by_state, &gap.by_force[0], &gap.by_force[1]};
    for (int i = 0; jacobians != nullptr && i < 3; ++i) {
      if (jacobians[i] != nullptr) {
        Eigen::Map<Eigen::VectorXd>(jacobians[i], slopes[i]->size()) = kDefectWeight * *slopes[i];
      }
    }
    return true;
  }

 private:
  const Path* path_;
  Arrival arrival_;
};

// Returns the damping, which is the same for every variable, as if of the integral of |dx|^2 + |du|^2 over time: with
// the diagonals (Ceres' default) states would be held by the weights of their defects.
double Damping(const Simulator& simulator) {
  const Scene& scene = simulator.scene();
  const bool effort = scene.optimize == Optimize::kControl && scene.objective.effort > 0;
  return simulator.step() * (effort ? scene.objective.effort : 1);
}

}  // namespace

struct PathProblem::Parts {
  Parts(SingleShooting* single, const std::vector<double>& z, std::vector<Arrival> held)
      : variables(single, z), path(single, &variables), problem(Options()), arrivals(std::move(held)) {
    const int num_steps = variables.num_steps();
    for (int k = 0; k < num_steps; ++k) {
      problem.AddResidualBlock(new DefectOnPath(&path, k), nullptr, variables.StepBlocks(k));
    }
    double* end = variables.State(num_steps);
    if (path.terminal_cost() != nullptr) problem.AddResidualBlock(new EndOfPath(&path, num_steps), nullptr, end);
    problem.AddResidualBlock(new CostateBalance(&path, variables.state_size()), nullptr, end);
    for (const Arrival& arrival : arrivals) {
      const int k = arrival.node - 2;
      problem.AddResidualBlock(new ArrivalOnPath(&path, arrival),
                               nullptr,
                               variables.State(k),
                               variables.StepBlocks(k)[1],
                               variables.StepBlocks(k + 1)[1]);
    }
    variables.AddEffort([&](std::unique_ptr<ceres::CostFunction> cost, double* forces) {
      problem.AddResidualBlock(cost.release(), nullptr, forces);
    });
    variables.HoldConstants(&problem);
  }

  ceres::Problem::Options Options() {
    ceres::Problem::Options options;
    options.evaluation_callback = &path;
    return options;
  }

  StepShooting variables;
  Path path;
  ceres::Problem problem;
  std::vector<Arrival> arrivals;
};

PathProblem::PathProblem(SingleShooting* shooting, const std::vector<double>& z, std::vector<Arrival> arrivals)
    : z_(z), parts_(std::make_unique<Parts>(shooting, z, std::move(arrivals))) {}

PathProblem::~PathProblem() = default;

ceres::Solver::Summary PathProblem::Minimize(int iterations, double function_tolerance,
                                             const std::vector<ceres::IterationCallback*>& callbacks) {
  // Where an iteration has left the variables, before others look at them.
  AfterIteration read([this](const ceres::IterationSummary&) {
    z_ = parts_->variables.Decisions();
    return true;
  });
  ceres::Solver::Options options;
  options.linear_solver_type = ceres::SPARSE_NORMAL_CHOLESKY;
  options.sparse_linear_algebra_library_type = ceres::EIGEN_SPARSE;  // the same bits every time
  SetCommonOptions(iterations, &options);
  options.function_tolerance = function_tolerance;
  options.jacobi_scaling = false;
  options.min_lm_diagonal = options.max_lm_diagonal = Damping(parts_->path.simulator());
  options.callbacks = {&read};
  options.callbacks.insert(options.callbacks.end(), callbacks.begin(), callbacks.end());
  ceres::Solver::Summary summary;
  ceres::Solve(options, &parts_->problem, &summary);
  // After a failure the variables may be those of a candidate; the last callback has seen the iterate.
  if (summary.IsSolutionUsable()) z_ = parts_->variables.Decisions();
  return summary;
}

double PathProblem::loss() const { return parts_->path.loss(); }

std::optional<PathProblem::LinearGaps> PathProblem::LinearizeGaps() const {
  const Path& path = parts_->path;
  if (!path.finite()) return std::nullopt;
  const int forces = path.simulator().control_width();
  const int num_gaps = static_cast<int>(parts_->arrivals.size());
  LinearGaps gaps{Eigen::VectorXd(num_gaps), Eigen::MatrixXd::Zero(num_gaps, z_.size())};
  for (int i = 0; i < num_gaps; ++i) {
    const int first = parts_->arrivals[i].node - 2;
    const double* u = &z_[static_cast<size_t>(first) * forces];
    const Gap gap = GapAfterFlight(path.simulator(), parts_->arrivals[i].candidate, path.State(first), {u, u + forces});
    gaps.values[i] = gap.value;
    for (int j = 0; j < 2; ++j) gaps.jacobian.row(i).segment((first + j) * forces, forces) = gap.by_force[j];
    Eigen::VectorXd costate = gap.by_state;
    for (int k = first - 1; k >= 0; --k) {
      const std::vector<RowMajor>& step = path.step(k).jacobians;
      gaps.jacobian.row(i).segment(k * forces, forces) = -step[1].transpose() * costate;
      costate = -step[0].transpose() * costate;
    }
  }
  return gaps;
}

}  // namespace saltus
