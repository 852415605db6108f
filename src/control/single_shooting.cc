#include "saltus/control/single_shooting.h"

#include <glog/logging.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

#include "base/statistics.h"
#include "control/design_difference.h"
#include "control/path_costs.h"
#include "saltus/internal/lanes.h"
#include "saltus/scene/scene_parameter.h"
#include "scene/scene_rules.h"
#include "simulate/derivative_overflow.h"
#include "simulate/lane_simulator.h"
#include "simulate/wide_loops.h"

namespace saltus {
namespace {

// Adds two indices into the initial state for each body: of its position (offset 0) or velocity (2).
void AddPairs(const std::vector<int>& bodies, int offset, std::vector<int>* indices) {
  for (int body : bodies) {
    for (int j = 0; j < 2; ++j) indices->push_back(4 * body + offset + j);
  }
}

std::vector<int> IndicesOfDecisionVariables(const Scene& scene) {
  std::vector<int> indices;
  if (scene.optimize == Optimize::kPosition) AddPairs(scene.free, 0, &indices);
  if (scene.optimize != Optimize::kVelocity) return indices;
  AddPairs(scene.free, 2, &indices);
  for (int body : scene.free_spin) indices.push_back(4 * scene.num_bodies() + kSpin * body + 1);
  return indices;
}

std::vector<int> IndicesOfInitialState(const Scene& scene) {
  std::vector<int> moving, indices;
  for (int i = 0; i < scene.num_bodies(); ++i) {
    if (!scene.bodies[i].fixed) moving.push_back(i);
  }
  AddPairs(moving, 0, &indices);
  AddPairs(moving, 2, &indices);
  for (int i = 0; i < scene.num_bodies() && scene.Spins(); ++i) {
    for (int j = 0; j < kSpin && scene.bodies[i].Spins(); ++j) {
      indices.push_back(4 * scene.num_bodies() + kSpin * i + j);
    }
  }
  return indices;
}

// Returns the reason why derivatives of the simulator's last rollout are not finite; empty if they are.
std::string ReasonNotFinite(const Simulator& simulator, std::span<const double> control,
                            std::span<const double> derivatives) {
  bool are_finite = true;
  internal::RunWide([&] { are_finite = AllFinite(derivatives); });
  if (simulator.stopped() || are_finite) return "";
  return ReasonDerivativesOverflow(simulator, control);
}

}  // namespace

SingleShooting::SingleShooting(std::unique_ptr<Simulator> simulator, Variables variables,
                               SimulatorFactory simulator_factory)
    : simulator_(std::move(simulator)),
      simulator_factory_(std::move(simulator_factory)),
      has_duration_(simulator_factory_ != nullptr && scene().objective.duration.has_value()),
      path_costs_(PathCosts::Make(*simulator_)),
      controls_(variables == Variables::kOptimized && scene().optimize == Optimize::kControl),
      places_(variables == Variables::kOptimized && scene().optimize == Optimize::kPosition),
      initial_(InitialState(simulator_->scene())),
      final_(simulator_->state_size()),
      cotangent_(simulator_->state_size()) {
  CHECK(!has_duration() || controls_) << "a free final time is a variable beside a control only";
  if (controls_) {
    guess_ = InitialControl(scene(), simulator_->num_steps());
    if (has_duration()) {
      const FreeDuration& free = *scene().objective.duration;
      guess_.push_back(std::clamp(scene().duration, free.min, free.max));
    }
    AddDesign();
    return;
  }
  control_ = InitialControl(scene(), simulator_->num_steps());
  variables_ =
      variables == Variables::kInitialState ? IndicesOfInitialState(scene()) : IndicesOfDecisionVariables(scene());
  for (int index : variables_) guess_.push_back(initial_[index]);
  if (!variables_.empty()) initial_gradient_.resize(initial_.size());
  if (variables == Variables::kOptimized) AddDesign();
}

void SingleShooting::AddDesign() {
  const bool exact = simulator_->traits().event_driven && simulator_->precision() == Precision::kDouble;
  if (simulator_factory_ == nullptr || (path_costs_ != nullptr && !exact) || scene().design.empty()) return;
  given_ = scene();
  const std::vector<double> design = DesignOf(given_);
  num_design_ = static_cast<int>(design.size());
  guess_.insert(guess_.end(), design.begin(), design.end());
}

std::vector<double> SingleShooting::InitialStateAt(std::span<const double> z) const {
  std::vector<double> initial =
      InitialState(num_design_ > 0 ? WithDesign(given_, z.last(static_cast<std::size_t>(num_design_))) : scene());
  for (size_t i = 0; i < variables_.size(); ++i) initial[variables_[i]] = z[i];
  return initial;
}

SingleShooting::SingleShooting(SingleShooting&&) noexcept = default;
SingleShooting::~SingleShooting() = default;

std::span<const double> SingleShooting::ControlIn(std::span<const double> z) const {
  if (controls_) return StripDesign(z).first(z.size() - num_design_ - has_duration());
  return control_;
}

std::vector<double> SingleShooting::ControlAt(std::span<const double> z) const {
  const std::span<const double> control = ControlIn(z);
  return {control.begin(), control.end()};
}

std::vector<double> SingleShooting::DurationsAt(std::span<const double> z) const {
  if (!has_duration()) return {};
  return std::vector<double>(simulator_->num_steps(), StripDesign(z).back() / simulator_->num_steps());
}

std::vector<double> SingleShooting::ParametersAt(std::span<const double> z) const {
  const std::span<const double> design = z.last(static_cast<std::size_t>(num_design_));
  return {design.begin(), design.end()};
}

std::string SingleShooting::SetScene(std::span<const double> z) {
  if (!has_duration_ && num_design_ == 0) return "";
  const std::span<const double> design = z.last(static_cast<std::size_t>(num_design_));
  for (std::size_t i = 0; i < design.size(); ++i) {
    const ParameterRange range = RangeOf(given_.design[i]);
    if (design[i] >= range.min && design[i] <= range.max) continue;
    return NameOf(given_.design[i].parameter, given_) + " is out of its bounds";
  }
  Scene next = num_design_ > 0 ? WithDesign(given_, design) : scene();
  if (has_duration_) {
    next.duration = StripDesign(z).back();
    const auto& via = next.objective.via;
    if (!(next.duration > 0) || !std::isfinite(next.duration) ||
        std::any_of(via.begin(), via.end(), [&](const ViaTerm& term) { return term.time >= next.duration; })) {
      return "the final time is not after the times of all waypoint costs";
    }
  }
  if (next == scene()) return "";
  if (num_design_ > 0) {
    if (const std::optional<SceneError> error = Validate(next)) return error->ToString();
  }
  std::unique_ptr<Simulator> simulator = simulator_factory_(next);
  if (simulator == nullptr) return "the contact model does not take the scene with these parameters";
  simulator->set_memory_limit(simulator_->memory_limit());
  simulator_ = std::move(simulator);
  if (num_design_ > 0) initial_ = InitialState(next);
  simulator_->set_stop(stop_);
  return "";
}

std::string SingleShooting::FailureReason() const { return failure_.empty() ? simulator_->FailureReason() : failure_; }

bool SingleShooting::BeginRollout(std::span<const double> z) {
  CHECK_EQ(static_cast<int>(z.size()), num_variables());
  failure_.clear();
  if (path_costs_ != nullptr) at_.assign(z.begin(), z.end());
  failure_ = SetScene(z);
  if (!failure_.empty()) return false;
  for (size_t i = 0; i < variables_.size(); ++i) initial_[variables_[i]] = z[i];
  if (places_) {
    if (const std::optional<SceneError> error = FindOverlapAt(scene(), initial_)) failure_ = error->ToString();
    if (!failure_.empty()) return false;
  }
  ++num_rollouts_;
  return true;
}

bool SingleShooting::EndRollout(std::span<const double> z) {
  simulator_->GetState(simulator_->num_steps(), final_);
  if (path_costs_ != nullptr) failure_ = path_costs_->Update(*simulator_, initial_, ControlIn(z));
  return failure_.empty();
}

bool SingleShooting::Rollout(std::span<const double> z) {
  return BeginRollout(z) && simulator_->Rollout(initial_, ControlIn(z)) && EndRollout(z);
}

double SingleShooting::Effort(std::span<const double> z) const {
  return EffortLoss(scene().objective, ControlIn(z), simulator_->step());
}

double SingleShooting::LossOfLastRollout(double effort) const {
  const double loss = TerminalLoss(scene().objective, final_, simulator_->body_size()) + effort;
  if (path_costs_ == nullptr) return loss;
  const std::optional<FreeDuration>& free = scene().objective.duration;
  return loss + path_costs_->Loss() + (free ? free->weight * scene().duration : 0.0);
}

// Calls put(i, derivatives) with the derivatives of numbers of the last rollout by each design parameter. They are
// differences, as path costs have no adjoint by parameters; NaN where there are none.
template <typename Numbers, typename Put>
void SingleShooting::DifferenceByParameters(const Numbers& numbers, const Put& put) {
  if (num_design_ == 0) return;
  const std::vector<double> at = at_;
  std::vector<double> other = at;
  const auto first = other.end() - num_design_;
  for (int i = 0; i < num_design_; ++i) {
    std::vector<double> by =
        DifferenceByDesign(given_, ParametersAt(at), i, [&](const std::vector<double>& values) -> std::vector<double> {
          std::copy(values.begin(), values.end(), first);
          return Rollout(other) ? numbers() : std::vector<double>();
        });
    if (by.empty()) by.assign(num_residuals(), std::numeric_limits<double>::quiet_NaN());
    put(i, by);
  }
  Rollout(at);
}

// Computes the gradient of the loss of the last rollout with path costs.
void SingleShooting::PathCostGradient(std::span<const double> z, double* gradient) {
  ++num_adjoints_;
  if (!controls_) {
    path_costs_->Gradient({}, initial_gradient_, nullptr);
    for (int index : variables_) *gradient++ = initial_gradient_[index];
  } else {
    const std::span<const double> control = ControlIn(z);
    path_costs_->Gradient({gradient, control.size()}, {}, has_duration() ? gradient + control.size() : nullptr);
    AddEffortGradient(scene().objective, control, simulator_->step(), {gradient, control.size()});
    gradient += control.size();
    if (has_duration()) {
      *gradient++ += scene().objective.duration->weight +
                     EffortLoss(scene().objective, control, simulator_->step()) / scene().duration;
    }
  }
  DifferenceByParameters([&] { return std::vector<double>{LossOfLastRollout(Effort(at_))}; },
                         [&](int i, const std::vector<double>& by) { gradient[i] = by[0]; });
}

void SingleShooting::PullBack(double effort, std::span<const double> z, double* gradient) {
  ++num_adjoints_;
  SensitivityView out;
  out.initial = initial_gradient_;
  if (controls_) {
    out.control = {gradient, guess_.size() - num_design_};
    out.factor = effort;
    if (!z.empty()) out.addend = StripDesign(z);
  }
  if (num_design_ > 0) out.parameters = &parameters_;
  simulator_->AdjointInto(cotangent_, out);
  for (int index : variables_) *gradient++ = initial_gradient_[index];
  if (num_design_ == 0) return;
  std::copy(parameters_.design.begin(), parameters_.design.end(), gradient + out.control.size());
}

bool SingleShooting::Evaluate(std::span<const double> z, double* loss, double* gradient) {
  return Rollout(z) && EvaluateLast(z, Effort(z), loss, gradient);
}

int SingleShooting::num_lanes() const {
  const auto* const simulator = dynamic_cast<const LaneSimulator*>(simulator_.get());
  return simulator != nullptr && simulator->HasLanes() && path_costs_ == nullptr ? kLanes : 1;
}

void SingleShooting::EvaluateTogether(std::span<const std::unique_ptr<SingleShooting>> shootings,
                                      std::span<const double> points, std::span<double> losses,
                                      std::span<double> gradients, std::span<bool> ok) {
  const std::size_t count = losses.size(), size = shootings[0]->num_variables();
  const auto point = [&](std::size_t i) { return points.subspan(i * size, size); };
  const auto gradient = [&](std::size_t i) { return gradients.empty() ? nullptr : &gradients[i * size]; };
  if (count == 1 || shootings[0]->num_lanes() == 1) {
    for (std::size_t i = 0; i < count; ++i) ok[i] = shootings[0]->Evaluate(point(i), &losses[i], gradient(i));
    return;
  }
  // The effort is checked first: a loss is not finite if its effort is not.
  std::array<const double*, kLanes> controls;
  for (std::size_t i = 0; i < kLanes; ++i) controls[i] = shootings[0]->ControlIn(point(i < count ? i : 0)).data();
  const std::array<double, kLanes> squares = SumsOfSquares(controls, shootings[0]->ControlIn(point(0)).size());
  std::array<double, kLanes> efforts;
  std::vector<LaneSimulator::Motion> motions;
  std::vector<std::size_t> moving;
  motions.reserve(count);
  moving.reserve(count);
  for (std::size_t i = 0; i < count; ++i) {
    SingleShooting& shooting = *shootings[i];
    efforts[i] = shooting.scene().objective.effort * squares[i] * shooting.simulator_->step();
    ok[i] = std::isfinite(efforts[i]) && shooting.BeginRollout(point(i));
    if (!ok[i]) continue;
    moving.push_back(i);
    motions.push_back(
        {static_cast<LaneSimulator*>(shooting.simulator_.get()), shooting.initial_, shooting.ControlIn(point(i))});
  }
  // The next points in memory are most often evaluated next. A prefetch beyond the end has no effect.
  const std::ptrdiff_t next = points.size(), set = gradients.empty() ? 0 : gradients.data() + next - points.data();
  if (!motions.empty()) motions[0].simulator->RolloutTogether(motions, /*force_unit=*/1, {next, set});
  for (std::size_t m = 0; m < motions.size(); ++m) {
    const std::size_t i = moving[m];
    ok[i] = motions[m].ok && shootings[i]->EndRollout(point(i)) &&
            shootings[i]->EvaluateLast(point(i), efforts[i], &losses[i], gradient(i));
  }
}

bool SingleShooting::EvaluateLast(std::span<const double> z, double effort, double* loss, double* gradient) {
  *loss = LossOfLastRollout(effort);
  if (!std::isfinite(*loss)) return false;
  if (gradient == nullptr) return true;
  if (path_costs_ != nullptr) {
    PathCostGradient(z, gradient);
  } else {
    TerminalGradient(scene().objective, final_, simulator_->body_size(), cotangent_);
    PullBack(EffortWeight(scene().objective, simulator_->step()), z, gradient);
  }
  if (simulator_->precision() == Precision::kFloat) {
    for (int i = 0; i < num_variables(); ++i) gradient[i] = static_cast<float>(gradient[i]);
  }
  failure_ = ReasonNotFinite(*simulator_, ControlIn(z), {gradient, static_cast<size_t>(num_variables())});
  return !stopped();
}

int SingleShooting::num_residuals() const {
  return path_costs_ != nullptr ? path_costs_->num_residuals() : NumTerminalResiduals(scene().objective);
}

bool SingleShooting::EvaluateResiduals(std::span<const double> z, double* residuals, double* jacobian) {
  if (!Rollout(z)) return false;
  const std::span<double> rows(residuals, num_residuals());
  if (path_costs_ != nullptr) {
    path_costs_->Residuals(rows);
  } else {
    TerminalResiduals(scene().objective, final_, simulator_->body_size(), rows);
  }
  if (!std::isfinite(LossOfLastRollout(Effort(z)))) return false;
  if (jacobian == nullptr) return true;
  ResidualJacobian(jacobian);
  failure_ = ReasonNotFinite(*simulator_, ControlIn(z), {jacobian, rows.size() * num_variables()});
  return !stopped();
}

void SingleShooting::ResidualJacobian(double* jacobian) {
  if (path_costs_ == nullptr) {
    const Eigen::MatrixXd terminal =
        TerminalJacobian(scene().objective, simulator_->state_size(), simulator_->body_size());
    for (int row = 0; row < terminal.rows(); ++row) {
      Eigen::Map<Eigen::RowVectorXd>(cotangent_.data(), cotangent_.size()) = terminal.row(row);
      PullBack(0, {}, jacobian + static_cast<size_t>(row) * num_variables());
    }
    return;
  }
  const size_t rows = num_residuals(), width = num_variables(), forces = controls_ ? ControlIn(at_).size() : 0;
  num_adjoints_ += static_cast<int>(rows);
  std::vector<double> control(rows * forces), duration(has_duration() ? rows : 0);
  std::vector<double> initial(rows * initial_gradient_.size());
  path_costs_->Jacobian(control, initial, duration);
  for (size_t row = 0; row < rows; ++row) {
    double* to = std::copy_n(control.begin() + row * forces, forces, jacobian + row * width);
    if (has_duration()) *to = duration[row];
    for (int index : variables_) *to++ = initial[row * initial_gradient_.size() + index];
  }
  DifferenceByParameters(
      [&] {
        std::vector<double> residuals(rows);
        path_costs_->Residuals(residuals);
        return residuals;
      },
      [&](int i, const std::vector<double>& by) {
        for (size_t row = 0; row < rows; ++row) jacobian[(row + 1) * width - num_design_ + i] = by[row];
      });
}

bool SingleShooting::EvaluateAll(std::span<const double> z, double* loss, Sensitivity* gradient) {
  if (!Rollout(z)) return false;
  *loss = LossOfLastRollout(Effort(z));
  if (!std::isfinite(*loss)) return false;
  TerminalGradient(scene().objective, final_, simulator_->body_size(), cotangent_);
  simulator_->Adjoint(cotangent_, /*with_parameters=*/true, gradient);
  ++num_adjoints_;
  AddEffortGradient(scene().objective, ControlIn(z), simulator_->step(), gradient->control);
  for (const std::vector<double>* part : {&gradient->initial, &gradient->control}) {
    if (failure_.empty()) failure_ = ReasonNotFinite(*simulator_, ControlIn(z), *part);
  }
  return !stopped();
}

}  // namespace saltus
