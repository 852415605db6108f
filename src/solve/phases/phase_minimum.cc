#include "solve/phases/phase_minimum.h"

#include <ceres/dynamic_autodiff_cost_function.h>
#include <ceres/manifold.h>
#include <ceres/problem.h>
#include <ceres/solver.h>

#include <algorithm>
#include <cmath>

namespace saltus {
namespace {

constexpr int kStride = 4;           // derivatives in one pass
constexpr double kFlat = 1e-14;      // of the cost: a step that gains no more ends the search ...
constexpr double kWideRadius = 100;  // ... if it was not cut short by a trust region smaller than this
constexpr double kClosed = 1e-11;    // of a gap, in lengths
constexpr double kLeastLoss = 1e-6;  // from which gaps have their price
constexpr int kBlockedSteps = 4;     // one after the other, after which an impact that stops them is held at a touch

struct Constraints {
  double weight = 0;                // of the loss, 1 / length^2
  std::vector<double> multipliers;  // by impact
  std::vector<bool> approaching;    // by impact: it must stay so, as it was at the start
  std::vector<bool> touching;       // by impact: its normal velocity is held at zero
  std::vector<bool> blocked;        // by impact: since the last step that was taken, one would have parted its sides
  bool may_touch = true;
};

// Residuals: square roots of the loss, then of weight/2 (gap + multiplier/weight)^2 for each gap.
class Residuals {
 public:
  Residuals(const EventPhases* phases, Constraints* constraints) : phases_(phases), constraints_(constraints) {}

  template <typename T>
  bool operator()(T const* const* z, T* residuals) const {
    Path<T> path;
    if (!phases_->Unroll(z[0], &path)) return false;
    for (int k = 0; k < phases_->num_impacts(); ++k) {
      if (!constraints_->approaching[k] || path.impacts[k].impact.speed < 0.0) continue;
      constraints_->blocked[k] = true;
      return false;
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
  Constraints* constraints_;
};

double LargestGap(const EventPhases& phases, const Path<double>& path) {
  double gap = 0;
  for (int k = 0; k < phases.num_impacts(); ++k) gap = std::max(gap, std::abs(path.impacts[k].gap));
  return gap;
}

// Stops Ceres when told to, or when an undamped step gains nothing any more.
class Watch final : public ceres::IterationCallback {
 public:
  Watch(const EventPhases& phases, const PhaseMinimumOptions& options, Constraints* constraints,
        const std::vector<double>* z)
      : phases_(phases), options_(options), constraints_(constraints), z_(z) {}

  ceres::CallbackReturnType operator()(const ceres::IterationSummary& summary) override {
    if (summary.iteration == 0 && started_) return ceres::SOLVER_CONTINUE;  // another round
    if (summary.step_is_successful) CountBlocked();
    radius_ = summary.trust_region_radius;
    flat_ =
        summary.iteration > 0 && summary.step_is_successful && summary.cost_change <= kFlat * summary.cost && IsWide();
    Path<double> path;
    if (started_ && phases_.Unroll(z_->data(), &path)) {
      ++iterations_;
      if (options_.callback && !options_.callback(phases_.Loss(path))) interrupted_ = true;
    }
    started_ = true;
    const bool blocked = constraints_->may_touch && blocked_steps_ >= kBlockedSteps;
    return interrupted_ || flat_ || blocked ? ceres::SOLVER_TERMINATE_SUCCESSFULLY : ceres::SOLVER_CONTINUE;
  }

  int iterations() const { return iterations_; }
  // The last step was hardly damped.
  bool IsWide() const { return radius_ >= kWideRadius; }
  bool flat() const { return flat_; }
  bool interrupted() const { return interrupted_; }

 private:
  void CountBlocked() {
    std::vector<bool>& blocked = constraints_->blocked;
    blocked_steps_ = std::find(blocked.begin(), blocked.end(), true) == blocked.end() ? 0 : blocked_steps_ + 1;
    if (!constraints_->may_touch || blocked_steps_ < kBlockedSteps) blocked.assign(blocked.size(), false);
  }

  const EventPhases& phases_;
  const PhaseMinimumOptions& options_;
  Constraints* constraints_;
  const std::vector<double>* z_;
  double radius_ = 0;
  int iterations_ = 0, blocked_steps_ = 0;
  bool started_ = false, flat_ = false, interrupted_ = false;
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
  options.max_num_consecutive_invalid_steps = 20;
  return options;
}

// Holds those impacts at a touch that have stopped a minimization that ends at z. False if there are none.
bool HoldTouches(const EventPhases& phases, Constraints* constraints, std::vector<double>* z) {
  bool any = false;
  if (!constraints->may_touch) return false;
  for (int k = 0; k < phases.num_impacts(); ++k) {
    if (!constraints->blocked[k] || !phases.IsSteered(k)) continue;
    any = true;
    constraints->touching[k] = true;
    constraints->approaching[k] = constraints->blocked[k] = false;
    (*z)[phases.SpeedIndex(k)] = 0;
  }
  return any;
}

// Makes those held impacts close again, slowly, that had better do so, to first order; none is held from then on. False
// if there are none.
bool ReleaseTouches(const EventPhases& phases, Constraints* constraints, std::vector<double>* z) {
  Path<double> path, closing;
  if (!phases.Unroll(z->data(), &path)) return false;
  bool any = false;
  for (int k = 0; k < phases.num_impacts(); ++k) {
    if (!constraints->touching[k]) continue;
    const PhaseImpact<double>& impact = path.impacts[k];
    const double speed = std::abs(impact.impact.sliding) + phases.law(k).contact_distance / impact.time;
    double& variable = (*z)[phases.SpeedIndex(k)];
    variable = -1e-6 * speed;
    const bool better = phases.Unroll(z->data(), &closing) && phases.Loss(closing) < phases.Loss(path);
    variable = better ? -1e-3 * speed : 0.0;
    any = any || better;
    constraints->touching[k] = !better;
    constraints->approaching[k] = better;
  }
  if (any) constraints->may_touch = false;
  return any;
}

}  // namespace

PhaseMinimum MinimizeLoss(const EventPhases& phases, std::vector<double> z, const PhaseMinimumOptions& options) {
  PhaseMinimum result;
  Path<double> path;
  if (!phases.Unroll(z.data(), &path)) return result;

  if (phases.num_variables() == 0) {  // nobody is pushed with effect
    result.valid = result.converged = true;
    result.loss = phases.Loss(path);
    return result;
  }
  Constraints constraints;
  constraints.multipliers.assign(phases.num_impacts(), 0.0);
  constraints.touching.assign(phases.num_impacts(), false);
  constraints.blocked = constraints.touching;
  for (const auto& impact : path.impacts) constraints.approaching.push_back(impact.impact.speed < 0);
  // A gap of a tenth of the contact distance costs as much as the loss at the start.
  double distance = 0;
  for (int k = 0; k < phases.num_impacts(); ++k) distance = std::max(distance, phases.law(k).contact_distance);
  if (distance > 0) constraints.weight = std::max(kLeastLoss, phases.Loss(path)) * 200 / (distance * distance);

  auto* cost = new ceres::DynamicAutoDiffCostFunction<Residuals, kStride>(new Residuals(&phases, &constraints));
  cost->AddParameterBlock(phases.num_variables());
  cost->SetNumResiduals(phases.num_loss_residuals() + phases.num_gaps());
  ceres::Problem problem;
  problem.AddResidualBlock(cost, nullptr, z.data());
  Watch watch(phases, options, &constraints, &z);
  double last_gap = LargestGap(phases, path);
  const auto hold = [&] {
    std::vector<int> held;
    for (int k = 0; k < phases.num_impacts(); ++k) {
      if (constraints.touching[k]) held.push_back(phases.SpeedIndex(k));
    }
    result.touches = !held.empty();
    problem.SetManifold(z.data(), result.touches ? new ceres::SubsetManifold(phases.num_variables(), held) : nullptr);
  };
  constexpr int kMostRounds = 30;
  for (int round = 0; round < kMostRounds; ++round) {
    ceres::Solver::Options ceres_options = CeresOptions(options.iterations - watch.iterations());
    ceres_options.callbacks = {&watch};
    ceres::Solver::Summary summary;
    ceres::Solve(ceres_options, &problem, &summary);
    result.jacobians += summary.num_jacobian_evaluations;
    if (!phases.Unroll(z.data(), &path)) return result;
    const bool stopped = watch.interrupted() || watch.iterations() >= options.iterations;
    const bool flat = watch.flat() || (summary.termination_type == ceres::CONVERGENCE && watch.IsWide());
    if (!flat && !stopped && HoldTouches(phases, &constraints, &z)) {
      hold();
      continue;
    }
    if (summary.termination_type == ceres::FAILURE) return result;
    const double gap = LargestGap(phases, path);
    result.converged = flat && gap <= kClosed;
    if (result.converged && result.touches && ReleaseTouches(phases, &constraints, &z)) {
      result.converged = false;
      hold();
      continue;
    }
    if (result.converged || stopped) break;
    if (phases.num_gaps() == 0) break;  // nothing to be constrained
    for (int k = 0; k < phases.num_impacts(); ++k) {
      if (!phases.IsSteered(k)) constraints.multipliers[k] += constraints.weight * path.impacts[k].gap;
    }
    if (round > 0 && gap > 0.1 * last_gap) constraints.weight *= 10;
    last_gap = gap;
  }
  result.valid = true;
  result.interrupted = watch.interrupted();
  result.loss = phases.Loss(path);
  result.z = std::move(z);
  return result;
}

}  // namespace saltus
