#include "saltus/feedback/expected_loss.h"

#include <cmath>
#include <memory>
#include <optional>
#include <utility>
#include <vector>

#include "control/hybrid_shooting.h"
#include "feedback/noisy_states.h"
#include "saltus/control/single_shooting.h"
#include "saltus/simulate/registry.h"
#include "saltus/solve/hybrid_solver.h"
#include "solve/shooting/single_shooting_solvers.h"

namespace saltus {
namespace {

// The mean of functions of the same variables, each at the variables plus an offset.
class MeanLoss final : public ShootingFunction {
 public:
  struct Point {
    std::unique_ptr<ShootingFunction> function;
    Eigen::VectorXd offset;  // none: zero
  };
  // `nominal` says what variables stand for.
  MeanLoss(std::unique_ptr<ShootingFunction> nominal, std::vector<Point> points, StopRequest stop)
      : nominal_(std::move(nominal)), points_(std::move(points)), stop_(std::move(stop)) {}

  int num_variables() const override { return nominal_->num_variables(); }
  const std::vector<double>& initial_guess() const override { return nominal_->initial_guess(); }

  bool Evaluate(std::span<const double> z, double* loss, double* gradient) override {
    const auto n = static_cast<Eigen::Index>(z.size());
    const Eigen::Map<const Eigen::VectorXd> at(z.data(), n);
    Eigen::VectorXd sum = Eigen::VectorXd::Zero(n), one(n);
    *loss = 0;
    why_.clear();
    for (const Point& point : points_) {
      if (stopped()) return false;
      const Eigen::VectorXd there = point.offset.size() > 0 ? Eigen::VectorXd(at + point.offset) : at;
      double loss_there = 0;
      if (!point.function->Evaluate({there.data(), z.size()}, &loss_there, gradient ? one.data() : nullptr)) {
        why_ = "of one of the points of the expectation: " + point.function->FailureReason();
        return false;
      }
      *loss += loss_there / static_cast<double>(points_.size());
      if (gradient) sum += one / static_cast<double>(points_.size());
    }
    if (gradient) Eigen::Map<Eigen::VectorXd>(gradient, n) = sum;
    return true;
  }
  std::string FailureReason() const override { return why_; }
  bool stopped() const override { return stop_ && stop_(); }

  // A mean is given no residuals.
  int num_residuals() const override { return 0; }
  bool EvaluateResiduals(std::span<const double>, double*, double*) override { return false; }
  void ResidualJacobian(double*) override {}

  std::vector<double> InitialStateAt(std::span<const double> z) const override { return nominal_->InitialStateAt(z); }
  std::vector<double> ControlAt(std::span<const double> z) const override { return nominal_->ControlAt(z); }
  std::vector<double> DurationsAt(std::span<const double> z) const override { return nominal_->DurationsAt(z); }
  std::vector<double> ParametersAt(std::span<const double> z) const override { return nominal_->ParametersAt(z); }
  int num_adjoints() const override {
    int count = 0;
    for (const Point& point : points_) count += point.function->num_adjoints();
    return count;
  }

 private:
  std::unique_ptr<ShootingFunction> nominal_;
  std::vector<Point> points_;
  StopRequest stop_;
  std::string why_;
};

class ExpectedLossRun final : public ShootingRun {
 public:
  // `make` makes the function of the problem whose initial state is changed by so much.
  ExpectedLossRun(const Errors& errors, const SolverOptions& options, int initial_size,
                  const std::function<std::unique_ptr<ShootingFunction>(const Eigen::VectorXd& change)>& make)
      : ShootingRun("expected_loss", options) {
    const Eigen::VectorXd no_change = Eigen::VectorXd::Zero(initial_size);
    std::unique_ptr<ShootingFunction> nominal = make(no_change);
    guess_ = nominal->initial_guess();
    const Eigen::MatrixXd initial = RootOfCovariance(errors.initial), variables = RootOfCovariance(errors.variables);
    const double scale = std::sqrt(static_cast<double>(initial.cols() + variables.cols()));
    std::vector<MeanLoss::Point> points;
    for (const double side : {1.0, -1.0}) {
      for (const auto& column : initial.colwise()) points.push_back({make(side * scale * column), {}});
      for (const auto& column : variables.colwise()) points.push_back({make(no_change), side * scale * column});
    }
    function_ = std::make_unique<MeanLoss>(std::move(nominal), std::move(points), options.monitor.stop);
  }
  ShootingFunction& function() override { return *function_; }

 private:
  std::string RemarkOn(std::span<const double>, Termination) override { return ""; }

  std::unique_ptr<MeanLoss> function_;
};

SolveReport NotApplicable(std::string reason) {
  SolveReport report;
  report.solver = "expected_loss";
  report.termination = Termination::kNotApplicable;
  report.reason = std::move(reason);
  return report;
}

std::string Validate(const Errors& errors, Eigen::Index initial_size, Eigen::Index num_variables) {
  if (errors.initial.size() > 0) {
    const std::string wrong = ValidateSymmetric(errors.initial, initial_size, /*definite=*/false);
    if (!wrong.empty()) return "errors of the initial state: " + wrong;
  }
  if (errors.variables.size() > 0) {
    const std::string wrong = ValidateSymmetric(errors.variables, num_variables, /*definite=*/false);
    if (!wrong.empty()) return "errors of the variables: " + wrong;
  }
  if (RootOfCovariance(errors.initial).cols() + RootOfCovariance(errors.variables).cols() == 0) {
    return "found no error, expected a covariance that is not zero";
  }
  return "";
}

// The report of L-BFGS if it refuses the problem, for example because of bounds; it is asked for no iteration.
template <typename Problem>
std::optional<SolveReport> RefusalOfLbfgs(const Problem& problem, SolverOptions options) {
  options.limits.iterations = 0;
  options.monitor.callback = nullptr;
  SolveReport report = Solve("ceres_lbfgs", problem, options);
  const bool refused = report.termination == Termination::kNotApplicable || report.termination == Termination::kFailed;
  return refused ? std::optional(std::move(report)) : std::nullopt;
}

}  // namespace

SolveReport SolveExpectedLoss(const SolveRequest& request, const Errors& errors, const SolverOptions& options) {
  if (const auto refusal = RefusalOfLbfgs(request, options)) return *refusal;
  if (!request.terms.empty()) return NotApplicable("the expected loss does not take terms of users");
  const auto make = [&](const Eigen::VectorXd& change) -> std::unique_ptr<ShootingFunction> {
    Scene scene = request.scene;
    for (int i = 0; i < scene.num_bodies(); ++i) {
      Body& body = scene.bodies[i];
      body.position += change.segment<2>(4 * i);
      body.velocity += change.segment<2>(4 * i + 2);
      if (scene.Spins()) body.angular_velocity += change[4 * scene.num_bodies() + 2 * i + 1];
    }
    return std::make_unique<SingleShooting>(MakeSimulator(request.contact, scene, request.precision));
  };
  const int initial_size = InitialSize(request.scene);
  const int num_variables = make(Eigen::VectorXd::Zero(initial_size))->num_variables();
  if (std::string wrong = Validate(errors, initial_size, num_variables); !wrong.empty()) {
    return NotApplicable(wrong);
  }
  ExpectedLossRun run(errors, options, initial_size, make);
  return MinimizeByLbfgs(&run);
}

SolveReport SolveExpectedLoss(const HybridProblem& problem, const Errors& errors, const SolverOptions& options) {
  if (const auto refusal = RefusalOfLbfgs(problem, options)) return *refusal;
  const auto make = [&](const Eigen::VectorXd& change) -> std::unique_ptr<ShootingFunction> {
    HybridProblem changed = problem;
    for (std::size_t i = 0; i < changed.guess.initial.size(); ++i) changed.guess.initial[i] += change[i];
    return std::make_unique<HybridShooting>(changed);
  };
  const auto initial_size = static_cast<int>(problem.guess.initial.size());
  const int num_variables = HybridShooting(problem).num_variables();
  if (std::string wrong = Validate(errors, initial_size, num_variables); !wrong.empty()) {
    return NotApplicable(wrong);
  }
  if (errors.initial.size() > 0 && !problem.free.initial.empty()) {
    return NotApplicable("the initial state is free: its errors are errors of the variables");
  }
  ExpectedLossRun run(errors, options, initial_size, make);
  return MinimizeByLbfgs(&run);
}

}  // namespace saltus
