#include "phase_minimum.h"

#include <ceres/dynamic_autodiff_cost_function.h>
#include <ceres/problem.h>
#include <ceres/solver.h>

#include <algorithm>
#include <cmath>

namespace saltus {
namespace {

constexpr int kStride = 4;               // derivatives in one pass
constexpr double kFlatGradient = 1e-5;   // with a smaller one, a loss that does not change any more is minimal
constexpr double kLeastGradient = 1e-3;  // taken for the largest one if that is smaller: a start at the minimum

struct Constraints {
  double weight = 0;                // of the loss, 1/m^2
  std::vector<double> multipliers;  // by impact
  std::vector<bool> approaching;    // by impact: it must stay so, as it was at the start
};

// Square roots of the loss, then of weight/2 (gap + multiplier/weight)^2 for each gap.
class Residuals {
 public:
  Residuals(const EventPhases* phases, const Constraints* constraints) : phases_(phases), constraints_(constraints) {}

  int size() const {
    int gaps = 0;
    for (int k = 0; k < phases_->num_impacts(); ++k) gaps += !phases_->IsSteered(k);
    return phases_->num_loss_residuals() + gaps;
  }

  template <typename T>
  bool operator()(T const* const* z, T* residuals) const {
    Path<T> path;
    if (!phases_->Unroll(z[0], &path)) return false;
    for (int k = 0; k < phases_->num_impacts(); ++k) {
      if (constraints_->approaching[k] && !(path.impacts[k].impact.speed < 0.0)) return false;
    }
    phases_->LossResiduals(path, residuals);
    residuals += phases_->num_loss_residuals();
    for (int k = 0; k < phases_->num_impacts(); ++k) {
      if (phases_->IsSteered(k)) continue;
      *residuals++ = std::sqrt(constraints_->weight / 2) *
                     (path.impacts[k].gap + constraints_->multipliers[k] / constraints_->weight);
    }
    return true;
  }

 private:
  const EventPhases* phases_;
  const Constraints* constraints_;
};

double LargestGap(const EventPhases& phases, const Path<double>& path) {
  double gap = 0;
  for (int k = 0; k < phases.num_impacts(); ++k) gap = std::max(gap, std::abs(path.impacts[k].gap));
  return gap;
}

// Stops Ceres when told to, or when the gradient has become small compared with the largest one met.
class Watch final : public ceres::IterationCallback {
 public:
  Watch(const EventPhases& phases, const PhaseMinimumOptions& options, const std::vector<double>* z)
      : phases_(phases), options_(options), z_(z) {}

  ceres::CallbackReturnType operator()(const ceres::IterationSummary& summary) override {
    if (summary.iteration == 0 && started_) return ceres::SOLVER_CONTINUE;
    largest_ = std::max(largest_, summary.gradient_max_norm);
    gradient_ = summary.gradient_max_norm / std::max(largest_, kLeastGradient);
    small_ = gradient_ <= options_.gradient_tolerance;
    Path<double> path;
    if (started_ && phases_.Unroll(z_->data(), &path)) {
      ++iterations_;
      if (options_.callback && !options_.callback(phases_.Loss(path))) interrupted_ = true;
    }
    started_ = true;
    return interrupted_ || small_ ? ceres::SOLVER_TERMINATE_SUCCESSFULLY : ceres::SOLVER_CONTINUE;
  }

  int iterations() const { return iterations_; }
  double gradient() const { return gradient_; }  // relative to the largest
  bool small() const { return small_; }
  bool interrupted() const { return interrupted_; }

 private:
  const EventPhases& phases_;
  const PhaseMinimumOptions& options_;
  const std::vector<double>* z_;
  double largest_ = 0, gradient_ = 1;
  int iterations_ = 0;
  bool started_ = false, small_ = false, interrupted_ = false;
};

ceres::Solver::Options CeresOptions(int iterations) {
  ceres::Solver::Options options;
  options.linear_solver_type = ceres::DENSE_QR;
  options.logging_type = ceres::SILENT;
  options.max_num_iterations = iterations;
  options.gradient_tolerance = 1e-14;
  options.function_tolerance = 0;
  options.parameter_tolerance = 1e-15;
  options.update_state_every_iteration = true;  // the callback reads it
  return options;
}

}  // namespace

PhaseMinimum MinimizeLoss(const EventPhases& phases, std::vector<double> z, const PhaseMinimumOptions& options) {
  PhaseMinimum result;
  result.multipliers.assign(phases.num_impacts(), 0.0);
  Path<double> path;
  if (!phases.Unroll(z.data(), &path)) return result;

  if (phases.num_variables() == 0) {  // nobody is pushed with effect
    result.valid = result.converged = true;
    result.loss = phases.Loss(path);
    return result;
  }
  Constraints constraints{.multipliers = result.multipliers, .approaching = {}};
  for (const auto& impact : path.impacts) constraints.approaching.push_back(impact.impact.speed < 0);
  // A gap of a tenth of the contact distance costs as much as the loss at the start.
  double reach = 0;
  for (int k = 0; k < phases.num_impacts(); ++k) reach = std::max(reach, phases.law(k).reach);
  constraints.weight = std::max(1e-6, phases.Loss(path)) * 200 / (reach * reach + 1e-30);

  const Residuals residuals(&phases, &constraints);
  auto* cost = new ceres::DynamicAutoDiffCostFunction<Residuals, kStride>(new Residuals(residuals));
  cost->AddParameterBlock(phases.num_variables());
  cost->SetNumResiduals(residuals.size());
  ceres::Problem problem;
  problem.AddResidualBlock(cost, nullptr, z.data());
  Watch watch(phases, options, &z);
  double last_gap = LargestGap(phases, path);
  constexpr int kMostRounds = 30;
  for (int round = 0; round < kMostRounds; ++round) {
    ceres::Solver::Options ceres_options = CeresOptions(options.iterations - watch.iterations());
    ceres_options.callbacks = {&watch};
    ceres::Solver::Summary summary;
    ceres::Solve(ceres_options, &problem, &summary);
    result.jacobians += summary.num_jacobian_evaluations;
    if (summary.termination_type == ceres::FAILURE || !phases.Unroll(z.data(), &path)) return result;
    result.gap = LargestGap(phases, path);
    const bool flat = summary.termination_type == ceres::CONVERGENCE && watch.gradient() < kFlatGradient;
    result.converged = (watch.small() || flat) && result.gap <= options.gap_tolerance;
    if (result.converged || watch.interrupted() || watch.iterations() >= options.iterations) break;
    if (residuals.size() == phases.num_loss_residuals()) break;  // nothing to be constrained
    for (int k = 0; k < phases.num_impacts(); ++k) {
      if (!phases.IsSteered(k)) constraints.multipliers[k] += constraints.weight * path.impacts[k].gap;
    }
    if (round > 0 && result.gap > 0.1 * last_gap) constraints.weight *= 10;
    last_gap = result.gap;
  }
  result.valid = true;
  result.interrupted = watch.interrupted();
  result.loss = phases.Loss(path);
  result.multipliers = constraints.multipliers;
  result.iterations = watch.iterations();
  result.z = std::move(z);
  return result;
}

}  // namespace saltus
