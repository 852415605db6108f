// The conditions of saltus/optimality/hybrid_certificate.h, from the steps of the exact motion.
//
// With multipliers theta of events, equalities and active inequalities, the derivatives of the Lagrangian by controls,
// initial state, parameters, the times of the events and the final time are affine in theta: one backward sweep through
// the motion for the objective, and one for each multiplier. ConeConditions (cone_conditions.h) computes the theta that
// minimises the residual of all conditions.
//
// An inequality of the control alone, such as a bound on the norm of a force, has a multiplier in each interval that
// enters the conditions of that interval only. These then state that the derivative by the control is opposite to the
// cone of the outward normals of the inequality and the bounds.
#include "optimality/hybrid_conditions.h"

#include <ceres/cost_function.h>

#include <Eigen/Dense>
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <optional>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "base/number_text.h"
#include "control/hybrid_shooting.h"
#include "hybrid/free_variables.h"
#include "hybrid/runge_kutta.h"
#include "optimality/cone_conditions.h"
#include "optimality/constrained_curvature.h"
#include "optimality/kink_conditions.h"
#include "saltus/optimality/hybrid_certificate.h"

namespace saltus {
namespace {

using Matrix = RungeKutta::Matrix;
using Sparse = Eigen::SparseMatrix<double>;
using Kind = FreeVariable::Kind;
using Eigen::VectorXd;

constexpr double kAtBound = 1e-6;       // of a bound's range, or an inequality's violation that counts as active
constexpr double kSameTouch = 1e-6;     // of the duration: a touch and a grazing of a guard at the same time
constexpr double kAtNode = 1e-6;        // of an interval: an event so near to its end is at it
constexpr double kSameTime = 1e-14;     // of the duration
constexpr double kBeside = 1e-13;       // of the duration: from an event to the end of an interval beside it
constexpr double kSameNode = 1e-9;      // of the duration
constexpr double kRoundedSize = 1e-12;  // of the change of a state by rates beside the motion: less is rounding
constexpr int kMostPasses = 4;          // through all states, whose sizes depend on one another
constexpr double kNoInterval = 1e-9;    // of the duration: of an interval so short nothing is asked
constexpr double kSmallTerms = 0.01;    // of the largest size of a component of the control: the least of a component
constexpr double kNoControl = 1e-6;     // of the size that a component has if it is zero: smaller ones are zero
constexpr int kMostMultipliers = 1000;  // of which conditions are looked at
constexpr double kNoMultiplier = 1e-7;  // of the terms that cancel: that of a bound that does not press
constexpr double kOfGuard = 1e-9;       // of the size of a guard: a value that is not zero

// A step of the motion, from `begin` to `end`, with its derivatives by [x t p u h].
struct Step {
  int mode = 0, interval = 0, phase = 0;
  bool projects = false;
  double begin = 0, end = 0;
  VectorXd state;  // at the beginning
  Matrix by;
};

// The derivative of the Lagrangian for one of the multipliers, or of the objective.
struct Sweep {
  VectorXd control;  // K x m
  VectorXd initial, parameters;
  VectorXd times;  // by the boundaries of phases, whose steps and intervals move with them
  // The derivatives by the times of the events while the ends of intervals stay, with the control before (after) the
  // event on both of its sides.
  VectorXd event_early, event_late;
  double scale = 0;  // by the duration, with all intervals scaled
  // Sizes of the terms that cancel: of controls by component, of states at the start, of the Hamiltonian.
  VectorXd control_size, initial_size, parameters_size;
  double hamiltonian_size = 0;

  bool IsFinite() const {
    const auto finite = [](const VectorXd& numbers) { return numbers.allFinite(); };
    return std::ranges::all_of(std::array{control, initial, parameters, times, event_early, event_late}, finite) &&
           std::isfinite(scale);
  }
};

// Sets the theta of an event on a node, by its multiplier and the one-sided ones: 0 at the late one, 1 at the early
// one; and whether the kink is concave. There is none if these two are the same, and the multiplier too. A residual r
// of the conditions until the event, in parts of `scale`, lowers the loss by about r^2 of its terms, which is rounding
// if that is less than 1e-9.
void SetTheta(double early, double late, double multiplier, double scale, ImpactCertificate* impact) {
  constexpr double kFar = 1e9;
  const double kink = early - late;
  constexpr double kCounts = 3e-5;
  const auto counts = [&](double change) { return change * impact->time > kCounts * scale; };
  if (!(std::abs(kink) > 1e-9 * (std::abs(early) + std::abs(late)))) {
    // Without a kink the multiplier of a minimum is that of both sides, and no other is between them.
    if (counts(std::abs(multiplier - late))) impact->theta = multiplier > late ? kFar : -kFar;
    return;
  }
  const double theta = (multiplier - late) / kink, between = std::clamp(theta, 0.0, 1.0);
  impact->theta = counts(std::abs((theta - between) * kink)) ? theta : between;
  impact->concave = counts(kink);
}

// The rows of a function, each times a factor.
class ScaledRows final : public ceres::CostFunction {
 public:
  ScaledRows(std::shared_ptr<const ceres::CostFunction> function, VectorXd factors)
      : function_(std::move(function)), factors_(std::move(factors)) {
    set_num_residuals(function_->num_residuals());
    *mutable_parameter_block_sizes() = function_->parameter_block_sizes();
  }
  bool Evaluate(double const* const* parameters, double* residuals, double** jacobians) const override {
    if (!function_->Evaluate(parameters, residuals, jacobians)) return false;
    Eigen::Map<VectorXd>(residuals, num_residuals()).array() *= factors_.array();
    for (size_t block = 0; jacobians != nullptr && block < parameter_block_sizes().size(); ++block) {
      if (jacobians[block] == nullptr) continue;
      Eigen::Map<Matrix>(jacobians[block], num_residuals(), parameter_block_sizes()[block]).array().colwise() *=
          factors_.array();
    }
    return true;
  }

 private:
  const std::shared_ptr<const ceres::CostFunction> function_;
  const VectorXd factors_;
};

// Adds the kind of a curvature: it is flat if it is nearly zero, or less than `rounding` times the largest.
Curvature ClassifyCurvature(const ConstrainedCurvature& found, double rounding) {
  constexpr double kNearlyZero = 1e-6;
  const double flat = kNearlyZero + rounding * found.largest;
  using enum Curvature::Kind;
  Curvature curvature;
  curvature.kind = found.smallest > flat ? kMinimum : found.smallest < -flat ? kSaddle : kFlat;
  curvature.smallest = found.smallest;
  curvature.direction.assign(found.direction.begin(), found.direction.end());
  return curvature;
}

class HybridConditions {
 public:
  HybridConditions(const HybridProblem& problem, const HybridInput& input, const ConditionsOptions& options)
      : problem_(problem),
        input_(input),
        options_(options),
        touches_(options.touches),
        system_(problem.system),
        functions_(system_.functions()),
        shooting_(problem),
        integrator_(functions_) {
    if (input_.control.empty()) input_.control.assign(input_.num_intervals * width(), 0.0);
  }

  // Returns the input after a step of Newton's method, with intervals that move with the events, or stay.
  std::optional<HybridInput> NewtonStep(bool moving) {
    Certificate result;
    if (!Read(&result)) return std::nullopt;
    moving ? StationarityOnMovingGrid(&result) : StationarityOnFixedGrid(&result);
    QuadraticForm form;
    const Directions to = DirectionsOf(moving, /*with_weak=*/false, &form);
    AddSecondDerivatives(to, &form);
    AddMetric(to, &form);
    VectorXd slope = VectorXd::Zero(form.count());
    const auto add = [&](const SparseRow& row, const auto& derivative) {
      double by = derivative(sweeps_[0]);
      for (int j = 0; j < num_multipliers(); ++j) by += theta_[j] * derivative(sweeps_[j + 1]);
      for (const auto& [unknown, size] : row) slope[unknown] += by * size;
    };
    for (size_t i = 0; i < to.unbound.size(); ++i) {
      add(to.variables[i], [&](const Sweep& s) { return DerivativeByVariable(s, to.unbound[i], moving); });
    }
    for (int k = 0; k < num_events() && moving; ++k) {
      add(to.boundaries[k + 1], [&](const Sweep& s) { return s.times[k + 1]; });
    }
    const std::optional<VectorXd> step = SolveConstrained(form.Form(), form.Equations(), form.Metric(), -slope);
    if (!step) return std::nullopt;
    const auto change = [&](const SparseRow& row) {
      double sum = 0;
      for (const auto& [unknown, size] : row) sum += size * (*step)[unknown];
      return sum;
    };
    HybridInput next = input_;
    const auto move = [&](const SparseRows& rows, std::vector<double>* numbers) {
      for (size_t i = 0; i < rows.size(); ++i) (*numbers)[i] += change(rows[i]);
    };
    move(to.control, &next.control);
    move(to.initial, &next.initial);
    move(to.parameters, &next.parameters);
    next.duration += change(to.boundaries.back());
    std::vector<double> times = times_;
    for (double& time : times) time += change(TimeRow(to, time, PhaseAt(time, /*before=*/false)));
    next.lengths.clear();
    for (size_t k = 1; k < times.size(); ++k) next.lengths.push_back(times[k] - times[k - 1]);
    return next;
  }

  // Returns the sizes of the motion; std::nullopt if there is none.
  std::optional<MotionSizes> Sizes() {
    HybridShooting::Outcome outcome;
    if (!shooting_.Simulate(input_, &outcome) || !shooting_.EvaluateTerms(&terms_)) return std::nullopt;
    loss_ = outcome.loss;
    ReadMotion();
    FindSizes();
    for (const HybridShooting::TermAt& at : terms_) {
      VectorXd residuals;
      std::vector<Matrix> jacobians;
      if (!at.term->IsCost() || !EvaluateOnSide(at, 1, &residuals, &jacobians) || !residuals.allFinite()) continue;
      for (const double residual : residuals) sizes_.asked_loss += std::abs(at.term->LossOf(residual));
    }
    return sizes_;
  }

  // Returns by how much each row of each constraint changes, at most, as one of the numbers that it reads changes by
  // its size. Each such change is the middle one of three: along the motion, and where all numbers have changed by
  // their size, up and down. So a row has a size where its derivative is zero along the motion, and none by a pole such
  // as that of 1 / r at r = 0. Precondition: Sizes() has returned them.
  std::vector<VectorXd> SizesOfConstraints() const {
    std::vector<VectorXd> rows;
    for (const HybridTerm& term : problem_terms()) rows.push_back(VectorXd::Zero(term.NumRows()));
    for (const HybridShooting::TermAt& at : terms_) {
      if (at.term->IsCost()) continue;
      VectorXd& of_term = rows[at.term - problem_terms().data()];
      const std::vector<VectorXd> sizes = SizesOfBlocks(at);
      std::array<std::vector<Matrix>, 3> changes;
      for (const int side : {0, 1, 2}) {
        VectorXd residuals;
        const bool has_value = EvaluateOnSide(at, side - 1, &residuals, &changes[side]);
        for (size_t i = 0; i < sizes.size(); ++i) {
          Matrix& by = changes[side][i];
          by = (by.cwiseAbs() * sizes[i].asDiagonal()).unaryExpr([&](double change) {
            return has_value && std::isfinite(change) ? change : INFINITY;
          });
        }
      }
      for (size_t i = 0; i < sizes.size(); ++i) {
        const auto& [down, along, up] = std::tie(changes[0][i], changes[1][i], changes[2][i]);
        const Matrix middle = down.cwiseMin(up).cwiseMax(down.cwiseMax(up).cwiseMin(along));
        const VectorXd by = middle.rowwise().maxCoeff();
        if (by.allFinite()) of_term = of_term.cwiseMax(by);
      }
    }
    return rows;
  }

  Certificate Run() {
    Certificate result;
    if (!Read(&result)) return result;
    StationarityOnMovingGrid(&result);
    StationarityOnMovingGrid(&result);  // with the sizes that the multipliers give
    JudgeControl(&result);
    const bool moving = result.IsStationary();
    if (!moving) {
      const std::vector<ImpactCertificate> of_moving_grid = result.impacts;
      StationarityOnFixedGrid(&result);
      if (!IsStationaryOnGrid(result)) result.impacts = of_moving_grid;
      JudgeControl(&result);
    }
    if (options_.always_curvature) {
      theta_.head(num_events()) = OneSided(/*early=*/true).head(num_events());
      result.curvature = CurvatureAlong(/*moving=*/false, /*with_weak=*/false);
      return result;
    }
    if (result.IsStationary() && touches_.empty()) {
      result.curvature = CurvatureAlongFree(moving, &result.reason);
      if (result.curvature) JudgeControl(&result);
    }
    for (size_t c = 0; c < constraints_.size(); ++c) {
      if (constraints_[c].term >= 0) continue;
      const GuardTouch& touch = touches_[constraints_[c].row];
      ImpactCertificate& impact = result.impacts.emplace_back();
      impact.time = touch.time;
      impact.multiplier = theta_[num_events() + static_cast<Eigen::Index>(c)];
      impact.on_node = true;
      Name(touch.mode, touch.guard, &impact);
    }
    SetGridGradients(&result);
    if (options_.multipliers != nullptr) *options_.multipliers = TermMultipliers();
    if (options_.parameters != nullptr) *options_.parameters = ParameterDerivatives();
    if (moving && result.reason.empty() && HoldsAlways() != nullptr && num_events() > 0) {
      result.reason = "of controls whose intervals end at the events, as " + HoldsAlways()->name + " holds always";
    }
    if (result.IsStationary() && result.curvature && !options_.name) {  // scenes list them as constraints
      for (const std::string& where : WhereBoundsPress()) result.reason += (result.reason.empty() ? "" : "; ") + where;
    }
    return result;
  }

 private:
  // Reads the motion, and its events into the impacts of the certificate. Returns false, with the verdict or the
  // reason, if there are no conditions to judge.
  bool Read(Certificate* result) {
    HybridShooting::Outcome outcome;
    bool moves = shooting_.Simulate(input_, &outcome);
    if (moves && HoldsAlways() != nullptr) {  // such constraints read the state after an event at an end of an interval
      if (auto behind = ShiftNodes(1, kSameNode * input_.duration, [](int) { return true; })) {
        input_ = std::move(*behind);
        moves = shooting_.Simulate(input_, &outcome);
      }
    }
    if (!moves) {
      result->reason = shooting_.FailureReason();
      return false;
    }
    if (result->reason = ReasonNoConditions(); !result->reason.empty()) return false;
    for (const HybridTie& tie : simulator().ties()) {
      if (!tie.ambiguous) continue;
      result->verdict = Certificate::Verdict::kAmbiguous;
      result->reason = std::to_string(tie.guards.size()) + " guards reach zero at t = " + std::to_string(tie.time) +
                       ", and the order of their events matters";
      return false;
    }
    if (!shooting_.EvaluateTerms(&terms_)) {
      result->reason = shooting_.FailureReason();
      return false;
    }
    if (outcome.violation <= kAtBound && IsZero()) {
      result->verdict = Certificate::Verdict::kGlobal;
      result->reason = "the loss is zero within rounding, and a sum of squares is not less";
      return false;
    }
    loss_ = outcome.loss;
    ReadMotion();
    FindSizes();
    FindVariables();
    FindMultipliers();
    if (num_multipliers() > kMostMultipliers) {
      result->reason = "more than " + std::to_string(kMostMultipliers) + " multipliers";
      return false;
    }
    for (int j = -1; j < num_multipliers(); ++j) {
      sweeps_.push_back(SweepOf(VectorXd::Unit(1 + num_all(), 1 + j)));
      if (sweeps_.back().IsFinite()) continue;
      result->reason = "there are no finite costates: " + ReasonNotFinite();
      return false;
    }
    SetMultipliersOfSizes(VectorXd::Ones(num_multipliers()));
    for (size_t k = 0; k < events().size(); ++k) {
      ImpactCertificate& impact = result->impacts.emplace_back();
      const HybridEvent& event = events()[k];
      impact.time = event.time;
      Name(event.mode, event.guard, &impact);
      impact.speed = -event.rate;
      impact.on_node = on_node_[k];
      impact.jumps = JumpsAtNode(static_cast<int>(k));
    }
    return true;
  }

  static bool IsStationaryOnGrid(const Certificate& certificate) {
    return certificate.gradient && *certificate.gradient <= kCertificateTolerance;
  }
  // Judges a control. If the problem gives its intervals, those that move with the events prove nothing.
  void JudgeControl(Certificate* result) const {
    Judge(result);
    if (result->verdict != Certificate::Verdict::kStationary || !IsOnGrid(problem_)) return;
    const bool on_grid = IsStationaryOnGrid(*result);
    result->verdict = on_grid ? Certificate::Verdict::kStationaryOnGrid : Certificate::Verdict::kNotStationary;
    if (!on_grid) result->reason = "the loss falls with the control on the intervals that the problem gives";
  }

  const HybridSimulator& simulator() const { return const_cast<HybridShooting&>(shooting_).simulator(); }
  const std::vector<HybridEvent>& events() const { return simulator().events(); }
  int num_events() const { return static_cast<int>(events().size()); }
  // The multipliers of events, then of the constraints: of those with a sweep, then of those of one interval.
  int num_all() const { return num_events() + static_cast<int>(constraints_.size()); }
  int num_multipliers() const { return num_all() - static_cast<int>(of_interval_.size()); }
  int width() const { return system_.num_controls(); }
  // Whether derivatives by the parameters are read.
  bool by_parameters() const { return !problem_.free.parameters.empty() || options_.parameters != nullptr; }
  const double* ControlOf(int interval) const { return input_.control.data() + interval * width(); }

  void Name(int mode, int guard, ImpactCertificate* impact) const {
    impact->a = system_.ModeName(mode);
    impact->b = system_.GuardName(mode, guard);
    if (options_.name) options_.name(mode, guard, impact);
  }

  std::string ReasonNoConditions() const {
    for (const HybridEvent& event : events()) {
      if (event.immediate) return "guards have transitions at once; the conditions are those of events that take time";
    }
    const bool within = std::ranges::any_of(events(), [&](const HybridEvent& event) { return !IsAtNode(event.time); });
    if (HoldsAlways() != nullptr && within) {
      return HoldsAlways()->name + " holds always, and is evaluated up to the event within a control interval alone";
    }
    for (const HybridGrazing& grazing : simulator().grazings()) {
      const bool is_touch = std::ranges::any_of(touches_, [&](const GuardTouch& touch) {
        return touch.mode == grazing.mode && touch.guard == grazing.guard &&
               std::abs(touch.time - grazing.time) <= kSameTouch * input_.duration;
      });
      if (is_touch) continue;
      return "guard '" + system_.GuardName(grazing.mode, grazing.guard) +
             "' grazes zero at t = " + std::to_string(grazing.time) +
             "; the conditions are those of events that cross it";
    }
    return "";
  }

  // Returns a constraint for which control intervals have to end at events, and move with them; nullptr if there is
  // none.
  const HybridTerm* HoldsAlways() const {
    const auto term = std::ranges::find_if(problem_.terms, &HybridTerm::always);
    return term != problem_.terms.end() ? &*term : nullptr;
  }
  // Says of each constraint that holds always when it is at its bound, which directions of the curvature keep.
  std::vector<std::string> WhereBoundsPress() const {
    std::vector<std::string> all;
    for (const HybridTerm& term : problem_terms()) {
      if (!term.always) continue;
      std::vector<std::pair<double, double>> spans;  // of time
      for (size_t i = 0; i < terms_.size(); ++i) {   // intervals, one after the other
        const auto presses = [&](bool at_end) {
          return std::ranges::any_of(constraints_, [&](const Constraint& one) {
            return one.term == static_cast<int>(i) && at_end == (one.row >= term.function->num_residuals());
          });
        };
        if (terms_[i].term != &term) continue;
        const double begin = times_[terms_[i].interval], end = times_[terms_[i].interval + 1];
        const bool before_end = presses(false);
        if (!before_end && !presses(true)) continue;
        const double from = before_end ? begin : end;
        if (!spans.empty() && spans.back().second >= from) {
          spans.back().second = end;
        } else {
          spans.emplace_back(from, end);
        }
      }
      std::string when;
      for (const auto& [from, to] : spans) {
        when += (when.empty() ? "" : ", ") +
                (from < to ? "from t = " + ToText(from, 6) + " to " + ToText(to, 6) : "at t = " + ToText(to, 6));
      }
      all.push_back(term.name + " holds always, and is " +
                    (when.empty() ? "never at its bound"
                                  : "at its bound in control intervals " + when + ", where the curvature is along it"));
    }
    return all;
  }
  // Returns the input with the ends of intervals that are within `near` of an event that counts moved to just behind it
  // (side 1) or before it (-1); std::nullopt if there are none.
  template <typename Counts>
  std::optional<HybridInput> ShiftNodes(int side, double near, const Counts& counts) const {
    std::vector<double> ends = input_.Times();
    bool any = false;
    for (int i = 0; i < num_events(); ++i) {
      const double time = events()[i].time;
      for (size_t k = 1; k + 1 < ends.size(); ++k) {
        if (std::abs(ends[k] - time) > near || !counts(i)) continue;
        ends[k] = time + side * kBeside * input_.duration;
        any = true;
        break;
      }
    }
    if (!any) return std::nullopt;
    HybridInput input = input_;
    input.lengths.clear();
    for (size_t k = 1; k < ends.size(); ++k) input.lengths.push_back(ends[k] - ends[k - 1]);
    return input;
  }
  bool IsAtNode(double time) const {
    const std::vector<double> ends = input_.Times();
    return std::ranges::any_of(ends, [&](double end) { return std::abs(end - time) <= kSameNode * input_.duration; });
  }

  // Says which derivative along the motion is not finite.
  std::string ReasonNotFinite() {
    shooting_.simulator().Adjoint(std::vector<double>(simulator().final_state().size(), 1.0));
    const std::string& why = simulator().ReasonNotFinite();
    return why.empty() ? "they overflow" : why;
  }

  // Returns the sizes of what a term reads.
  std::vector<VectorXd> SizesOfBlocks(const HybridShooting::TermAt& at) const {
    const auto of_state = [&](int mode) -> VectorXd { return sizes_.state[mode].cwiseMax(sizes_.asked_state[mode]); };
    const int mode = at.event < 0      ? simulator().ModeAt(at.interval < 0 ? input_.num_intervals : at.interval)
                     : at.term->before ? events()[at.event].mode
                                       : events()[at.event].next_mode;
    std::vector<VectorXd> sizes;
    if (at.term->with_state) sizes.push_back(of_state(mode));
    if (at.term->with_initial) sizes.push_back(of_state(input_.mode));
    if (at.term->with_control) sizes.push_back(sizes_.control.cwiseMax(sizes_.asked_control));
    if (at.term->with_parameters) sizes.push_back(sizes_.parameters);
    sizes.resize(at.blocks.size(), VectorXd::Constant(1, input_.duration));
    return sizes;
  }

  // Evaluates a term where all that it reads has changed by a part of its size. Returns false if it has no value there.
  bool EvaluateOnSide(const HybridShooting::TermAt& at, double part, VectorXd* residuals,
                      std::vector<Matrix>* jacobians) const {
    const std::vector<VectorXd> sizes = SizesOfBlocks(at);
    std::vector<VectorXd> blocks;
    std::vector<const double*> in;
    std::vector<double*> out;
    residuals->resize(static_cast<Eigen::Index>(at.residuals.size()));
    for (size_t i = 0; i < sizes.size(); ++i) {
      blocks.push_back(Eigen::Map<const VectorXd>(at.blocks[i].data(), sizes[i].size()) + part * sizes[i]);
      jacobians->emplace_back(residuals->size(), sizes[i].size());
    }
    for (const VectorXd& block : blocks) in.push_back(block.data());
    for (Matrix& jacobian : *jacobians) out.push_back(jacobian.data());
    return at.function->Evaluate(in.data(), residuals->data(), out.data());
  }

  // Whether all costs are squares whose residuals are of the size of rounding errors of the motion.
  bool IsZero() const {
    constexpr double kRounding = 1e-10;
    for (const HybridShooting::TermAt& at : terms_) {
      if (at.term->role == HybridTerm::Role::kValue) return false;
      if (at.term->role != HybridTerm::Role::kCost) continue;
      const auto rows = static_cast<Eigen::Index>(at.residuals.size());
      for (Eigen::Index row = 0; row < rows; ++row) {
        double size = 0;
        for (size_t block = 0; block < at.jacobians.size(); ++block) {
          const std::vector<double>& jacobian = at.jacobians[block];
          const auto columns = static_cast<Eigen::Index>(jacobian.size()) / rows;
          for (Eigen::Index i = 0; i < columns; ++i) {
            size += std::abs(jacobian[row * columns + i] * at.blocks[block][i]);
          }
        }
        if (!(std::abs(at.residuals[row]) <= kRounding * size)) return false;
      }
    }
    return true;
  }

  // -------------------------------------------------------------------------------------------- the motion as steps

  void ReadMotion() {
    times_ = input_.Times();
    boundaries_ = {0.0};
    for (const HybridEvent& event : events()) boundaries_.push_back(event.time);
    boundaries_.push_back(input_.duration);
    const int count = simulator().num_steps();
    int phase = 0;
    for (int i = 0; i < count; ++i) {
      if (simulator().IsReset(i)) {
        ++phase;
        continue;
      }
      // A step ends where the next one begins.
      const double begin = simulator().StepTime(i);
      const double end = i + 1 < count ? simulator().StepTime(i + 1) : input_.duration;
      if (end > begin) AddStep(i, phase, begin, end);
    }
    for (const HybridEvent& event : events()) {
      const auto next = std::upper_bound(times_.begin(), times_.end(), event.time);
      auto k = static_cast<int>(next - times_.begin());
      if (k == static_cast<int>(times_.size()) || event.time - times_[k - 1] < times_[k] - event.time) --k;
      const double length = k > 0 ? times_[k] - times_[k - 1] : times_[1];
      const bool at_node = std::abs(event.time - times_[k]) <= kAtNode * length;
      node_.push_back(at_node ? k : -1);
      on_node_.push_back(at_node && !IsControlContinuous(k));
      const int interval = IntervalAt(event.time);
      interval_before_.push_back(at_node ? std::max(k - 1, 0) : interval);
      interval_after_.push_back(at_node ? std::min(k, input_.num_intervals - 1) : interval);
    }
  }

  int IntervalAt(double t) const {
    const auto next = std::upper_bound(times_.begin(), times_.end(), t);
    return std::clamp(static_cast<int>(next - times_.begin()) - 1, 0, input_.num_intervals - 1);
  }

  // Adds a step, divided where guards touch zero within it.
  void AddStep(int i, int phase, double begin, double end) {
    const int mode = simulator().StepMode(i);
    std::vector<double> ends = {end};
    for (const GuardTouch& touch : touches_) {
      if (touch.mode == mode && touch.time > begin && touch.time < end) ends.push_back(touch.time);
    }
    std::ranges::sort(ends);
    ends.erase(std::unique(ends.begin(), ends.end()), ends.end());
    steps_.push_back(Linearized(i, IntervalAt(0.5 * (begin + end)), phase, begin, ends[0]));
    for (size_t part = 1; part < ends.size(); ++part) {
      const Step before = steps_.back();
      Step step = before;
      step.begin = before.end;
      step.end = ends[part];
      const double *u = ControlOf(step.interval), *p = input_.parameters.data();
      integrator_.Step({{mode, before.begin, before.state.data(), u, p}, before.end - before.begin, step.projects},
                       step.state.data());
      const ModePoint at{mode, step.begin, step.state.data(), u, p, by_parameters()};
      step.by = integrator_.Jacobian({at, step.end - step.begin, step.projects});
      steps_.push_back(std::move(step));
    }
  }

  Step Linearized(int i, int interval, int phase, double begin, double end) {
    const int mode = simulator().StepMode(i), n = system_.state_size(mode);
    // A step to an event is projected by the reset.
    const bool to_event = i + 1 < simulator().num_steps() && simulator().IsReset(i + 1);
    Step step{mode, interval, phase, functions_.Projects(mode) && !to_event, begin, end, VectorXd(n), {}};
    std::copy_n(simulator().StepState(i).data(), n, step.state.data());
    const ModePoint at{mode, begin, step.state.data(), ControlOf(interval), input_.parameters.data(), by_parameters()};
    step.by = integrator_.Jacobian({at, end - begin, step.projects});
    return step;
  }

  // ------------------------------------------------------------------------------------------------------- multipliers

  struct Constraint {
    int term = 0, row = 0;  // of terms_; or -1 and which of the touches
    bool inequality = false;
  };

  void FindMultipliers() {
    for (size_t i = 0; i < terms_.size(); ++i) {
      const HybridShooting::TermAt& at = terms_[i];
      if (at.term->IsCost()) continue;
      const bool inequality = at.term->role == HybridTerm::Role::kInequality;
      for (size_t row = 0; row < at.residuals.size(); ++row) {
        if (inequality && at.residuals[row] < -kAtBound) continue;
        constraints_.push_back({static_cast<int>(i), static_cast<int>(row), inequality});
      }
    }
    for (int i = 0; i < std::ssize(touches_); ++i) constraints_.push_back({-1, i, true});
    FindConstraintsOfIntervals();
  }

  // An active inequality of the control of one interval, and the at most two components that it reads.
  struct IntervalCone {
    int interval = 0;
    std::array<int, 2> components = {-1, -1};  // -1: there is no second one
    Eigen::Vector2d slope = Eigen::Vector2d::Zero();
    size_t condition = 0;  // among the forces of ConeConditions
    double size = 1;       // by which that condition is divided
  };

  // Puts the inequalities that have a cone last. Others share components with another one, or read more.
  void FindConstraintsOfIntervals() {
    std::vector<Constraint> with_sweep, with_cone;
    cone_of_.assign(input_.control.size(), -1);
    for (const Constraint& constraint : constraints_) {
      const std::optional<IntervalCone> cone = ConeOf(constraint);
      const auto is_taken = [&](int c) { return c >= 0 && cone_of_[cone->interval * width() + c] >= 0; };
      if (!cone || std::ranges::any_of(cone->components, is_taken)) {
        with_sweep.push_back(constraint);
        continue;
      }
      for (const int c : cone->components) {
        if (c >= 0) cone_of_[cone->interval * width() + c] = static_cast<int>(of_interval_.size());
      }
      with_cone.push_back(constraint);
      of_interval_.push_back(*cone);
    }
    constraints_ = std::move(with_sweep);
    constraints_.insert(constraints_.end(), with_cone.begin(), with_cone.end());
  }
  std::optional<IntervalCone> ConeOf(const Constraint& constraint) const {
    if (constraint.term < 0 || !constraint.inequality) return std::nullopt;
    const HybridShooting::TermAt& at = terms_[constraint.term];
    if (!ReadsControlAlone(*at.term) || !problem_.free.control) return std::nullopt;
    IntervalCone cone{.interval = at.interval};
    int count = 0;
    for (int c = 0; c < width(); ++c) {
      const double slope = at.jacobians[0][constraint.row * width() + c];
      if (slope == 0) continue;
      if (count == 2) return std::nullopt;
      cone.components[count] = c;
      cone.slope[count++] = slope;
    }
    if (count == 0) return std::nullopt;
    return cone;
  }
  static bool ReadsControlAlone(const HybridTerm& term) {
    return term.with_control && !term.with_state && !term.with_initial && !term.with_parameters && !term.with_time &&
           !term.with_length;
  }
  std::vector<TermMultiplier> TermMultipliers() const {
    std::vector<TermMultiplier> multipliers;
    for (size_t c = 0; c < constraints_.size(); ++c) {
      if (constraints_[c].term < 0) continue;
      const HybridShooting::TermAt& at = terms_[constraints_[c].term];
      multipliers.push_back({static_cast<int>(at.term - problem_terms().data()),
                             at.interval,
                             at.event,
                             constraints_[c].row,
                             theta_[num_events() + static_cast<Eigen::Index>(c)]});
    }
    return multipliers;
  }
  const std::vector<HybridTerm>& problem_terms() const { return shooting_.problem().terms; }

  // Returns the derivative of a term's contribution to the Lagrangian by its rows; std::nullopt if it has none.
  std::optional<Eigen::RowVectorXd> RowWeights(size_t term, const VectorXd& residuals, const VectorXd& weights) const {
    const HybridTerm& of = *terms_[term].term;
    if (of.IsCost()) {
      if (weights[0] == 0) return std::nullopt;
      return Eigen::RowVectorXd(weights[0] * residuals.unaryExpr([&](double r) { return of.SlopeOf(r); }).transpose());
    }
    Eigen::RowVectorXd rows = Eigen::RowVectorXd::Zero(residuals.size());
    for (size_t c = 0; c < constraints_.size(); ++c) {
      if (constraints_[c].term == static_cast<int>(term)) rows[constraints_[c].row] = weights[1 + num_events() + c];
    }
    if (rows.isZero(0)) return std::nullopt;
    return rows;
  }
  // The derivatives of a term's contribution by what the term reads.
  struct Source {
    VectorXd state, initial, control, parameters;
    double time = 0, length = 0;
    bool before = false;  // of an event: of the state before the reset
  };
  std::optional<Source> SourceOf(size_t term, const VectorXd& weights) const {
    const HybridShooting::TermAt& at = terms_[term];
    const auto rows = static_cast<Eigen::Index>(at.residuals.size());
    const auto by_rows = RowWeights(term, Eigen::Map<const VectorXd>(at.residuals.data(), rows), weights);
    if (!by_rows) return std::nullopt;
    Source source;
    source.before = at.term->before;
    size_t block = 0;
    const auto next = [&] {
      const std::vector<double>& jacobian = at.jacobians[block++];
      const auto columns = static_cast<Eigen::Index>(jacobian.size()) / rows;
      return VectorXd((*by_rows * Eigen::Map<const Matrix>(jacobian.data(), rows, columns)).transpose());
    };
    if (at.term->with_state) source.state = next();
    if (at.term->with_initial) source.initial = next();
    if (at.term->with_control) source.control = next();
    if (at.term->with_parameters) source.parameters = next();
    if (at.term->with_time) source.time = next()[0];
    if (at.term->with_length) source.length = next()[0];
    return source;
  }

  // ------------------------------------------------------------------------------------------------------------ sweeps

  // Returns where in a phase a time is: 0 at its beginning, 1 at its end.
  double PartOf(int phase, double t) const {
    const double begin = boundaries_[phase], length = boundaries_[phase + 1] - begin;
    return length > 0 ? std::clamp((t - begin) / length, 0.0, 1.0) : 1.0;
  }

  // Adds the derivative by a time inside a phase to those by the two boundaries of the phase, which it moves with.
  void AddTime(double t, int phase, double by, VectorXd* times) const {
    const double part = PartOf(phase, t);
    (*times)[phase] += (1 - part) * by;
    (*times)[phase + 1] += part * by;
  }

  int PhaseAt(double t, bool before) const {  // of two phases that meet there, the first
    int phase = 0;
    while (phase < num_events() && (before ? boundaries_[phase + 1] < t : boundaries_[phase + 1] <= t)) ++phase;
    return phase;
  }

  // Costates of a sweep: after each step, and after each event and the terms there.
  struct Costates {
    std::vector<VectorXd> of_steps, of_events;
  };

  // `weights`: of the objective, and of all multipliers.
  Sweep SweepOf(const VectorXd& weights, Costates* costates = nullptr) const {
    const int P = system_.num_parameters(), m = width(), K = input_.num_intervals;
    Sweep sweep;
    sweep.control = VectorXd::Zero(K * m);
    sweep.parameters = VectorXd::Zero(P);
    sweep.times = VectorXd::Zero(boundaries_.size());
    sweep.event_early = sweep.event_late = VectorXd::Zero(num_events());
    sweep.control_size = VectorXd::Zero(m);
    sweep.parameters_size = VectorXd::Zero(P);
    VectorXd own_control = VectorXd::Zero(K * m);  // what terms read of the control themselves
    std::vector<std::vector<Source>> at_interval(K), at_event(num_events());
    std::vector<Source> at_end;
    for (size_t i = 0; i < terms_.size(); ++i) {
      std::optional<Source> source = SourceOf(i, weights);
      if (!source) continue;
      if (source->parameters.size() > 0) {
        sweep.parameters += source->parameters;
        sweep.parameters_size += source->parameters.cwiseAbs();
      }
      const HybridShooting::TermAt& at = terms_[i];
      if (at.interval >= 0) {
        if (source->control.size() > 0) own_control.segment(at.interval * m, m) += source->control;
        const double begin = times_[at.interval], end = times_[at.interval + 1];
        const int from = PhaseAt(begin, false), to = PhaseAt(end, true);
        AddTime(begin, from, source->time - source->length, &sweep.times);
        AddTime(end, to, source->length, &sweep.times);
        sweep.scale += (source->time * begin + source->length * (end - begin)) / input_.duration;
        sweep.hamiltonian_size = std::max(sweep.hamiltonian_size, std::abs(source->length));
        at_interval[at.interval].push_back(std::move(*source));
      } else if (at.event >= 0) {
        sweep.times[at.event + 1] += source->time;
        sweep.scale += source->time * boundaries_[at.event + 1] / input_.duration;
        at_event[at.event].push_back(std::move(*source));
      } else {
        sweep.times[num_events() + 1] += source->time;
        sweep.scale += source->time;
        sweep.hamiltonian_size = std::max(sweep.hamiltonian_size, std::abs(source->time));
        at_end.push_back(std::move(*source));
      }
    }
    sweep.control = own_control;
    // Sweeps backwards from the final time.
    VectorXd costate = VectorXd::Zero(system_.state_size(simulator().final_mode()));
    for (const Source& source : at_end) {
      if (source.state.size() > 0) costate += source.state;
    }
    const ModePoint end{simulator().final_mode(),
                        input_.duration,
                        simulator().final_state().data(),
                        ControlOf(K - 1),
                        input_.parameters.data()};
    AddTouches(end, num_events(), weights, &costate, &sweep);
    VectorXd by_flow = VectorXd::Zero(K * m), by_flow_size = VectorXd::Zero(K * m), terms;
    int event = num_events() - 1, interval = K;
    // Adds the states at the beginnings of intervals that are not before `time`.
    const auto add_interval_states = [&](double time) {
      while (interval > 0 && times_[interval - 1] >= time - kSameTime * input_.duration) {
        for (const auto& source : at_interval[--interval]) {
          if (source.state.size() > 0) costate += source.state;
        }
      }
    };
    for (int s = static_cast<int>(steps_.size()); s-- > 0;) {
      const Step& step = steps_[s];
      for (; event >= step.phase; --event)
        JumpBack(event, weights[1 + event], at_event, &sweep, &by_flow, &costate, costates);
      if (costates != nullptr) costates->of_steps[s] = costate;
      const int n = system_.state_size(step.mode);
      const Eigen::RowVectorXd by = costate.transpose() * step.by;
      terms = step.by.cwiseAbs().transpose() * costate.cwiseAbs();
      const double by_h = by[n + 1 + P + m], by_t = by[n];
      sweep.hamiltonian_size =
          std::max(sweep.hamiltonian_size, (costate.cwiseProduct(step.by.col(n + 1 + P + m))).cwiseAbs().sum());
      AddTime(step.begin, step.phase, by_t - by_h, &sweep.times);
      AddTime(step.end, step.phase, by_h, &sweep.times);
      sweep.scale += (by_t * step.begin + by_h * (step.end - step.begin)) / input_.duration;
      by_flow.segment(step.interval * m, m) += by.segment(n + 1 + P, m).transpose();
      by_flow_size.segment(step.interval * m, m) += terms.segment(n + 1 + P, m);
      sweep.parameters += by.segment(n + 1, P).transpose();
      sweep.parameters_size += terms.segment(n + 1, P);
      costate = by.head(n).transpose();
      const double* x = step.state.data();
      AddTouches({step.mode, step.begin, x, ControlOf(step.interval), input_.parameters.data()},
                 step.phase,
                 weights,
                 &costate,
                 &sweep);
      add_interval_states(step.begin);
    }
    for (; event >= 0; --event) JumpBack(event, weights[1 + event], at_event, &sweep, &by_flow, &costate, costates);
    for (const Source& source : at_end) {
      if (source.initial.size() > 0) costate += source.initial;
    }
    sweep.initial = costate;
    sweep.initial_size = costate.cwiseAbs();
    // The state of the first step is the initial one if the motion does not begin with an event.
    if (terms.size() == costate.size() + 1 + P + m + 1) {
      sweep.initial_size = sweep.initial_size.cwiseMax(terms.head(costate.size()));
    }
    sweep.control += by_flow;
    for (int i = 0; i < K * m; ++i) {
      const double length = times_[i / m + 1] - times_[i / m];
      if (length <= kNoInterval * input_.duration) continue;
      double& size = sweep.control_size[i % m];
      size = std::max(size, (std::abs(own_control[i]) + by_flow_size[i]) / length);
    }
    return sweep;
  }

  // Adds the derivatives of the guards that touch zero at a point: of the constraints -g <= 0.
  void AddTouches(const ModePoint& at, int phase, const VectorXd& weights, VectorXd* costate, Sweep* sweep) const {
    for (size_t c = 0; c < constraints_.size(); ++c) {
      const double weight = weights[1 + num_events() + static_cast<Eigen::Index>(c)];
      if (constraints_[c].term >= 0 || weight == 0) continue;
      const GuardTouch& touch = touches_[constraints_[c].row];
      if (touch.mode != at.mode || touch.time != at.t) continue;
      const int n = system_.state_size(at.mode), P = system_.num_parameters();
      VectorXd gradient(n + 1 + P + width());
      functions_.GuardGradient(at, touch.guard, gradient.data());
      gradient *= -weight;
      *costate += gradient.head(n);
      AddTime(at.t, phase, gradient[n], &sweep->times);
      sweep->scale += gradient[n] * at.t / input_.duration;
      sweep->parameters += gradient.segment(n + 1, P);
      sweep->parameters_size += gradient.segment(n + 1, P).cwiseAbs();
    }
  }

  // Computes the costate before event k from that after it; by_flow is the derivative by the control.
  void JumpBack(int k, double multiplier, const std::vector<std::vector<Source>>& at_event, Sweep* sweep,
                VectorXd* by_flow, VectorXd* costate, Costates* costates) const {
    const HybridEvent& event = events()[k];
    const int n = system_.state_size(event.mode), P = system_.num_parameters(), columns = n + 1 + P;
    const double* control = ControlOf(interval_before_[k]);
    const auto add = [&](bool before) {
      for (const Source& source : at_event[k]) {
        if (source.before == before && source.state.size() > 0) *costate += source.state;
      }
    };
    const VectorXd costate_behind = *costate;  // of the motion that goes on, without the terms at the event
    add(false);
    VectorXd after(functions_.most_states());
    Matrix reset(functions_.most_states(), columns);
    const ModePoint at{event.mode, event.time, event.before.data(), control, input_.parameters.data()};
    functions_.ResetJacobian(at, event.guard, after.data(), reset.data());
    if (costates != nullptr) costates->of_events[k] = *costate;
    const Eigen::RowVectorXd by = costate->transpose() * reset.topRows(costate->size());
    VectorXd before = by.head(n).transpose();
    double by_time = by[n];
    sweep->parameters += by.tail(P).transpose();
    sweep->parameters_size += by.tail(P).transpose().cwiseAbs();
    if (multiplier != 0) {
      Eigen::RowVectorXd guard(columns + system_.num_controls());
      functions_.GuardGradient(at, event.guard, guard.data());
      guard *= multiplier;
      by_flow->segment(interval_before_[k] * width(), width()) += guard.tail(width()).transpose();
      before += guard.head(n).transpose();
      by_time += guard[n];
      sweep->parameters += guard.segment(n + 1, P).transpose();
      sweep->parameters_size += guard.segment(n + 1, P).transpose().cwiseAbs();
    }
    *costate = std::move(before);
    add(true);
    sweep->times[k + 1] += by_time;
    sweep->scale += by_time * event.time / input_.duration;
    double own_time = 0;  // the derivative by the time of the event that terms read
    for (const Source& source : at_event[k]) own_time += source.time;
    by_time += own_time;
    // Returns H before less H after, for the event alone with the same control u on both sides.
    const auto one_sided = [&](const double* u) {
      VectorXd in(n), out(costate_behind.size());
      functions_.Flow({event.mode, event.time, event.before.data(), u, at.p}, in.data());
      functions_.Flow({event.next_mode, event.time, event.after.data(), u, at.p}, out.data());
      return by_time + costate->dot(in) - costate_behind.dot(out);
    };
    sweep->event_early[k] = one_sided(ControlOf(interval_before_[k]));
    sweep->event_late[k] = one_sided(ControlOf(interval_after_[k]));
  }

  // ------------------------------------------------------------------------------------------------- second derivative
  //
  // The second derivative of the Lagrangian along the variables that no bound holds. Unknown are the changes of these
  // variables, of the times of the events and of the states after each step and reset. With the second derivative M of
  // what each step, reset, guard and term adds, weighted by the costate behind it, and the derivative V of what it
  // reads by the unknowns, the form is the sum of V^T M V. Linear equations relate the unknowns: the steps and resets,
  // the guards at the events, and the constraints that are held. M is by central differences of exact first
  // derivatives.

  // A derivative by the unknowns: pairs of an unknown, which is there once, and a coefficient.
  using SparseRow = std::vector<std::pair<int, double>>;
  using SparseRows = std::vector<SparseRow>;

  // The quadratic form and the equations, for unknowns that are divided by their sizes.
  class QuadraticForm {
   public:
    // Returns the derivative of an unknown of this size by the unknowns.
    SparseRow AddUnknown(double size) { return {{count_++, size > 0 ? size : 1.0}}; }
    void Add(const Eigen::MatrixXd& second, const SparseRows& along) { AddTo(&form_, second, along); }
    void AddMetric(const Eigen::MatrixXd& second, const SparseRows& along) { AddTo(&metric_, second, along); }
    void AddEquation(const SparseRow& row) {
      double square = 0;
      for (const auto& [column, value] : row) square += value * value;
      if (square == 0) return;
      for (const auto& [column, value] : row)
        equations_.emplace_back(num_equations_, column, value / std::sqrt(square));
      ++num_equations_;
    }
    // Adds an unknown of this size that equals a combination of unknowns; returns its derivative.
    SparseRow AddDefined(double size, const SparseRow& image) {
      const SparseRow unknown = AddUnknown(size);
      defined_.push_back({unknown[0].first, num_equations_});
      AddEquation(Combined(1, image, -1, unknown));
      return unknown;
    }

    int count() const { return count_; }
    Sparse Form() const { return MatrixOf(form_, count_); }
    Sparse Metric() const { return MatrixOf(metric_, count_); }
    Sparse Equations() const { return MatrixOf(equations_, num_equations_); }
    const std::vector<DefinedUnknown>& defined() const { return defined_; }

   private:
    using Triplets = std::vector<Eigen::Triplet<double>>;
    static void AddTo(Triplets* sum, const Eigen::MatrixXd& second, const SparseRows& along) {
      for (Eigen::Index i = 0; i < second.rows(); ++i) {
        for (Eigen::Index j = 0; j < second.cols(); ++j) {
          if (second(i, j) == 0) continue;
          for (const auto& [a, by_a] : along[i]) {
            for (const auto& [b, by_b] : along[j]) sum->emplace_back(a, b, by_a * second(i, j) * by_b);
          }
        }
      }
    }
    Sparse MatrixOf(const Triplets& entries, int rows) const {
      Sparse matrix(rows, count_);
      matrix.setFromTriplets(entries.begin(), entries.end());
      return matrix;
    }

    int count_ = 0, num_equations_ = 0;
    Triplets form_, metric_, equations_;
    std::vector<DefinedUnknown> defined_;
  };

  static void AddScaled(double factor, const SparseRow& row, SparseRow* sum) {
    if (factor == 0) return;
    for (const auto& [column, value] : row) {
      const auto known = std::ranges::find(*sum, column, &SparseRow::value_type::first);
      if (known != sum->end()) {
        known->second += factor * value;
      } else {
        sum->emplace_back(column, factor * value);
      }
    }
  }
  static SparseRow Combined(double a, const SparseRow& x, double b, const SparseRow& y) {
    SparseRow sum;
    AddScaled(a, x, &sum);
    AddScaled(b, y, &sum);
    return sum;
  }
  // Returns the rows of matrix * along.
  static SparseRows Image(const Eigen::Ref<const Matrix, 0, Eigen::OuterStride<>>& matrix, const SparseRows& along) {
    SparseRows image(matrix.rows());
    for (Eigen::Index i = 0; i < matrix.rows(); ++i) {
      for (Eigen::Index j = 0; j < matrix.cols(); ++j) AddScaled(matrix(i, j), along[j], &image[i]);
    }
    return image;
  }

  double LengthOf(int interval) const { return times_[interval + 1] - times_[interval]; }

  // The derivatives of all quantities of the motion by the unknowns.
  struct Directions {
    bool moving = false;
    bool with_weak = false;  // also along which bounds and inequalities end that do not press
    SparseRows boundaries;   // of the boundaries of phases
    SparseRows initial, control, parameters;
    SparseRows variables;  // of those that no bound holds, in the order of variables_
    std::vector<FreeVariable> unbound;
  };
  bool IsHeld(size_t constraint, const Directions& to) const { return !(to.with_weak && is_weak_[constraint]); }
  // Whether an inequality of one interval leaves a direction: bounds of its two components do not.
  bool HasTangent(const IntervalCone& one) const {
    return std::ranges::all_of(one.components,
                               [&](int c) { return c >= 0 && SignOfControl(one.interval * width() + c) == 0; });
  }
  Directions DirectionsOf(bool moving, bool with_weak, QuadraticForm* form) const {
    const int E = num_events();
    Directions to;
    to.moving = moving;
    to.with_weak = with_weak;
    to.boundaries.resize(E + 2);
    to.initial.resize(input_.initial.size());
    to.control.resize(input_.control.size());
    to.parameters.resize(system_.num_parameters());
    std::vector<SparseRow> tangents(of_interval_.size());
    for (size_t i = 0; i < variables_.size(); ++i) {
      const auto& [variable, sign] = variables_[i];
      const bool is_weak = std::ranges::count(weak_variables_, i) > 0;
      if (sign != 0 && !(with_weak && is_weak)) continue;
      const int cone = variable.kind == Kind::kControl ? cone_of_[variable.index] : -1;
      SparseRow row;
      if (cone >= 0 && IsHeld(constraints_.size() - of_interval_.size() + cone, to)) {
        const IntervalCone& one = of_interval_[cone];
        if (!HasTangent(one)) continue;
        if (tangents[cone].empty()) tangents[cone] = form->AddUnknown(SizeOfVariable(variable));
        const bool first = variable.index % width() == one.components[0];
        AddScaled((first ? -one.slope[1] : one.slope[0]) / one.slope.norm(), tangents[cone], &row);
        if (row.empty()) row = {{tangents[cone][0].first, 0.0}};
      } else {
        row = form->AddUnknown(SizeOfVariable(variable));
      }
      to.variables.push_back(row);
      to.unbound.push_back(variable);
      if (variable.kind == Kind::kControl) to.control[variable.index] = row;
      if (variable.kind == Kind::kInitial) to.initial[variable.index] = row;
      if (variable.kind == Kind::kParameter) to.parameters[variable.index] = row;
      if (variable.kind == Kind::kDuration) to.boundaries[E + 1] = row;
    }
    for (int k = 0; k < E; ++k) {
      if (!moving && on_node_[k]) {
        AddScaled(boundaries_[k + 1] / input_.duration, to.boundaries[E + 1], &to.boundaries[k + 1]);
      } else {
        to.boundaries[k + 1] = form->AddUnknown(input_.duration);
      }
    }
    return to;
  }
  // Returns the size over the motion of the component that a variable is; 1 if it is zero.
  double UnitOf(const FreeVariable& variable) const {
    const double size =
        variable.kind == Kind::kInitial ? sizes_.state[input_.mode][variable.index] : sizes_.parameters[variable.index];
    return size > 0 ? size : 1.0;
  }
  // Returns the least size of the terms of a component of the control. If the component is zero but for errors of the
  // solution, so are its terms: it is the part of the loss that its change by its size would have to change.
  double LeastSizeOfControl(int component) const {
    return is_zero_[component] ? std::abs(loss_) / (input_.duration * sizes_.control[component]) : 0;
  }
  double SizeOfVariable(const FreeVariable& variable) const {
    if (variable.kind == Kind::kControl) return sizes_.control[variable.index % width()];
    if (variable.kind == Kind::kParameter) return sizes_.parameters[variable.index];
    return std::abs(variable.Access(input_));
  }

  // Returns the derivative of a time in a phase by the unknowns.
  SparseRow TimeRow(const Directions& to, double t, int phase) const {
    if (t == boundaries_[phase]) return to.boundaries[phase];
    if (t == boundaries_[phase + 1]) return to.boundaries[phase + 1];
    if (!to.moving) return Combined(t / input_.duration, to.boundaries[num_events() + 1], 0, {});
    const double part = PartOf(phase, t);
    return Combined(1 - part, to.boundaries[phase], part, to.boundaries[phase + 1]);
  }

  // Returns the second derivative by central differences of a gradient; that between the numbers before `first` is
  // zero. Numbers that change `along` no unknown have no derivatives.
  template <typename Gradient>
  static Eigen::MatrixXd SecondDerivative(const VectorXd& at, const VectorXd& sizes, const SparseRows& along,
                                          const Gradient& gradient, Eigen::Index first = 0) {
    constexpr double kWidth = 1e-5;
    Eigen::MatrixXd second = Eigen::MatrixXd::Zero(at.size(), at.size());
    for (Eigen::Index i = first; i < at.size(); ++i) {
      if (along[i].empty()) continue;
      const double width = kWidth * (sizes[i] > 0 ? sizes[i] : 1.0);
      VectorXd moved = at;
      moved[i] = at[i] + width;
      second.col(i) = gradient(moved);
      moved[i] = at[i] - width;
      second.col(i) -= gradient(moved);
      second.col(i) /= 2 * width;
    }
    second.topRightCorner(first, at.size() - first) *= 2;  // as it is in the transposed matrix once
    return 0.5 * (second + second.transpose());
  }

  // Turns a direction to where all bounds of controls that do not press allow it. Returns whether one side is so.
  bool TurnInside(std::vector<double>* direction) const {
    if (std::ranges::count(is_weak_, true) > 0) return false;
    bool forward = true, backward = true;
    for (const size_t i : weak_variables_) {
      const auto& [variable, sign] = variables_[i];
      if (variable.kind != Kind::kControl) return false;
      const double inside = sign * (*direction)[variable.index];
      forward = forward && inside >= 0;
      backward = backward && inside <= 0;
    }
    if (!forward && backward) {
      for (double& change : *direction) change = -change;
    }
    return forward || backward;
  }

  // Returns the curvature along directions that keep active bounds and inequalities. Where one of these does not press,
  // a minimum needs a positive curvature also where it ends; sets the reason if that is not so.
  std::optional<Curvature> CurvatureAlongFree(bool moving, std::string* reason) {
    const bool any_weak = !weak_variables_.empty() || std::ranges::count(is_weak_, true) > 0;
    if (any_weak) {
      std::optional<Curvature> wider = CurvatureAlong(moving, /*with_weak=*/true);
      if (wider && wider->kind == Curvature::Kind::kMinimum) return wider;
      if (wider && wider->kind == Curvature::Kind::kSaddle && TurnInside(&wider->direction)) return wider;
    }
    std::optional<Curvature> found = CurvatureAlong(moving, /*with_weak=*/false);
    if (!any_weak || (found && found->kind != Curvature::Kind::kMinimum)) return found;
    *reason = "a bound is active with a multiplier of zero, where the second derivative differs from side to side";
    return std::nullopt;
  }

  // Returns the curvature. On given intervals the second derivative differs from side to side of an event at the end of
  // an interval, where the control goes on: the smaller one counts, of all such events on either side.
  std::optional<Curvature> CurvatureAlong(bool moving, bool with_weak) {
    const double near = 0.5 * kBeside * input_.duration;
    const auto moves = [&](int k) { return !on_node_[k]; };
    if (moving || !ShiftNodes(1, near, moves)) return FindCurvature(moving, with_weak);
    std::optional<Curvature> least;
    for (const int side : {-1, 1}) {
      const HybridInput input = *ShiftNodes(side, near, moves);
      HybridConditions beside(problem_, input, options_);
      Certificate ignored;
      if (!beside.Read(&ignored) || beside.num_all() != num_all()) return std::nullopt;
      beside.theta_ = theta_;
      beside.is_weak_ = is_weak_;
      beside.weak_variables_ = weak_variables_;
      const std::optional<Curvature> found = beside.FindCurvature(moving, with_weak);
      if (!found) return std::nullopt;
      if (!least || found->smallest < least->smallest) least = found;
    }
    return least;
  }

  std::optional<Curvature> FindCurvature(bool moving, bool with_weak) {
    constexpr double kRounding = 1e-8;  // of central differences
    QuadraticForm form;
    const Directions to = DirectionsOf(moving, with_weak, &form);
    if (to.variables.empty()) {  // active bounds leave no direction
      const size_t others = FreeVariables(problem_.free, width(), /*num_intervals=*/0).size();
      return Curvature{Curvature::Kind::kMinimum, 1, std::vector<double>(input_.control.size() + others)};
    }
    AddSecondDerivatives(to, &form);
    AddMetric(to, &form);
    const Sparse second = form.Form(), equations = form.Equations(), metric = form.Metric();
    if (second.nonZeros() > 0 && !second.coeffs().allFinite()) return std::nullopt;
    ConstrainedCurvature found;
    const std::optional<ConstrainedCurvature> least =
        FindConstrainedCurvature(second, equations, metric, form.defined());
    if (!least) return std::nullopt;
    found.smallest = least->smallest;
    found.largest = least->largest;
    // The direction has the control first, then the other free variables.
    found.direction = VectorXd::Zero(input_.control.size());
    double square = 0;
    std::vector<double> others;
    for (const FreeVariable& free : FreeVariables(problem_.free, width(), /*num_intervals=*/0)) {
      others.push_back(0);
      for (size_t i = 0; i < to.unbound.size(); ++i) {
        if (to.unbound[i].kind == free.kind && to.unbound[i].index == free.index)
          others.back() = CurvatureComponent(*least, to, i);
      }
      square += others.back() * others.back();
    }
    for (size_t i = 0; i < to.unbound.size(); ++i) {
      if (to.unbound[i].kind != Kind::kControl) continue;
      const double change = CurvatureComponent(*least, to, i);
      found.direction[to.unbound[i].index] = change;
      square += LengthOf(to.unbound[i].index / width()) * change * change;
    }
    const Eigen::Index controls = found.direction.size();
    found.direction.conservativeResize(controls + static_cast<Eigen::Index>(others.size()));
    for (size_t i = 0; i < others.size(); ++i) found.direction[controls + static_cast<Eigen::Index>(i)] = others[i];
    if (square > 0) found.direction /= std::sqrt(square);
    Eigen::Index most = 0;
    found.direction.cwiseAbs().maxCoeff(&most);
    if (found.direction[most] < 0) found.direction = -found.direction;
    return ClassifyCurvature(found, kRounding);
  }
  // Returns the change of unbound variable i along the least direction.
  static double CurvatureComponent(const ConstrainedCurvature& least, const Directions& to, size_t i) {
    return to.variables[i][0].second * least.direction[to.variables[i][0].first];
  }

  // The metric of the variables is the second derivative of the costs of the control alone. A variable without such
  // costs has the loss per square of its size, a control over its share of the duration.
  void AddMetric(const Directions& to, QuadraticForm* form) const {
    VectorXd costs = VectorXd::Zero(static_cast<Eigen::Index>(input_.control.size()));
    for (const HybridShooting::TermAt& at : terms_) {
      if (at.term->role != HybridTerm::Role::kCost || at.interval < 0 || !at.term->with_control) continue;
      const auto rows = static_cast<Eigen::Index>(at.residuals.size());
      const Eigen::MatrixXd by = Eigen::Map<const Matrix>(at.jacobians[at.term->with_state].data(), rows, width());
      const Eigen::MatrixXd second = 2 * MultiplyTransposed(by, by);
      const int first = at.interval * width();
      form->AddMetric(second, {to.control.begin() + first, to.control.begin() + first + width()});
      costs.segment(first, width()) += second.diagonal();
    }
    const double unit = 2 * (loss_ != 0 ? std::abs(loss_) : 1.0);
    for (size_t i = 0; i < to.unbound.size(); ++i) {
      const FreeVariable& variable = to.unbound[i];
      const bool of_control = variable.kind == Kind::kControl;
      if (of_control && costs[variable.index] > 0) continue;
      const double of_variable = SizeOfVariable(variable), size = of_variable > 0 ? of_variable : 1;
      const double share = of_control ? LengthOf(variable.index / width()) / input_.duration : 1.0;
      form->AddMetric(Eigen::MatrixXd::Constant(1, 1, unit * share / (size * size)), {to.variables[i]});
    }
  }

  // Returns the largest change of a state with which a residual that counts in the loss, or one that violates a
  // constraint, would vanish.
  double SizeOfMisses() const {
    constexpr double kCounts = 1e-6;  // of the loss
    double size = 0;
    for (const HybridShooting::TermAt& at : terms_) {
      if (!at.term->with_state) continue;
      const auto columns = static_cast<Eigen::Index>(at.blocks[0].size());
      for (size_t row = 0; row < at.residuals.size(); ++row) {
        const double residual = at.residuals[row];
        const bool counts = at.term->IsCost() ? std::abs(at.term->LossOf(residual)) >= kCounts * std::abs(loss_)
                                              : at.term->role == HybridTerm::Role::kEquality || residual > 0;
        const double slope =
            Eigen::Map<const VectorXd>(at.jacobians[0].data() + row * columns, columns).cwiseAbs().maxCoeff();
        if (counts && slope > 0) size = std::max(size, std::abs(residual) / slope);
      }
    }
    return size;
  }

  // Finds the sizes of states by mode, of controls and of parameters over the motion. A component of the control that
  // is zero has the size that, held for the whole motion, changes a state by as much as the largest state is, or misses
  // what the costs ask for.
  void FindSizes() {
    for (int mode = 0; mode < system_.num_modes(); ++mode) {
      sizes_.state.push_back(VectorXd::Zero(system_.state_size(mode)));
    }
    sizes_.asked_state = sizes_.state;
    sizes_.asked_control = VectorXd::Zero(width());
    for (const Step& step : steps_) sizes_.state[step.mode] = sizes_.state[step.mode].cwiseMax(step.state.cwiseAbs());
    sizes_.control = VectorXd::Zero(width());
    for (size_t i = 0; i < input_.control.size(); ++i) {
      double& size = sizes_.control[static_cast<Eigen::Index>(i) % width()];
      size = std::max(size, std::abs(input_.control[i]));
    }
    sizes_.parameters = Eigen::Map<const VectorXd>(input_.parameters.data(), system_.num_parameters()).cwiseAbs();
    sizes_.parameters = sizes_.parameters.cwiseMax(options_.least_parameter);
    // The size of a free parameter that is small is that of its range.
    const HybridFree& free = problem_.free;
    for (size_t i = 0; i < free.parameters.size(); ++i) {
      double& size = sizes_.parameters[free.parameters[i]];
      const bool bounded = !free.parameters_min.empty() && !free.parameters_max.empty();
      const double half = bounded ? 0.5 * (free.parameters_max[i] - free.parameters_min[i]) : 0;
      if (std::isfinite(half)) size = std::max(size, half);
      if (size == 0) size = 1;
    }
    // The changes of a motion without its events, and their largest sizes by mode.
    std::vector<Eigen::MatrixXd> largest;
    for (const VectorXd& sizes : sizes_.state) largest.push_back(Eigen::MatrixXd::Zero(sizes.size(), width()));
    Eigen::MatrixXd change = Eigen::MatrixXd::Zero(static_cast<Eigen::Index>(input_.initial.size()), width());
    for (const Step& step : steps_) {
      const Eigen::Index n = step.by.rows();
      if (change.rows() != n) change.setZero(n, width());
      change = (step.by.leftCols(n) * change + step.by.middleCols(step.by.cols() - 1 - width(), width())).eval();
      largest[step.mode] = largest[step.mode].cwiseMax(change.cwiseAbs());
    }
    double of_states = SizeOfMisses();
    for (const VectorXd& sizes : sizes_.state) of_states = std::max(of_states, sizes.maxCoeff());
    VectorXd moved = VectorXd::Zero(width());  // the largest state, by each component
    for (const Eigen::MatrixXd& of_mode : largest) moved = moved.cwiseMax(of_mode.colwise().maxCoeff().transpose());
    for (int c = 0; c < width(); ++c) {
      const bool moves = moved[c] > kNoControl * moved.maxCoeff() && std::isfinite(moved[c]);
      const double unit = moves ? of_states / moved[c] : 0;
      is_zero_.push_back(unit > 0 && sizes_.control[c] <= kNoControl * unit);
      sizes_.asked_control[c] = unit;
      if (is_zero_.back()) sizes_.control[c] = unit;
      for (size_t mode = 0; mode < largest.size(); ++mode) {
        const VectorXd asked = unit * largest[mode].col(c);
        sizes_.asked_state[mode] = sizes_.asked_state[mode].cwiseMax(asked);
        if (is_zero_.back()) sizes_.state[mode] = sizes_.state[mode].cwiseMax(asked);
      }
    }
    for (int pass = 0; pass < kMostPasses && RaiseSizesOfRounding(); ++pass) continue;
  }

  // Raises the sizes of states that change by rounding alone along the motion, such as the speed across a thruster that
  // points up, as cos(pi / 2) is 6e-17: to what their rates give where all states and one control have changed by their
  // sizes, on the side where that is less, as rates may grow beyond all bounds on the other: so does the density of air
  // below the ground. Returns whether some size was raised, by which the rates of other states become larger.
  bool RaiseSizesOfRounding() {
    std::array<std::vector<VectorXd>, 2> reaches;  // by side and mode
    for (const int side : {0, 1}) {
      for (const VectorXd& sizes : sizes_.state) reaches[side].push_back(VectorXd::Zero(sizes.size()));
      for (const Step& step : steps_) {
        const VectorXd x =
            step.state + (2 * side - 1) * sizes_.state[step.mode].cwiseMax(sizes_.asked_state[step.mode]);
        for (int c = 0; c < width(); ++c) {
          VectorXd u = VectorXd::Zero(width()), rates(x.size());
          u[c] = std::max(sizes_.control[c], sizes_.asked_control[c]);
          functions_.Flow({step.mode, step.begin, x.data(), u.data(), input_.parameters.data()}, rates.data());
          VectorXd& reach = reaches[side][step.mode];
          if (rates.allFinite()) reach = reach.cwiseMax(input_.duration * rates.cwiseAbs());
        }
      }
    }
    bool raised = false;
    for (size_t mode = 0; mode < sizes_.state.size(); ++mode) {
      for (Eigen::Index i = 0; i < sizes_.state[mode].size(); ++i) {
        double &size = sizes_.state[mode][i], &asked = sizes_.asked_state[mode][i];
        const double change = std::min(reaches[0][mode][i], reaches[1][mode][i]);
        if (std::max(size, asked) >= kRoundedSize * change) continue;
        size = asked = change;
        raised = true;
      }
    }
    return raised;
  }

  // Adds a state as unknowns that equal `image`, the result of a step or a reset.
  static SparseRows AddState(const SparseRows& image, const VectorXd& sizes, QuadraticForm* form) {
    SparseRows state;
    for (size_t i = 0; i < image.size(); ++i) {
      state.push_back(form->AddDefined(sizes[static_cast<Eigen::Index>(i)], image[i]));
    }
    return state;
  }

  void AddSecondDerivatives(const Directions& to, QuadraticForm* form) const {
    VectorXd weights(1 + num_all());
    weights << 1, theta_;
    Costates costates{std::vector<VectorXd>(steps_.size()), std::vector<VectorXd>(num_events())};
    SweepOf(weights, &costates);
    const int P = system_.num_parameters(), m = width();
    SparseRows states = to.initial;
    RungeKutta integrator(functions_);
    int interval = 0, event = 0;
    const auto jump = [&](int k) { states = JumpForward(to, k, weights, costates, states, form); };
    for (size_t s = 0; s < steps_.size(); ++s) {
      const Step& step = steps_[s];
      for (; event < step.phase; ++event) jump(event);
      const double next = s + 1 < steps_.size() ? steps_[s + 1].begin - kSameTime * input_.duration : INFINITY;
      for (; interval < input_.num_intervals && times_[interval] < next; ++interval) {
        AddTerms(to, interval, -1, weights, sizes_.state[step.mode], states, form);
      }
      const int n = system_.state_size(step.mode), size = n + 1 + P + m + 1;
      const VectorXd& costate = costates.of_steps[s];
      const SparseRow begin_row = TimeRow(to, step.begin, step.phase);
      SparseRows along = states;
      along.push_back(begin_row);
      along.insert(along.end(), to.parameters.begin(), to.parameters.end());
      along.insert(along.end(), to.control.begin() + step.interval * m, to.control.begin() + (step.interval + 1) * m);
      along.push_back(Combined(1, TimeRow(to, step.end, step.phase), -1, begin_row));
      VectorXd at(size), sizes(size);
      at << step.state, step.begin, Eigen::Map<const VectorXd>(input_.parameters.data(), P),
          Eigen::Map<const VectorXd>(ControlOf(step.interval), m), step.end - step.begin;
      // The length of a step is scaled by the mean, as a step may be far shorter than others.
      sizes << sizes_.state[step.mode], input_.duration, sizes_.parameters, sizes_.control,
          input_.duration / static_cast<double>(steps_.size());
      form->Add(SecondDerivative(
                    at,
                    sizes,
                    along,
                    [&](const VectorXd& y) {
                      VectorXd gradient = VectorXd::Zero(size);
                      double* g = gradient.data();
                      StepCotangent by{g, 0, 0, g + n + 1, g + n + 1 + P};
                      const ModePoint begin{step.mode, y[n], y.data(), &y[n] + 1 + P, &y[n] + 1, by_parameters()};
                      integrator.PullBack({begin, y[size - 1], step.projects}, costate.data(), &by);
                      gradient[n] = by.t;
                      gradient[size - 1] = by.h;
                      return gradient;
                    },
                    functions_.IsLinear(step.mode) ? size - 1 : 0),
                along);
      states = AddState(Image(step.by, along), sizes_.state[step.mode], form);
    }
    for (; event < num_events(); ++event) jump(event);
    AddTerms(to, -1, -1, weights, sizes_.state[simulator().final_mode()], states, form);
  }

  // Adds the guard, the reset and the terms of event k; returns the derivatives of the state after it.
  SparseRows JumpForward(const Directions& to, int k, const VectorXd& weights, const Costates& costates,
                         const SparseRows& states, QuadraticForm* form) const {
    const HybridEvent& event = events()[k];
    const int n = system_.state_size(event.mode), P = system_.num_parameters(), columns = n + 1 + P;
    // The row has the control too if the guard depends on it.
    const int m = functions_.ReadsControl(event.mode, event.guard) ? width() : 0, before = interval_before_[k];
    const VectorXd& costate = costates.of_events[k];
    VectorXd after(functions_.most_states()), guard(columns + width());
    Matrix reset(functions_.most_states(), columns);
    const auto linearize = [&](const VectorXd& y) {
      const ModePoint there{event.mode, y[n], y.data(), ControlOf(before), y.data() + n + 1};
      functions_.ResetJacobian(there, event.guard, after.data(), reset.data());
    };
    const auto find_guard = [&](const VectorXd& y) {
      const double* u = m > 0 ? y.data() + columns : ControlOf(before);
      functions_.GuardGradient({event.mode, y[n], y.data(), u, y.data() + n + 1}, event.guard, guard.data());
    };
    const Eigen::Map<const VectorXd> control(ControlOf(before), m);
    VectorXd at(columns + m), sizes(columns + m);
    at << Eigen::Map<const VectorXd>(event.before.data(), n), event.time,
        Eigen::Map<const VectorXd>(input_.parameters.data(), P), control;
    sizes << at.head(n).cwiseAbs(), input_.duration, sizes_.parameters, control.cwiseAbs();
    SparseRows along = states;
    along.push_back(to.boundaries[k + 1]);
    along.insert(along.end(), to.parameters.begin(), to.parameters.end());
    along.insert(along.end(), to.control.begin() + before * width(), to.control.begin() + before * width() + m);
    form->Add(SecondDerivative(at,
                               sizes,
                               along,
                               [&](const VectorXd& y) {
                                 linearize(y);
                                 find_guard(y);
                                 VectorXd gradient = weights[1 + k] * guard.head(columns + m);
                                 gradient.head(columns) += reset.topRows(costate.size()).transpose() * costate;
                                 return gradient;
                               }),
              along);
    find_guard(at);
    const Matrix guard_row = guard.head(columns + m).transpose();
    form->AddEquation(Image(guard_row, along)[0]);
    linearize(at);
    AddTerms(to, -1, k, weights, sizes.head(n), states, form, /*before=*/true);
    along.resize(columns);
    const SparseRows image = Image(reset.topRows(costate.size()), along);
    const SparseRows next = AddState(image, sizes_.state[event.next_mode], form);
    AddTerms(to, -1, k, weights, sizes_.state[event.next_mode], next, form);
    return next;
  }

  // Adds the terms of an interval, of an event, or else of the end, and the equations of constraints that are held,
  // given the derivatives of the state that they read.
  void AddTerms(const Directions& to, int interval, int event, const VectorXd& weights, const VectorXd& state_sizes,
                const SparseRows& states, QuadraticForm* form, bool before = false) const {
    for (size_t i = 0; i < terms_.size(); ++i) {
      const HybridShooting::TermAt& at = terms_[i];
      const HybridTerm& term = *at.term;
      if (at.interval != interval || at.event != event || (event >= 0 && term.before != before)) continue;
      const auto rows = static_cast<Eigen::Index>(at.residuals.size());
      Eigen::Index size = 0;
      for (const std::vector<double>& block : at.blocks) size += static_cast<Eigen::Index>(block.size());
      VectorXd values(size), sizes(size);
      SparseRows along;
      Eigen::Index first = 0;
      size_t block = 0;
      const auto add = [&](SparseRows rows_of_block, const VectorXd& of_block) {
        const auto length = static_cast<Eigen::Index>(at.blocks[block].size());
        values.segment(first, length) = Eigen::Map<const VectorXd>(at.blocks[block++].data(), length);
        sizes.segment(first, length) = of_block.size() == length
                                           ? VectorXd(of_block.cwiseMax(values.segment(first, length).cwiseAbs()))
                                           : VectorXd(values.segment(first, length).cwiseAbs());
        along.insert(along.end(), rows_of_block.begin(), rows_of_block.end());
        first += length;
      };
      const int m = width();
      const double begin = interval >= 0 ? times_[interval] : 0, end = interval >= 0 ? times_[interval + 1] : 0;
      const SparseRow time = interval >= 0 ? TimeRow(to, begin, PhaseAt(begin, false))
                                           : to.boundaries[event >= 0 ? event + 1 : num_events() + 1];
      if (term.with_state) add(states, state_sizes);
      if (term.with_initial) add(to.initial, {});
      if (term.with_control) add({to.control.begin() + interval * m, to.control.begin() + (interval + 1) * m}, {});
      if (term.with_parameters) add(to.parameters, {});
      if (term.with_time) add({time}, VectorXd::Constant(1, input_.duration));
      if (term.with_length) add({Combined(1, TimeRow(to, end, PhaseAt(end, true)), -1, time)}, {});
      AddHeld(i, to, along, form);
      if (!RowWeights(i, Eigen::Map<const VectorXd>(at.residuals.data(), rows), weights)) continue;
      const auto gradient = [&](const VectorXd& y) {
        std::vector<const double*> blocks;
        std::vector<Matrix> jacobians;
        std::vector<double*> pointers;
        Eigen::Index start = 0;
        for (const std::vector<double>& of_block : at.blocks) {
          blocks.push_back(&y[start]);
          start += static_cast<Eigen::Index>(of_block.size());
          jacobians.emplace_back(rows, static_cast<Eigen::Index>(of_block.size()));
        }
        for (Matrix& jacobian : jacobians) pointers.push_back(jacobian.data());
        VectorXd residuals(rows), out = VectorXd::Constant(size, std::numeric_limits<double>::quiet_NaN());
        if (!at.function->Evaluate(blocks.data(), residuals.data(), pointers.data())) return out;
        const Eigen::RowVectorXd by = *RowWeights(i, residuals, weights);
        start = 0;
        for (const Matrix& jacobian : jacobians) {
          out.segment(start, jacobian.cols()) = (by * jacobian).transpose();
          start += jacobian.cols();
        }
        return out;
      };
      const Eigen::MatrixXd second = SecondDerivative(values, sizes, along, gradient);
      form->Add(second, along);
      // A convex inequality of the control alone is measured with the costs of the control.
      if (term.role == HybridTerm::Role::kInequality && ReadsControlAlone(term) && EigenOf(second).values[0] >= 0) {
        form->AddMetric(second, along);
      }
    }
  }

  // Adds the equations of the rows of a term that are held, except those of one interval, which directions keep.
  void AddHeld(size_t term, const Directions& to, const SparseRows& along, QuadraticForm* form) const {
    const HybridShooting::TermAt& at = terms_[term];
    const auto rows = static_cast<Eigen::Index>(at.residuals.size());
    for (size_t c = 0; c + of_interval_.size() < constraints_.size(); ++c) {
      const Constraint& constraint = constraints_[c];
      if (constraint.term != static_cast<int>(term) || !IsHeld(c, to)) continue;
      SparseRow row;
      size_t next = 0;
      for (const std::vector<double>& jacobian : at.jacobians) {
        const auto columns = static_cast<Eigen::Index>(jacobian.size()) / rows;
        for (Eigen::Index j = 0; j < columns; ++j)
          AddScaled(jacobian[constraint.row * columns + j], along[next++], &row);
      }
      form->AddEquation(row);
    }
  }

  // -------------------------------------------------------------------------------------------------------- conditions

  // Returns the sign that the derivative of the loss by a variable may have at its bounds; std::nullopt if it is fixed.
  static std::optional<int> SignAt(double value, double min, double max) {
    const double range = std::isfinite(max - min) ? max - min : std::max(1.0, std::abs(value));
    const bool low = value <= min + kAtBound * range, high = value >= max - kAtBound * range;
    if (low && high) return std::nullopt;
    return low ? 1 : high ? -1 : 0;
  }
  // Collects the variables that can move, with that sign.
  void FindVariables() {
    for (const FreeVariable& variable : FreeVariables(problem_.free, width(), input_.num_intervals)) {
      const bool of_control = variable.kind == Kind::kControl;
      if (of_control && LengthOf(variable.index / width()) <= kNoInterval * input_.duration) continue;
      const auto sign = SignAt(variable.Access(input_), variable.min, variable.max);
      if (sign) variables_.emplace_back(variable, *sign);
    }
  }
  std::vector<ParameterDerivative> ParameterDerivatives() const {
    std::vector<ParameterDerivative> all;
    for (int k = 0; k < system_.num_parameters(); ++k) {
      ParameterDerivative& one = all.emplace_back();
      one.value = sweeps_[0].parameters[k];
      for (int j = 0; j < num_multipliers(); ++j) one.value += theta_[j] * sweeps_[j + 1].parameters[k];
      one.size = std::max(SizeOf([&](const Sweep& s) { return s.parameters_size[k]; }),
                          std::abs(loss_) / UnitOf({FreeVariable::Kind::kParameter, k, 0, 0}));
    }
    return all;
  }
  // Returns the derivative by a variable. The duration moves the last phase alone, or scales all intervals.
  double DerivativeByVariable(const Sweep& sweep, const FreeVariable& variable, bool moving) const {
    switch (variable.kind) {
      case Kind::kControl:
        return sweep.control[variable.index];
      case Kind::kInitial:
        return sweep.initial[variable.index];
      case Kind::kParameter:
        return sweep.parameters[variable.index];
      case Kind::kDuration:
        break;
    }
    return moving ? sweep.times[num_events() + 1] : sweep.scale;
  }

  // Adds a derivative of the loss, relative to its size, as a condition.
  template <typename Of>
  void Add(const Of& of, double size, int allowed, ConeConditions* conditions, std::vector<size_t>* kind) {
    const double scale = size > 0 ? 1 / size : 1;
    Eigen::RowVectorXd columns(num_multipliers());
    for (int j = 0; j < num_multipliers(); ++j) columns[j] = scale * of(sweeps_[j + 1]);
    conditions->AddNumber(scale * of(sweeps_[0]), columns, allowed);
    kind->push_back(num_conditions_++);
  }

  struct Kinds {
    std::vector<size_t> controls, variables, events, duration;
    std::vector<size_t> at_bound;  // the places in variables_ of those whose derivative needs a sign only
    std::vector<size_t> signs;     // their conditions
  };

  // Returns the size of the terms that cancel in the derivative by a component of the control, per length.
  double ControlSize(int component) const {
    // Where a component has no effect its terms are errors of the solution, which do not cancel.
    const double size = SizeOf(
        [&](const Sweep& s) { return std::max(s.control_size[component], kSmallTerms * s.control_size.maxCoeff()); });
    return std::max(size, LeastSizeOfControl(component));
  }

  void AddVariables(bool moving, ConeConditions* conditions, Kinds* kinds) {
    num_conditions_ = 0;
    AddCones(conditions);
    for (size_t i = 0; i < variables_.size(); ++i) {
      const auto& [variable, sign] = variables_[i];
      const bool of_control = variable.kind == Kind::kControl, of_duration = variable.kind == Kind::kDuration;
      if (of_control && cone_of_[variable.index] >= 0) continue;
      const double length = of_control ? LengthOf(variable.index / width()) : 1;
      double size =
          of_control ? ControlSize(variable.index % width()) : SizeOf([&, &variable = variable](const Sweep& s) {
            return variable.kind == Kind::kInitial     ? s.initial_size[variable.index]
                   : variable.kind == Kind::kParameter ? s.parameters_size[variable.index]
                                                       : s.hamiltonian_size;
          });
      if (!of_control && !of_duration) size = std::max(size, std::abs(loss_) / UnitOf(variable));
      if (sign != 0) {
        kinds->at_bound.push_back(i);
        kinds->signs.push_back(num_conditions_);
      }
      Add([&, &variable = variable](const Sweep& s) { return DerivativeByVariable(s, variable, moving) / length; },
          size,
          sign,
          conditions,
          of_control    ? &kinds->controls
          : of_duration ? &kinds->duration
                        : &kinds->variables);
    }
    // Multipliers of inequalities are not negative, in parts of the conditions that they enter.
    for (size_t c = 0; num_events() + static_cast<int>(c) < num_multipliers(); ++c) {
      if (!constraints_[c].inequality) continue;
      const Eigen::Index at = num_events() + static_cast<Eigen::Index>(c);
      const double part = conditions->LargestColumn(at);
      conditions->AddNumber(0, (part > 0 ? part : 1) * Eigen::RowVectorXd::Unit(num_multipliers(), at), 1);
      kinds->variables.push_back(num_conditions_++);
    }
  }

  // Returns the largest product of a multiplier and the residual of its constraint, in parts of the loss: what the loss
  // would change by if that were zero, whatever the unit of the constraint. It tells inequalities that are not active,
  // and constraints that are violated.
  double Complementarity() const {
    double largest = 0;
    for (size_t c = 0; c < constraints_.size(); ++c) {
      if (constraints_[c].term < 0) continue;
      const double residual = terms_[constraints_[c].term].residuals[constraints_[c].row];
      largest = std::max(largest, std::abs(theta_[num_events() + static_cast<Eigen::Index>(c)] * residual));
    }
    return loss_ != 0 ? largest / std::abs(loss_) : 0;
  }

  // Adds the conditions of the intervals in which an inequality of the control alone is active.
  void AddCones(ConeConditions* conditions) {
    size_t count = 0;
    for (IntervalCone& one : of_interval_) {
      const double length = LengthOf(one.interval);
      Vec2d value = Vec2d::Zero();
      Eigen::Matrix2Xd columns = Eigen::Matrix2Xd::Zero(2, num_multipliers());
      std::vector<Vec2d> normals = {one.slope.normalized()};
      one.size = 0;
      for (const int c : one.components) one.size = std::max(one.size, c < 0 ? 0 : ControlSize(c));
      one.size = length * (one.size > 0 ? one.size : 1);
      for (int j = 0; j < 2; ++j) {
        const int component = one.components[j], index = one.interval * width() + component;
        const std::optional<int> sign = component < 0 ? std::nullopt : SignOfControl(index);
        if (!sign) continue;  // the condition of a number that is fixed or absent holds
        if (*sign != 0) normals.push_back(-*sign * Vec2d::Unit(j));
        value[j] = sweeps_[0].control[index] / one.size;
        for (int i = 0; i < num_multipliers(); ++i) columns(j, i) = sweeps_[i + 1].control[index] / one.size;
      }
      one.condition = count++;
      conditions->AddForce(value, columns, std::move(normals));
    }
  }
  std::optional<int> SignOfControl(int index) const {
    const HybridFree& free = problem_.free;
    if (LengthOf(index / width()) <= kNoInterval * input_.duration) return std::nullopt;
    if (free.control_min.empty()) return 0;
    return SignAt(input_.control[index], free.control_min[index % width()], free.control_max[index % width()]);
  }

  // Keeps the multipliers that were found, and which bounds and inequalities do not press.
  void Keep(const Kinds& kinds, ConeConditions* found) {
    KeepAt(kinds, *found);
    const bool any_weak = !weak_variables_.empty() || std::ranges::count(is_weak_, true) > 0;
    if (any_weak && found->SolveStrictly(10 * kNoMultiplier)) KeepAt(kinds, *found);
  }
  void KeepAt(const Kinds& kinds, const ConeConditions& conditions) {
    theta_.resize(num_all());
    theta_.head(num_multipliers()) = conditions.theta();
    is_weak_.assign(constraints_.size(), false);
    for (size_t c = 0; c < constraints_.size(); ++c) {
      const Eigen::Index at = num_events() + static_cast<Eigen::Index>(c);
      double part = 0;
      if (at < num_multipliers()) {
        part = conditions.LargestColumn(at) * std::abs(theta_[at]);
      } else {
        const IntervalCone& one = of_interval_[at - num_multipliers()];
        part = std::max(0.0, -conditions.Force(one.condition).dot(one.slope.normalized()));
        theta_[at] = part * one.size / one.slope.norm();
      }
      is_weak_[c] = constraints_[c].inequality && constraints_[c].term >= 0 && part <= kNoMultiplier;
    }
    weak_variables_.clear();
    for (size_t i = 0; i < kinds.signs.size(); ++i) {
      if (std::abs(conditions.Value(kinds.signs[i])) <= kNoMultiplier) weak_variables_.push_back(kinds.at_bound[i]);
    }
  }

  // Returns the size of the terms that cancel in a derivative, with the multipliers found up to now. The costates of
  // events that follow each other closely are large and cancel, and count together.
  template <typename Of>
  double SizeOf(const Of& of) const {
    double size = of(sweeps_[0]) + of(events_together_);
    for (Eigen::Index j = num_events(); j < num_multipliers(); ++j) size += std::abs(of_sizes_[j]) * of(sweeps_[j + 1]);
    return size;
  }
  double HamiltonianSize() const {
    return SizeOf([](const Sweep& s) { return s.hamiltonian_size; });
  }
  void SetMultipliersOfSizes(const VectorXd& theta) {
    of_sizes_ = theta;
    VectorXd weights = VectorXd::Zero(1 + num_all());
    weights.segment(1, num_events()) = theta.head(num_events());
    events_together_ = SweepOf(weights);
  }

  // Whether the control does not jump at the beginning of interval k: an event there is as one within an interval.
  bool IsControlContinuous(int k) const {
    if (k == 0 || k == input_.num_intervals) return false;
    const auto width = static_cast<std::ptrdiff_t>(system_.num_controls());
    const auto after = input_.control.begin() + k * width;
    return input_.control.empty() || std::equal(after - width, after, after);
  }

  static double Largest(const ConeConditions& conditions, const std::vector<size_t>& of) {
    double largest = 0;
    for (const size_t i : of) largest = std::max(largest, std::abs(conditions.Number(i)));
    return largest;
  }

  void StationarityOnMovingGrid(Certificate* result) {
    ConeConditions conditions(num_multipliers());
    Kinds kinds;
    AddVariables(true, &conditions, &kinds);
    for (int k = 0; k < num_events(); ++k) {
      Add([&](const Sweep& s) { return s.times[k + 1]; }, HamiltonianSize(), 0, &conditions, &kinds.events);
    }
    conditions.Solve();
    Keep(kinds, &conditions);
    SetMultipliersOfSizes(theta_);
    result->stationarity = std::max(Largest(conditions, kinds.controls), conditions.LargestForce());
    result->transversality = std::max(Largest(conditions, kinds.variables), Complementarity());
    if (!kinds.duration.empty()) result->final_time = conditions.Number(kinds.duration[0]);
    result->hamiltonian = std::max(Largest(conditions, kinds.events), Largest(conditions, kinds.duration));
    for (int k = 0; k < num_events(); ++k) {
      result->impacts[k].multiplier = conditions.theta()[k];
      result->impacts[k].hamiltonian = conditions.Number(kinds.events[k]);
    }
    PlaceMultipliers(/*moving=*/true, result);
  }

  void StationarityOnFixedGrid(Certificate* result) {
    // Behind an event at the final time the motion has none, and the loss another one-sided derivative.
    for (int k = 0; k < num_events(); ++k) {
      if (IsAtEnd(k) && !IsHeldBeforeEnd(k)) return;
    }
    // Multipliers of events inside intervals are those that the saltation matrix has; of those at the ends of intervals
    // any between the one-sided ones: the loss rises as the event becomes early, and late.
    ConeConditions conditions(num_multipliers());
    Kinds kinds;
    AddVariables(false, &conditions, &kinds);
    for (int k = 0; k < num_events(); ++k) {
      if (IsAtEnd(k)) {
        Add([&](const Sweep& s) { return s.event_early[k]; }, HamiltonianSize(), 0, &conditions, &kinds.events);
        continue;
      }
      if (on_node_[k] && (!FallsOnBothSides(k) || IsAtGivenTime(k, /*moving=*/false))) continue;
      const int sign = on_node_[k] ? 1 : 0;
      if (sign != 0) {
        Add([&](const Sweep& s) { return s.event_early[k]; }, HamiltonianSize(), -sign, &conditions, &kinds.events);
      }
      if (sign != 0 && WaitsForControl(k)) {
        Eigen::RowVectorXd one = Eigen::RowVectorXd::Zero(num_multipliers());
        one[k] = 1;
        conditions.AddNumber(0, one, -sign);
        kinds.events.push_back(num_conditions_++);
        continue;
      }
      Add([&](const Sweep& s) { return s.event_late[k]; }, HamiltonianSize(), sign, &conditions, &kinds.events);
    }
    conditions.Solve();
    Keep(kinds, &conditions);
    result->gradient = std::max({Largest(conditions, kinds.controls),
                                 conditions.LargestForce(),
                                 Complementarity(),
                                 Largest(conditions, kinds.variables),
                                 Largest(conditions, kinds.events),
                                 Largest(conditions, kinds.duration)});
    PlaceMultipliers(/*moving=*/false, result);
  }

  // Whether an event is at a time that is given, as that of a waypoint, and so cannot leave the end of an interval: to
  // first order its guard depends on time alone, and the interval ends where the input says, or at the event as
  // intervals move with events. A free duration would move the ends of intervals that do not.
  bool IsAtGivenTime(int k, bool moving) const {
    const auto is_duration = [](const auto& one) { return one.first.kind == Kind::kDuration; };
    if (!moving && std::ranges::any_of(variables_, is_duration)) return false;
    const HybridEvent& event = events()[k];
    const ModePoint at{
        event.mode, event.time, event.before.data(), ControlOf(interval_before_[k]), input_.parameters.data()};
    VectorXd gradient(system_.state_size(event.mode) + 1 + system_.num_parameters() + system_.num_controls());
    functions_.GuardGradient(at, event.guard, gradient.data());
    gradient[system_.state_size(event.mode)] = 0;
    return gradient.isZero(0);
  }

  bool IsAtEnd(int k) const { return events()[k].time >= times_.back() - kAtNode * LengthOf(input_.num_intervals - 1); }
  // Whether a constraint keeps motions on the side of the final time on which they have an event.
  bool IsHeldBeforeEnd(int k) const {
    return std::ranges::any_of(constraints_, [&](const Constraint& constraint) {
      return constraint.term >= 0 && constraint.inequality && terms_[constraint.term].event == k &&
             terms_[constraint.term].term->with_time;
    });
  }

  // Whether a guard falls with the control before its event, and with that after it.
  bool FallsOnBothSides(int k) const {
    return sweeps_[k + 1].event_early[k] < 0 && (WaitsForControl(k) || sweeps_[k + 1].event_late[k] < 0);
  }

  // Returns the value of a guard at its event, under the control that acts after it.
  double GuardUnderNextControl(int k) const {
    const HybridEvent& event = events()[k];
    return functions_.Guard(
        {event.mode, event.time, event.before.data(), ControlOf(interval_after_[k]), input_.parameters.data()},
        event.guard);
  }
  // Whether a guard that reads the control is below zero under that which begins at its event. As the event becomes
  // late it then stays at the node, whatever the value of the guard before, and the multiplier of that side is zero.
  bool WaitsForControl(int k) const {
    return on_node_[k] && functions_.ReadsControl(events()[k].mode, events()[k].guard) &&
           GuardUnderNextControl(k) < -kOfGuard * GuardSize(k);
  }
  // Returns the change of a guard in the duration, at the rate of its event.
  double GuardSize(int k) const { return std::abs(events()[k].rate) * input_.duration; }

  // Whether the loss jumps as an event leaves its node: a term there reads the state, which the event changes, or the
  // guard is above zero under the control that begins there, and has no event then.
  bool JumpsAtNode(int k) const {
    const HybridEvent& event = events()[k];
    if (node_[k] < 0 || node_[k] >= input_.num_intervals || HoldsAlways() != nullptr) return false;
    if (IsAtGivenTime(k, /*moving=*/false)) return false;
    if (on_node_[k] && functions_.ReadsControl(event.mode, event.guard) &&
        GuardUnderNextControl(k) > kOfGuard * GuardSize(k)) {
      return true;
    }
    return shooting_.FindJumpingTerm(k, node_[k], std::abs(loss_)) != nullptr;
  }

  // Returns the multipliers with which the loss does not change as events move, whose intervals stay: as if those at
  // ends of intervals were early, or late. Multipliers of constraints are those that were found.
  VectorXd OneSided(bool early) const {
    VectorXd theta = theta_.head(num_multipliers());
    for (int k = num_events() - 1; k >= 0; --k) {  // that of an earlier event has no part in a later one
      const auto by = [&](const Sweep& s) { return early ? s.event_early[k] : s.event_late[k]; };
      double sum = by(sweeps_[0]);
      for (int j = k + 1; j < num_multipliers(); ++j) sum += theta[j] * by(sweeps_[j + 1]);
      theta[k] = !early && WaitsForControl(k) ? 0 : -sum / by(sweeps_[k + 1]);
    }
    return theta;
  }

  // Sets the gradients by the control on the given intervals: that by the components which no bound holds, relative to
  // its terms, and with events at ends of intervals early, late, and with the multipliers that were found.
  void SetGridGradients(Certificate* result) const {
    for (const auto& [variable, sign] : variables_) {
      if (variable.kind != Kind::kControl || sign != 0 || cone_of_[variable.index] >= 0 || !result->IsStationary()) {
        continue;
      }
      double by = sweeps_[0].control[variable.index];
      for (int j = 0; j < num_multipliers(); ++j) by += theta_[j] * sweeps_[j + 1].control[variable.index];
      const int interval = variable.index / width();
      const double relative = std::abs(by) / (LengthOf(interval) * ControlSize(variable.index % width()));
      if (std::isfinite(relative)) result->gradient = std::max(result->gradient.value_or(0), relative);
    }
    const auto has_theta = [](const ImpactCertificate& impact) { return impact.theta.has_value(); };
    if (!problem_.free.control || std::ranges::none_of(result->impacts, has_theta)) return;
    const auto largest = [&](const VectorXd& theta) {
      VectorXd gradient = sweeps_[0].control;
      for (int j = 0; j < num_multipliers(); ++j) gradient += theta[j] * sweeps_[j + 1].control;
      return gradient.lpNorm<Eigen::Infinity>();
    };
    result->gradient_early = largest(OneSided(true));
    result->gradient_late = largest(OneSided(false));
    result->gradient_combined = largest(theta_);
  }

  // Finds where the multipliers of events on nodes lie between the one-sided ones: those of a guard that begins to fall
  // before, or after, the node.
  void PlaceMultipliers(bool moving, Certificate* result) const {
    const auto combined = [&](const auto& of) {
      double sum = of(sweeps_[0]);
      for (int j = 0; j < num_multipliers(); ++j) sum += theta_[j] * of(sweeps_[j + 1]);
      return sum;
    };
    for (int k = 0; k < num_events(); ++k) {
      ImpactCertificate& impact = result->impacts[k];
      impact.theta.reset();
      impact.concave = false;
      // Where a free control goes on at the node, as between two intervals at a bound, both sides have one multiplier.
      const bool judged = on_node_[k] || (node_[k] > 0 && problem_.free.control);
      if (!judged || !FallsOnBothSides(k) || IsAtGivenTime(k, moving) || HoldsAlways() != nullptr) continue;
      // A multiplier enters these times the rate of the guard; they vanish at the one-sided multipliers.
      const double rate_early = sweeps_[k + 1].event_early[k], rate_late = sweeps_[k + 1].event_late[k];
      const double early = combined([&](const Sweep& s) { return s.event_early[k]; });
      const double late = combined([&](const Sweep& s) { return s.event_late[k]; });
      const double nu = -rate_early * theta_[k];  // in the unit of the Hamiltonian
      const double nu_late = WaitsForControl(k) ? 0 : nu + late * rate_early / rate_late;
      SetTheta(nu + early, nu_late, nu, HamiltonianSize() * impact.time, &impact);
    }
  }

  const HybridProblem& problem_;
  HybridInput input_;
  const ConditionsOptions& options_;
  const std::vector<GuardTouch>& touches_;
  const HybridSystem& system_;
  const HybridFunctions& functions_;
  HybridShooting shooting_;
  RungeKutta integrator_;
  std::vector<double> times_;       // of the ends of control intervals
  std::vector<double> boundaries_;  // of the phases
  std::vector<Step> steps_;
  std::vector<int> node_;                              // of each event: the end of an interval at which it is, or -1
  std::vector<bool> on_node_;                          // of each event: it is where the control jumps, or at an end
  std::vector<int> interval_before_, interval_after_;  // of each event: whose control acts
  std::vector<HybridShooting::TermAt> terms_;
  std::vector<std::pair<FreeVariable, int>> variables_;  // that can move, each with its sign (SignAt)
  std::vector<Constraint> constraints_;
  std::vector<IntervalCone> of_interval_;  // the last of the constraints
  std::vector<int> cone_of_;               // of each number of the control: the constraint of its interval, or -1
  std::vector<Sweep> sweeps_;              // of the objective, and of each multiplier
  VectorXd of_sizes_;                      // the multipliers that sizes are taken with
  Sweep events_together_;                  // of all events, with these multipliers
  VectorXd theta_;                         // the multipliers, of all constraints
  std::vector<bool> is_weak_;              // of each constraint: an inequality that does not press
  std::vector<size_t> weak_variables_;     // places of variables_ at bounds that do not press
  MotionSizes sizes_;
  std::vector<bool> is_zero_;  // of each component of the control: all the time
  size_t num_conditions_ = 0;
  double loss_ = 0;
};

}  // namespace

std::shared_ptr<const ceres::CostFunction> WithFactors(std::shared_ptr<const ceres::CostFunction> function,
                                                       VectorXd factors) {
  return std::make_shared<ScaledRows>(std::move(function), std::move(factors));
}

Certificate CertifyConditions(const HybridProblem& problem, const HybridInput& input,
                              const ConditionsOptions& options) {
  return HybridConditions(problem, input, options).Run();
}

std::optional<HybridInput> AfterNewtonStep(const HybridProblem& problem, const HybridInput& input, bool moving) {
  return HybridConditions(problem, input, {}).NewtonStep(moving);
}

std::optional<MotionSizes> SizesOf(const HybridProblem& problem, const HybridInput& input) {
  return HybridConditions(problem, input, {}).Sizes();
}

HybridProblem ScaleConstraints(HybridProblem problem, const HybridInput& input) {
  constexpr double kSmall = 0.1, kLarge = 500;
  if (std::ranges::all_of(problem.terms, &HybridTerm::IsCost)) return problem;
  std::vector<VectorXd> sizes;
  {
    HybridConditions conditions(problem, input, {});
    if (!conditions.Sizes()) return problem;
    sizes = conditions.SizesOfConstraints();
  }
  for (size_t i = 0; i < sizes.size(); ++i) {  // the rows of the function itself, of a term that holds at all times
    const Eigen::Index count = problem.terms[i].function->num_residuals();
    sizes[i] = VectorXd(sizes[i].head(count).cwiseMax(sizes[i].tail(count)));
  }
  for (size_t i = 0; i < sizes.size(); ++i) {
    const VectorXd factors =
        sizes[i].unaryExpr([](double size) { return size == 0 || (size >= kSmall && size <= kLarge) ? 1 : 1 / size; });
    if (factors.isOnes(0)) continue;
    problem.terms[i].function = WithFactors(problem.terms[i].function, factors);
  }
  return problem;
}

Certificate Certify(const HybridProblem& given, const HybridInput& input) {
  Certificate wrong;
  wrong.reason = Validate(input, given.system);
  if (wrong.reason.empty() && input.begin != 0) wrong.reason = "the motion does not begin at time 0";
  if (!wrong.reason.empty()) return wrong;
  const HybridProblem problem = ScaleConstraints(given, input);
  Certificate certificate = CertifyConditions(problem, input, {});
  const bool smooth = certificate.verdict != Certificate::Verdict::kNotApplicable &&
                      certificate.verdict != Certificate::Verdict::kNotStationary;
  if (smooth) return certificate;
  Certificate kinks = CertifyKinks(problem, input);
  return kinks.verdict == Certificate::Verdict::kNotApplicable ? certificate : kinks;
}

}  // namespace saltus
