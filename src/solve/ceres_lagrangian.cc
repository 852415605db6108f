#include "ceres_lagrangian.h"

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <sstream>

#include "ceres_common.h"
#include "step_solver.h"

namespace saltus {
namespace {

constexpr double kClosed = 1e-9;           // a defect below is closed
constexpr double kLastWeight = 1e8;        // mu grows no further
constexpr double kGrowth = 10;             // of mu
constexpr double kShrinkage = 0.25;        // of the largest defect; where less is reached, mu grows
constexpr int kMaxRounds = 30;             // updates of the multipliers
constexpr int kRoundIterations = 30;       // of Ceres between them, at most
constexpr double kRoundTolerance = 1e-13;  // relative change of the cost that ends a round

// sqrt(mu) (c + y / mu).
class DefectCost final : public ceres::CostFunction {
 public:
  DefectCost(const StepCost* step, const double* mu) : step_(step), mu_(mu), multiplier_(step->num_residuals()) {
    multiplier_.setZero();
    set_num_residuals(step->num_residuals());
    *mutable_parameter_block_sizes() = step->parameter_block_sizes();
  }

  bool Evaluate(double const* const* parameters, double* residuals, double** jacobians) const override {
    if (!step_->Evaluate(parameters, residuals, jacobians)) return false;
    const double root = std::sqrt(*mu_);
    Eigen::Map<Eigen::VectorXd> r(residuals, num_residuals());
    r = root * (r + multiplier_ / *mu_);
    for (size_t i = 0; jacobians != nullptr && i < parameter_block_sizes().size(); ++i) {
      if (jacobians[i] == nullptr) continue;
      Eigen::Map<Eigen::VectorXd>(jacobians[i], num_residuals() * parameter_block_sizes()[i]) *= root;
    }
    return true;
  }

  // y <- y + mu c, at the given variables.
  void UpdateMultiplier(const std::vector<double*>& blocks) {
    Eigen::VectorXd defect(num_residuals());
    if (step_->Evaluate(blocks.data(), defect.data(), nullptr)) multiplier_ += *mu_ * defect;
  }

 private:
  const StepCost* step_;
  const double* mu_;
  Eigen::VectorXd multiplier_;
};

// Records the loss of a rollout of the forces at each iterate, but for the first of a later round, which has been.
class RecordRollout final : public ceres::IterationCallback {
 public:
  RecordRollout(SolveRun* run, const std::vector<double>* z) : run_(run), z_(z), recorded_(*z) {}

  ceres::CallbackReturnType operator()(const ceres::IterationSummary& summary) override {
    if (summary.iteration == 0 && run_->num_recorded() > 0) return ceres::SOLVER_CONTINUE;
    double loss = 0;
    if (!run_->shooting().Evaluate(*z_, &loss, nullptr)) return ceres::SOLVER_ABORT;
    recorded_ = *z_;
    return run_->Record(loss, *z_) ? ceres::SOLVER_CONTINUE : ceres::SOLVER_TERMINATE_SUCCESSFULLY;
  }

  // The decision variables of the last loss.
  const std::vector<double>& recorded() const { return recorded_; }

 private:
  SolveRun* run_;
  const std::vector<double>* z_;
  std::vector<double> recorded_;
};

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

// One solve by the augmented Lagrangian.
class Rounds {
 public:
  Rounds(SolveRun* run, const std::vector<double>& guess)
      : run_(run),
        z_(guess),
        variables_(&run->shooting(), guess),
        step_cost_(MakeStepCost(run->shooting().simulator())),
        mu_(1 / run->shooting().simulator().step()),
        read_(&variables_, &z_),
        record_(run, &z_) {
    for (int k = 0; k < variables_.num_steps(); ++k) {
      auto* cost = new DefectCost(step_cost_.get(), &mu_);  // owned by the problem
      costs_.push_back(cost);
      problem_.AddResidualBlock(cost, nullptr, variables_.StepBlocks(k));
    }
    if (auto terminal = MakeTerminalCost(variables_.simulator())) {
      problem_.AddResidualBlock(terminal.release(), nullptr, variables_.State(variables_.num_steps()));
    }
    variables_.AddEffort(&problem_);
    variables_.HoldConstants(&problem_);
  }

  // Until all defects are closed, or nothing more is allowed.
  Termination Run(int iterations) {
    for (int round = 0; round < kMaxRounds; ++round) {
      const int left = iterations - std::max(0, run_->num_recorded() - 1);
      if (round > 0 && left <= 0) return Termination::kIterationLimit;
      const ceres::TerminationType type = Minimize(std::min(left, kRoundIterations));
      if (type == ceres::USER_SUCCESS) return Termination::kInterrupted;
      if (type == ceres::USER_FAILURE || type == ceres::FAILURE) return Termination::kFailed;
      const double before = largest_;
      MeasureDefects();
      if (largest_ <= kClosed && type == ceres::CONVERGENCE) return Termination::kConverged;
      for (int k = 0; k < variables_.num_steps(); ++k) costs_[k]->UpdateMultiplier(variables_.StepBlocks(k));
      if (largest_ > kShrinkage * before) mu_ = std::min(kGrowth * mu_, kLastWeight);
    }
    return Termination::kNoProgress;
  }

  // Where it has ended; if stopped, at the last iterate whose loss is known.
  const std::vector<double>& z() const { return run_->shooting().stopped() ? record_.recorded() : z_; }
  double largest_defect() const { return largest_; }
  int num_jacobians() const { return num_jacobians_; }
  std::vector<std::vector<double>> TakeDefects() { return std::move(defects_); }

 private:
  ceres::TerminationType Minimize(int iterations) {
    ceres::Solver::Options options = SparseOptions(iterations);
    options.function_tolerance = kRoundTolerance;
    options.callbacks = {&read_, &record_};
    ceres::Solver::Summary summary;
    ceres::Solve(options, &problem_, &summary);
    z_ = variables_.Decisions();
    num_jacobians_ += summary.num_jacobian_evaluations;
    return summary.termination_type;
  }

  void MeasureDefects() {
    const int last = variables_.num_steps();
    const std::span<const double> states(variables_.State(0), variables_.State(last) + variables_.state_size());
    defects_.push_back(LargestDefects(variables_.simulator(), states, run_->shooting().ControlAt(z_)));
    largest_ = *std::max_element(defects_.back().begin(), defects_.back().end());
  }

  SolveRun* run_;
  std::vector<double> z_;
  StepShooting variables_;
  std::unique_ptr<StepCost> step_cost_;
  double mu_;
  ceres::Problem problem_;
  std::vector<DefectCost*> costs_;
  ReadDecisions read_;
  RecordRollout record_;
  std::vector<std::vector<double>> defects_;
  double largest_ = 0;
  int num_jacobians_ = 0;
};

std::string DefectsOpen(double largest) {
  std::ostringstream text;
  text << "defects are open: the largest is " << largest;
  return text.str();
}

}  // namespace

SolveReport SolveByCeresLagrangian(const SolveRequest& request, const SolverOptions& options) {
  SolveRun run("ceres_lagrangian", request, options);
  const std::vector<double> guess = run.shooting().initial_guess();
  const Gradient first = GradientAt(&run.shooting(), guess);
  if (!first.ok) return run.Finish(guess, Termination::kFailed, "loss not finite at iteration 0");
  Rounds rounds(&run, guess);
  Termination termination = rounds.Run(options.iterations);

  const Gradient last = GradientAt(&run.shooting(), rounds.z());
  std::string reason;
  if (rounds.largest_defect() > kClosed) {
    reason = DefectsOpen(rounds.largest_defect());
  } else if (termination == Termination::kConverged &&
             !(last.norm <= std::max(kGradientTolerance, kGradientReduction * first.norm))) {
    termination = Termination::kNoProgress;
    reason = "defects are closed, but the gradient of the rollout has not vanished";
  }
  SolveReport report = run.Finish(rounds.z(), termination, reason);
  report.evaluations = rounds.num_jacobians();
  report.defects = rounds.TakeDefects();
  return report;
}

}  // namespace saltus
