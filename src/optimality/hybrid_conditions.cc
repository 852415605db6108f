// The conditions of saltus/optimality/hybrid_certificate.h, from the steps of the exact motion.
//
// With multipliers theta of events, equalities and active inequalities, the derivatives of the Lagrangian by controls,
// initial state, parameters, the times of the events and the final time are affine in theta: one backward sweep through
// the motion for the objective, and one for each multiplier. Those theta are found that leave least of all conditions
// (cone_conditions.h).
#include <ceres/cost_function.h>

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <limits>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "control/hybrid_shooting.h"
#include "hybrid/free_variables.h"
#include "hybrid/runge_kutta.h"
#include "optimality/cone_conditions.h"
#include "optimality/optimality_conditions.h"
#include "saltus/optimality/hybrid_certificate.h"

namespace saltus {
namespace {

using Matrix = RungeKutta::Matrix;
using Kind = FreeVariable::Kind;
using Eigen::VectorXd;

constexpr double kAtBound = 1e-6;      // of a bound's range, or an inequality's violation that counts as active
constexpr double kAtNode = 1e-6;       // of an interval: an event so near to its end is at it
constexpr double kSameTime = 1e-14;    // of the duration
constexpr double kNoInterval = 1e-9;   // of the duration: of an interval so short nothing is asked
constexpr double kSmallTerms = 0.01;   // of the largest size of a component of the control: the least of a component
constexpr int kMostMultipliers = 200;  // of which conditions are looked at

// A step of the motion, from `begin` to `end`, with its derivatives [x t p u h].
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
  // By the times of the events while the ends of intervals stay, with the control before (after) the event on both of
  // its sides.
  VectorXd event_early, event_late;
  double scale = 0;  // by the duration, with all intervals scaled
  // Sizes of what cancels: of controls by component, of states at the start, of the Hamiltonian.
  VectorXd control_size, initial_size, parameters_size;
  double hamiltonian_size = 0;
};

class HybridConditions {
 public:
  HybridConditions(const HybridProblem& problem, const HybridInput& input)
      : problem_(problem),
        input_(input),
        system_(problem.system),
        functions_(system_.functions()),
        shooting_(problem),
        integrator_(functions_) {
    if (input_.control.empty()) input_.control.assign(input_.num_intervals * width(), 0.0);
  }

  Certificate Run() {
    Certificate result;
    HybridShooting::Outcome outcome;
    if (!shooting_.Simulate(input_, &outcome)) {
      result.reason = shooting_.WhyFailed();
      return result;
    }
    if (result.reason = WhyNot(); !result.reason.empty()) return result;
    for (const HybridTie& tie : simulator().ties()) {
      if (!tie.ambiguous) continue;
      result.verdict = Certificate::Verdict::kAmbiguous;
      result.reason = std::to_string(tie.guards.size()) + " guards reach zero at t = " + std::to_string(tie.time) +
                      ", and the order of their events matters";
      return result;
    }
    if (!shooting_.EvaluateTerms(&terms_)) {
      result.reason = "a term has no derivative";
      return result;
    }
    if (outcome.violation <= kAtBound && IsZero()) {
      result.verdict = Certificate::Verdict::kGlobal;
      result.reason = "the loss is zero within rounding, and a sum of squares is not less";
      return result;
    }
    ReadMotion();
    FindVariables();
    FindMultipliers();
    if (num_multipliers() > kMostMultipliers) {
      result.reason = "more than " + std::to_string(kMostMultipliers) + " multipliers";
      return result;
    }
    for (int j = -1; j < num_multipliers(); ++j) sweeps_.push_back(SweepOf(WeightsOf(j)));
    weights_.assign(sweeps_.size(), 1.0);
    for (size_t k = 0; k < events().size(); ++k) {
      ImpactCertificate& impact = result.impacts.emplace_back();
      const HybridEvent& event = events()[k];
      impact.time = event.time;
      impact.a = system_.ModeName(event.mode);
      impact.b = system_.GuardName(event.mode, event.guard);
      impact.speed = -event.rate;
      impact.on_node = on_node_[k];
    }
    OfMovingGrid(&result);
    OfMovingGrid(&result);  // with the sizes that the multipliers give
    Judge(&result);
    const bool moving = result.IsStationary();
    if (!moving) {
      OfFixedGrid(&result);
      Judge(&result);
    }
    if (result.IsStationary()) {
      result.curvature = FindCurvature(moving);
      Judge(&result);
    }
    return result;
  }

 private:
  const HybridSimulator& simulator() const { return const_cast<HybridShooting&>(shooting_).simulator(); }
  const std::vector<HybridEvent>& events() const { return simulator().events(); }
  int num_events() const { return static_cast<int>(events().size()); }
  int num_multipliers() const { return num_events() + static_cast<int>(constraints_.size()); }
  int width() const { return system_.num_controls(); }
  const double* ControlOf(int interval) const { return input_.control.data() + interval * width(); }

  std::string WhyNot() const {
    for (const HybridEvent& event : events()) {
      if (event.at_once) return "guards have transitions at once; the conditions are those of events that take time";
    }
    for (const HybridGrazing& grazing : simulator().grazings()) {
      return "guard '" + system_.GuardName(grazing.mode, grazing.guard) +
             "' grazes zero at t = " + std::to_string(grazing.time) +
             "; the conditions are those of events that cross it";
    }
    return "";
  }

  // Whether the residuals of all costs are of the size of rounding errors of the motion.
  bool IsZero() const {
    constexpr double kRounding = 1e-10;
    for (const HybridShooting::TermAt& at : terms_) {
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
      if (end > begin) steps_.push_back(Linearized(i, IntervalAt(0.5 * (begin + end)), phase, begin, end));
    }
    for (const HybridEvent& event : events()) {
      const auto next = std::upper_bound(times_.begin(), times_.end(), event.time);
      auto k = static_cast<int>(next - times_.begin());
      if (k == static_cast<int>(times_.size()) || event.time - times_[k - 1] < times_[k] - event.time) --k;
      const double length = k > 0 ? times_[k] - times_[k - 1] : times_[1];
      const bool at_node = std::abs(event.time - times_[k]) <= kAtNode * length;
      on_node_.push_back(at_node);
      const int interval = IntervalAt(event.time);
      interval_before_.push_back(at_node ? std::max(k - 1, 0) : interval);
      interval_after_.push_back(at_node ? std::min(k, input_.num_intervals - 1) : interval);
    }
  }

  int IntervalAt(double t) const {
    const auto next = std::upper_bound(times_.begin(), times_.end(), t);
    return std::clamp(static_cast<int>(next - times_.begin()) - 1, 0, input_.num_intervals - 1);
  }

  Step Linearized(int i, int interval, int phase, double begin, double end) {
    const int mode = simulator().StepMode(i), n = system_.state_size(mode);
    // A step to an event is projected by the reset.
    const bool to_event = i + 1 < simulator().num_steps() && simulator().IsReset(i + 1);
    Step step{mode, interval, phase, functions_.Projects(mode) && !to_event, begin, end, VectorXd(n), {}};
    std::copy_n(simulator().StepState(i).data(), n, step.state.data());
    const ModePoint at{mode, begin, step.state.data(), ControlOf(interval), input_.parameters.data()};
    step.by = integrator_.Jacobian({at, end - begin, step.projects});
    return step;
  }

  // ------------------------------------------------------------------------------------------------------- multipliers

  struct Constraint {
    int term = 0, row = 0;  // of terms_
    bool inequality = false;
  };

  void FindMultipliers() {
    for (size_t i = 0; i < terms_.size(); ++i) {
      const HybridShooting::TermAt& at = terms_[i];
      if (at.term->role == HybridTerm::Role::kCost) continue;
      const bool inequality = at.term->role == HybridTerm::Role::kInequality;
      for (size_t row = 0; row < at.residuals.size(); ++row) {
        if (inequality && at.residuals[row] < -kAtBound) continue;
        constraints_.push_back({static_cast<int>(i), static_cast<int>(row), inequality});
      }
    }
  }

  // Of the objective and all multipliers: the weights of one of them alone, or of the Lagrangian.
  VectorXd WeightsOf(int multiplier) const { return VectorXd::Unit(1 + num_multipliers(), 1 + multiplier); }

  // The derivative of what a term adds to the Lagrangian by its rows; nothing if it adds nothing.
  std::optional<Eigen::RowVectorXd> RowWeights(size_t term, const VectorXd& residuals, const VectorXd& weights) const {
    if (terms_[term].term->role == HybridTerm::Role::kCost) {
      if (weights[0] == 0) return std::nullopt;
      return Eigen::RowVectorXd(2 * weights[0] * residuals.transpose());
    }
    Eigen::RowVectorXd rows = Eigen::RowVectorXd::Zero(residuals.size());
    for (size_t c = 0; c < constraints_.size(); ++c) {
      if (constraints_[c].term == static_cast<int>(term)) rows[constraints_[c].row] = weights[1 + num_events() + c];
    }
    if (rows.isZero(0)) return std::nullopt;
    return rows;
  }
  // The same by what the term reads.
  struct Source {
    VectorXd state, control, parameters;
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
    if (at.term->with_control) source.control = next();
    if (at.term->with_parameters) source.parameters = next();
    if (at.term->with_time) source.time = next()[0];
    if (at.term->with_length) source.length = next()[0];
    return source;
  }

  // ------------------------------------------------------------------------------------------------------------ sweeps

  // Where in a phase a time is: 0 at its beginning, 1 at its end.
  double PartOf(int phase, double t) const {
    const double begin = boundaries_[phase], length = boundaries_[phase + 1] - begin;
    return length > 0 ? std::clamp((t - begin) / length, 0.0, 1.0) : 1.0;
  }

  // Adds the derivative by a time that is not a boundary of phases but lies in one, as these move.
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

  // Costates that a sweep leaves: after each step, and after each event and what terms read there.
  struct Costates {
    std::vector<VectorXd> of_steps, of_events;
  };

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
    // Backwards.
    VectorXd costate = VectorXd::Zero(system_.state_size(simulator().final_mode()));
    for (const Source& source : at_end) {
      if (source.state.size() > 0) costate += source.state;
    }
    VectorXd by_flow = VectorXd::Zero(K * m);
    int event = num_events() - 1, interval = K;
    // Of the states at the beginnings of intervals that are not before `time`.
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
      const double by_h = by[n + 1 + P + m], by_t = by[n];
      sweep.hamiltonian_size =
          std::max(sweep.hamiltonian_size, (costate.cwiseProduct(step.by.col(n + 1 + P + m))).cwiseAbs().sum());
      AddTime(step.begin, step.phase, by_t - by_h, &sweep.times);
      AddTime(step.end, step.phase, by_h, &sweep.times);
      sweep.scale += (by_t * step.begin + by_h * (step.end - step.begin)) / input_.duration;
      by_flow.segment(step.interval * m, m) += by.segment(n + 1 + P, m).transpose();
      sweep.parameters += by.segment(n + 1, P).transpose();
      sweep.parameters_size += by.segment(n + 1, P).transpose().cwiseAbs();
      costate = by.head(n).transpose();
      add_interval_states(step.begin);
    }
    for (; event >= 0; --event) JumpBack(event, weights[1 + event], at_event, &sweep, &by_flow, &costate, costates);
    sweep.initial = costate;
    sweep.initial_size = costate.cwiseAbs();
    sweep.control += by_flow;
    for (int i = 0; i < K * m; ++i) {
      const double length = times_[i / m + 1] - times_[i / m];
      if (length <= kNoInterval * input_.duration) continue;
      double& size = sweep.control_size[i % m];
      size = std::max(size, (std::abs(own_control[i]) + std::abs(by_flow[i])) / length);
    }
    return sweep;
  }

  // The costate before event k from that after it; by_flow is the derivative by the control.
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
    add(false);
    VectorXd after(functions_.most_states());
    Matrix reset(functions_.most_states(), columns);
    const ModePoint at{event.mode, event.time, event.before.data(), control, input_.parameters.data()};
    functions_.ResetJacobian(at, event.guard, after.data(), reset.data());
    const VectorXd costate_after = *costate;
    if (costates != nullptr) costates->of_events[k] = costate_after;
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
    // Of the event alone, with one control on both sides: H before less H after.
    const auto one_sided = [&](const double* u) {
      VectorXd in(n), out(costate_after.size());
      functions_.Flow({event.mode, event.time, event.before.data(), u, at.p}, in.data());
      functions_.Flow({event.next_mode, event.time, event.after.data(), u, at.p}, out.data());
      return by_time + costate->dot(in) - costate_after.dot(out);
    };
    sweep->event_early[k] = one_sided(ControlOf(interval_before_[k]));
    sweep->event_late[k] = one_sided(ControlOf(interval_after_[k]));
  }

  // ------------------------------------------------------------------------------------------------- second derivative
  //
  // Of the Lagrangian along the variables that no bound holds. It is the sum over steps, resets, guards and terms of
  // V^T W V, with the second derivative W of what each adds by what it reads, weighted by the costate behind it, and
  // the derivative V of what it reads by the variables. W is by central differences of exact first derivatives. Times
  // of events follow from their guards, and what holds constraints restricts the directions.

  std::vector<FreeVariable> UnboundVariables() const {
    std::vector<FreeVariable> unbound;
    for (const auto& [variable, sign] : variables_) {
      if (sign == 0) unbound.push_back(variable);
    }
    return unbound;
  }
  double LengthOf(int interval) const { return times_[interval + 1] - times_[interval]; }

  // The derivatives by the variables of times, of what holds constraints and of states.
  struct Directions {
    bool moving = false;
    Eigen::MatrixXd boundaries;  // of the boundaries of phases
    Eigen::MatrixXd held;        // of constraints, and of guards of events that are held at the ends of intervals
    Eigen::MatrixXd initial, control, parameters;
  };
  // Nothing if times of events have no derivative.
  std::optional<Directions> DirectionsOf(const std::vector<FreeVariable>& variables, bool moving) const {
    const auto count = static_cast<Eigen::Index>(variables.size());
    const int E = num_events();
    Directions to;
    to.moving = moving;
    to.boundaries = Eigen::MatrixXd::Zero(E + 2, count);
    to.initial = Eigen::MatrixXd::Zero(input_.initial.size(), count);
    to.control = Eigen::MatrixXd::Zero(input_.control.size(), count);
    to.parameters = Eigen::MatrixXd::Zero(system_.num_parameters(), count);
    // Of each guard and constraint: by the variables with the intervals as `moving` says, and by times of events.
    Eigen::MatrixXd rows(num_multipliers(), count), by_times(num_multipliers(), E);
    for (int j = 0; j < num_multipliers(); ++j) {
      const Sweep& sweep = sweeps_[j + 1];
      for (Eigen::Index i = 0; i < count; ++i) rows(j, i) = ByVariable(sweep, variables[i], moving);
      for (int k = 0; k < E; ++k) by_times(j, k) = moving ? sweep.times[k + 1] : sweep.event_late[k];
    }
    const auto held = [&](int k) { return !moving && on_node_[k]; };
    Eigen::MatrixXd matrix = by_times.topRows(E), right = -rows.topRows(E);
    std::vector<int> kept;
    for (int k = 0; k < E; ++k) {
      if (!held(k)) continue;
      kept.push_back(k);
      matrix.row(k).setZero();
      matrix(k, k) = 1;
      right.row(k).setZero();
    }
    const Eigen::MatrixXd shifts = E > 0 ? SolveLuColumns(matrix, right) : right;
    if (!shifts.allFinite()) return std::nullopt;
    for (int j = E; j < num_multipliers(); ++j) kept.push_back(j);
    to.held.resize(kept.size(), count);
    for (size_t i = 0; i < kept.size(); ++i) to.held.row(i) = rows.row(kept[i]) + by_times.row(kept[i]) * shifts;
    to.boundaries.middleRows(1, E) = shifts;
    for (Eigen::Index i = 0; i < count; ++i) {
      const FreeVariable& v = variables[i];
      if (v.kind == Kind::kControl) to.control(v.index, i) = 1;
      if (v.kind == Kind::kInitial) to.initial(v.index, i) = 1;
      if (v.kind == Kind::kParameter) to.parameters(v.index, i) = 1;
      if (v.kind != Kind::kDuration) continue;
      to.boundaries(E + 1, i) = 1;
      for (int k = 1; k <= E && !moving; ++k) to.boundaries(k, i) += boundaries_[k] / input_.duration;
    }
    return to;
  }

  // Of a time in a phase.
  Eigen::RowVectorXd TimeRow(const Directions& to, double t, int phase) const {
    if (t == boundaries_[phase]) return to.boundaries.row(phase);
    if (t == boundaries_[phase + 1]) return to.boundaries.row(phase + 1);
    if (!to.moving) return t / input_.duration * to.boundaries.row(num_events() + 1);
    const double part = PartOf(phase, t);
    return (1 - part) * to.boundaries.row(phase) + part * to.boundaries.row(phase + 1);
  }

  // By central differences of a gradient.
  template <typename Gradient>
  static Eigen::MatrixXd SecondDerivative(const VectorXd& at, const VectorXd& sizes, const Gradient& gradient) {
    constexpr double kWidth = 1e-5;
    Eigen::MatrixXd second(at.size(), at.size());
    for (Eigen::Index i = 0; i < at.size(); ++i) {
      const double width = kWidth * (sizes[i] > 0 ? sizes[i] : 1.0);
      VectorXd moved = at;
      moved[i] = at[i] + width;
      second.col(i) = gradient(moved);
      moved[i] = at[i] - width;
      second.col(i) -= gradient(moved);
      second.col(i) /= 2 * width;
    }
    return 0.5 * (second + second.transpose());
  }

  // What has been added of the second derivative, and the sizes of the terms on its diagonal, which may cancel.
  struct Second {
    Eigen::MatrixXd sum;
    VectorXd sizes;
    void Add(const Eigen::MatrixXd& second, const Eigen::MatrixXd& along) {
      const Eigen::MatrixXd half = Multiply(second, along);
      sum += MultiplyTransposed(along, half);
      sizes += along.cwiseProduct(half).cwiseAbs().colwise().sum().transpose();
    }
  };

  std::optional<Curvature> FindCurvature(bool moving) const {
    constexpr Eigen::Index kMostVariables = 400;
    constexpr double kRounding = 1e-8;  // of central differences
    const std::vector<FreeVariable> variables = UnboundVariables();
    const auto count = static_cast<Eigen::Index>(variables.size());
    if (count == 0 || count > kMostVariables) return std::nullopt;
    const std::optional<Directions> to = DirectionsOf(variables, moving);
    if (!to) return std::nullopt;
    Second second{Eigen::MatrixXd::Zero(count, count), VectorXd::Zero(count)};
    AddSecondDerivatives(*to, &second);
    // The costs of the control alone; other variables have the sizes of the terms that cancel.
    Eigen::MatrixXd metric = Eigen::MatrixXd::Zero(count, count);
    for (const HybridShooting::TermAt& at : terms_) {
      if (at.term->role != HybridTerm::Role::kCost || at.interval < 0 || !at.term->with_control) continue;
      const auto rows = static_cast<Eigen::Index>(at.residuals.size());
      const Eigen::MatrixXd by = Eigen::Map<const Matrix>(at.jacobians[at.term->with_state].data(), rows, width());
      const Eigen::MatrixXd along = to->control.middleRows(static_cast<Eigen::Index>(at.interval) * width(), width());
      const Eigen::MatrixXd image = Multiply(by, along);
      metric += 2 * MultiplyTransposed(image, image);
    }
    for (Eigen::Index i = 0; i < count; ++i) {
      if (metric(i, i) <= 1e-12 * second.sizes[i]) metric(i, i) += second.sizes[i] > 0 ? second.sizes[i] : 1.0;
    }
    const Eigen::MatrixXd gram = SolveLuColumns(metric, Eigen::MatrixXd::Identity(count, count));
    if (!gram.allFinite() || !second.sum.allFinite()) return std::nullopt;
    const LeastCurvature least = FindLeastCurvature(gram, second.sum - metric, to->held, 1);
    CurvatureRange found;
    if (least.source.size() == 0) return WithKind(found, kRounding);
    found.smallest = 1 + least.smallest;
    found.largest = 1 + least.largest;
    const VectorXd direction = gram * least.source;
    // The control, and behind it what else is free.
    found.direction = VectorXd::Zero(input_.control.size());
    double square = 0;
    for (Eigen::Index i = 0; i < count; ++i) {
      const FreeVariable& v = variables[i];
      const bool of_control = v.kind == Kind::kControl;
      square += (of_control ? LengthOf(v.index / width()) : 1.0) * direction[i] * direction[i];
      if (of_control) found.direction[v.index] = direction[i];
    }
    for (const FreeVariable& free : FreeVariables(problem_.free, width(), /*num_intervals=*/0)) {
      found.direction.conservativeResize(found.direction.size() + 1);
      double& last = found.direction[found.direction.size() - 1] = 0;
      for (Eigen::Index i = 0; i < count; ++i) {
        if (variables[i].kind == free.kind && variables[i].index == free.index) last = direction[i];
      }
    }
    found.direction /= std::sqrt(square);
    Eigen::Index most = 0;
    found.direction.cwiseAbs().maxCoeff(&most);
    if (found.direction[most] < 0) found.direction = -found.direction;
    return WithKind(found, kRounding);
  }

  void AddSecondDerivatives(const Directions& to, Second* second) const {
    VectorXd weights(1 + num_multipliers());
    weights << 1, theta_;
    Costates costates{std::vector<VectorXd>(steps_.size()), std::vector<VectorXd>(num_events())};
    SweepOf(weights, &costates);
    const int P = system_.num_parameters(), m = width();
    const auto sizes_of = [](const auto& numbers) {
      return VectorXd(Eigen::Map<const VectorXd>(numbers.data(), static_cast<Eigen::Index>(numbers.size())).cwiseAbs());
    };
    const VectorXd parameter_sizes = sizes_of(input_.parameters);
    std::vector<VectorXd> state_sizes;
    for (int mode = 0; mode < system_.num_modes(); ++mode) {
      state_sizes.push_back(VectorXd::Zero(system_.state_size(mode)));
    }
    for (const Step& step : steps_) state_sizes[step.mode] = state_sizes[step.mode].cwiseMax(step.state.cwiseAbs());
    VectorXd control_sizes = VectorXd::Zero(m);
    for (size_t i = 0; i < input_.control.size(); ++i) {
      control_sizes[i % m] = std::max(control_sizes[i % m], std::abs(input_.control[i]));
    }

    Eigen::MatrixXd states = to.initial;
    int interval = 0, event = 0;
    const auto jump = [&](int k) { states = JumpForward(to, k, weights, costates, parameter_sizes, states, second); };
    for (size_t s = 0; s < steps_.size(); ++s) {
      const Step& step = steps_[s];
      for (; event < step.phase; ++event) jump(event);
      const double next = s + 1 < steps_.size() ? steps_[s + 1].begin - kSameTime * input_.duration : INFINITY;
      for (; interval < input_.num_intervals && times_[interval] < next; ++interval) {
        AddTerms(to, interval, -1, weights, state_sizes[step.mode], states, second);
      }
      const int n = system_.state_size(step.mode), size = n + 1 + P + m + 1;
      const VectorXd& costate = costates.of_steps[s];
      Eigen::MatrixXd along(size, states.cols());
      along.topRows(n) = states;
      along.row(n) = TimeRow(to, step.begin, step.phase);
      along.middleRows(n + 1, P) = to.parameters;
      along.middleRows(n + 1 + P, m) = to.control.middleRows(static_cast<Eigen::Index>(step.interval) * m, m);
      along.row(size - 1) = TimeRow(to, step.end, step.phase) - along.row(n);
      VectorXd at(size), sizes(size);
      at << step.state, step.begin, Eigen::Map<const VectorXd>(input_.parameters.data(), P),
          Eigen::Map<const VectorXd>(ControlOf(step.interval), m), step.end - step.begin;
      // A step may be far shorter than others.
      sizes << state_sizes[step.mode], input_.duration, parameter_sizes, control_sizes,
          input_.duration / static_cast<double>(steps_.size());
      RungeKutta integrator(functions_);
      second->Add(SecondDerivative(at,
                                   sizes,
                                   [&](const VectorXd& y) {
                                     VectorXd gradient = VectorXd::Zero(size);
                                     double* g = gradient.data();
                                     StepCotangent by{g, 0, 0, g + n + 1, g + n + 1 + P};
                                     const ModePoint begin{step.mode, y[n], y.data(), &y[n] + 1 + P, &y[n] + 1};
                                     integrator.PullBack({begin, y[size - 1], step.projects}, costate.data(), &by);
                                     gradient[n] = by.t;
                                     gradient[size - 1] = by.h;
                                     return gradient;
                                   }),
                  along);
      states = Multiply(step.by, along);
    }
    for (; event < num_events(); ++event) jump(event);
    AddTerms(to, -1, -1, weights, state_sizes[simulator().final_mode()], states, second);
  }

  // Adds the guard, the reset and the terms of event k; returns the derivatives of the state after it.
  Eigen::MatrixXd JumpForward(const Directions& to, int k, const VectorXd& weights, const Costates& costates,
                              const VectorXd& parameter_sizes, const Eigen::MatrixXd& states, Second* second) const {
    const HybridEvent& event = events()[k];
    const int n = system_.state_size(event.mode), P = system_.num_parameters(), columns = n + 1 + P;
    // With the control behind, if the guard depends on it.
    const int m = functions_.ReadsControl(event.mode, event.guard) ? width() : 0, before = interval_before_[k];
    const VectorXd& costate = costates.of_events[k];
    VectorXd after(functions_.most_states()), guard(columns + width());
    Matrix reset(functions_.most_states(), columns);
    const auto linearize = [&](const VectorXd& y) {
      const ModePoint there{event.mode, y[n], y.data(), ControlOf(before), y.data() + n + 1};
      functions_.ResetJacobian(there, event.guard, after.data(), reset.data());
    };
    const Eigen::Map<const VectorXd> control(ControlOf(before), m);
    VectorXd at(columns + m), sizes(columns + m);
    at << Eigen::Map<const VectorXd>(event.before.data(), n), event.time,
        Eigen::Map<const VectorXd>(input_.parameters.data(), P), control;
    sizes << at.head(n).cwiseAbs(), input_.duration, parameter_sizes, control.cwiseAbs();
    Eigen::MatrixXd along(columns + m, states.cols());
    along << states, to.boundaries.row(k + 1), to.parameters,
        to.control.middleRows(static_cast<Eigen::Index>(before) * width(), m);
    second->Add(
        SecondDerivative(
            at,
            sizes,
            [&](const VectorXd& y) {
              linearize(y);
              const double* u = m > 0 ? y.data() + columns : ControlOf(before);
              functions_.GuardGradient({event.mode, y[n], y.data(), u, y.data() + n + 1}, event.guard, guard.data());
              VectorXd gradient = weights[1 + k] * guard.head(columns + m);
              gradient.head(columns) += reset.topRows(costate.size()).transpose() * costate;
              return gradient;
            }),
        along);
    linearize(at);
    const Eigen::MatrixXd next = Multiply(reset.topRows(costate.size()), along.topRows(columns));
    AddTerms(to, -1, k, weights, sizes.head(n), states, second, /*before=*/true);
    AddTerms(to, -1, k, weights, VectorXd::Zero(next.rows()), next, second);
    return next;
  }

  // Adds the terms of an interval, of an event, or else of the end, given the derivatives of the state that they read.
  void AddTerms(const Directions& to, int interval, int event, const VectorXd& weights, const VectorXd& state_sizes,
                const Eigen::MatrixXd& states, Second* second, bool before = false) const {
    for (size_t i = 0; i < terms_.size(); ++i) {
      const HybridShooting::TermAt& at = terms_[i];
      const HybridTerm& term = *at.term;
      if (at.interval != interval || at.event != event || (event >= 0 && term.before != before)) continue;
      const auto rows = static_cast<Eigen::Index>(at.residuals.size());
      if (!RowWeights(i, Eigen::Map<const VectorXd>(at.residuals.data(), rows), weights)) continue;
      Eigen::Index size = 0;
      for (const std::vector<double>& block : at.blocks) size += static_cast<Eigen::Index>(block.size());
      VectorXd values(size), sizes(size);
      Eigen::MatrixXd along(size, states.cols());
      Eigen::Index first = 0;
      size_t block = 0;
      const auto add = [&](const auto& rows_of_block, const VectorXd& of_block) {
        const auto length = static_cast<Eigen::Index>(at.blocks[block].size());
        values.segment(first, length) = Eigen::Map<const VectorXd>(at.blocks[block++].data(), length);
        sizes.segment(first, length) = of_block.size() == length
                                           ? VectorXd(of_block.cwiseMax(values.segment(first, length).cwiseAbs()))
                                           : VectorXd(values.segment(first, length).cwiseAbs());
        along.middleRows(first, length) = rows_of_block;
        first += length;
      };
      const int m = width();
      const double begin = interval >= 0 ? times_[interval] : 0, end = interval >= 0 ? times_[interval + 1] : 0;
      const Eigen::RowVectorXd time = interval >= 0 ? TimeRow(to, begin, PhaseAt(begin, false))
                                                    : to.boundaries.row(event >= 0 ? event + 1 : num_events() + 1);
      if (term.with_state) add(states, state_sizes);
      if (term.with_control) add(to.control.middleRows(static_cast<Eigen::Index>(interval) * m, m), {});
      if (term.with_parameters) add(to.parameters, {});
      if (term.with_time) add(time, VectorXd::Constant(1, input_.duration));
      if (term.with_length) add(TimeRow(to, end, PhaseAt(end, true)) - time, {});
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
        if (!term.function->Evaluate(blocks.data(), residuals.data(), pointers.data())) return out;
        const Eigen::RowVectorXd by = *RowWeights(i, residuals, weights);
        start = 0;
        for (const Matrix& jacobian : jacobians) {
          out.segment(start, jacobian.cols()) = (by * jacobian).transpose();
          start += jacobian.cols();
        }
        return out;
      };
      second->Add(SecondDerivative(values, sizes, gradient), along);
    }
  }

  // -------------------------------------------------------------------------------------------------------- conditions

  // Of a variable: the sign that the derivative of the loss may have at its bounds; nothing if it cannot move.
  static std::optional<int> SignAt(double value, double min, double max) {
    const double range = std::isfinite(max - min) ? max - min : std::max(1.0, std::abs(value));
    const bool low = value <= min + kAtBound * range, high = value >= max - kAtBound * range;
    if (low && high) return std::nullopt;
    return low ? 1 : high ? -1 : 0;
  }
  // The variables that can move, with that sign.
  void FindVariables() {
    for (const FreeVariable& variable : FreeVariables(problem_.free, width(), input_.num_intervals)) {
      const bool of_control = variable.kind == Kind::kControl;
      if (of_control && LengthOf(variable.index / width()) <= kNoInterval * input_.duration) continue;
      const auto sign = SignAt(variable.In(input_), variable.min, variable.max);
      if (sign) variables_.emplace_back(variable, *sign);
    }
  }
  // The derivative by a variable. That by the duration moves the last phase alone, or scales all intervals.
  double ByVariable(const Sweep& sweep, const FreeVariable& variable, bool moving) const {
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

  // Adds a derivative of the loss, as a part of its size.
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
  };

  void AddVariables(bool moving, ConeConditions* conditions, Kinds* kinds) {
    num_conditions_ = 0;
    for (const auto& [variable, sign] : variables_) {
      const bool of_control = variable.kind == Kind::kControl, of_duration = variable.kind == Kind::kDuration;
      const double length = of_control ? LengthOf(variable.index / width()) : 1;
      const double size = SizeOf([&, &variable = variable](const Sweep& s) {
        // Where a component has no effect its terms are errors of the solution, which do not cancel.
        return of_control ? std::max(s.control_size[variable.index % width()], kSmallTerms * s.control_size.maxCoeff())
               : variable.kind == Kind::kInitial   ? s.initial_size[variable.index]
               : variable.kind == Kind::kParameter ? s.parameters_size[variable.index]
                                                   : s.hamiltonian_size;
      });
      Add([&, &variable = variable](const Sweep& s) { return ByVariable(s, variable, moving) / length; },
          size,
          sign,
          conditions,
          of_control    ? &kinds->controls
          : of_duration ? &kinds->duration
                        : &kinds->variables);
    }
    // Multipliers of inequalities are not negative.
    for (size_t c = 0; c < constraints_.size(); ++c) {
      if (!constraints_[c].inequality) continue;
      Eigen::RowVectorXd one = Eigen::RowVectorXd::Zero(num_multipliers());
      one[num_events() + static_cast<int>(c)] = 1;
      conditions->AddNumber(0, one, 1);
      ++num_conditions_;
    }
  }

  // Of the terms of a derivative that cancel, with the multipliers found so far.
  template <typename Of>
  double SizeOf(const Of& of) const {
    double size = 0;
    for (size_t j = 0; j < sweeps_.size(); ++j) size += weights_[j] * of(sweeps_[j]);
    return size;
  }
  double HamiltonianSize() const {
    return SizeOf([](const Sweep& s) { return s.hamiltonian_size; });
  }
  void SetWeights(const VectorXd& theta) {
    for (int j = 0; j < num_multipliers(); ++j) weights_[j + 1] = std::abs(theta[j]);
  }

  static double Largest(const ConeConditions& conditions, const std::vector<size_t>& of) {
    double largest = 0;
    for (const size_t i : of) largest = std::max(largest, std::abs(conditions.Number(i)));
    return largest;
  }

  void OfMovingGrid(Certificate* result) {
    ConeConditions conditions(num_multipliers());
    Kinds kinds;
    AddVariables(true, &conditions, &kinds);
    for (int k = 0; k < num_events(); ++k) {
      Add([&](const Sweep& s) { return s.times[k + 1]; }, HamiltonianSize(), 0, &conditions, &kinds.events);
    }
    conditions.Solve();
    theta_ = conditions.theta();
    SetWeights(theta_);
    result->stationarity = Largest(conditions, kinds.controls);
    result->transversality = Largest(conditions, kinds.variables);
    if (!kinds.duration.empty()) result->final_time = conditions.Number(kinds.duration[0]);
    result->hamiltonian = std::max(Largest(conditions, kinds.events), Largest(conditions, kinds.duration));
    for (int k = 0; k < num_events(); ++k) {
      result->impacts[k].multiplier = conditions.theta()[k];
      result->impacts[k].hamiltonian = conditions.Number(kinds.events[k]);
    }
  }

  void OfFixedGrid(Certificate* result) {
    // Multipliers of events inside intervals are those that the saltation matrix has; of those at the ends of intervals
    // any between the one-sided ones.
    ConeConditions conditions(num_multipliers());
    Kinds kinds;
    AddVariables(false, &conditions, &kinds);
    for (int k = 0; k < num_events(); ++k) {
      if (on_node_[k]) continue;
      Add([&](const Sweep& s) { return s.event_late[k]; }, HamiltonianSize(), 0, &conditions, &kinds.events);
    }
    conditions.Solve();
    result->gradient = std::max({Largest(conditions, kinds.controls),
                                 Largest(conditions, kinds.variables),
                                 Largest(conditions, kinds.events),
                                 Largest(conditions, kinds.duration)});
    const VectorXd& theta = theta_ = conditions.theta();
    const auto combined = [&](const auto& of) {
      double sum = of(sweeps_[0]);
      for (int j = 0; j < num_multipliers(); ++j) sum += theta[j] * of(sweeps_[j + 1]);
      return sum;
    };
    for (int k = 0; k < num_events(); ++k) {
      if (!on_node_[k]) continue;
      // nu enters these as nu (guard rate); they vanish at the one-sided multipliers.
      const double early = combined([&](const Sweep& s) { return s.event_early[k]; });
      const double late = combined([&](const Sweep& s) { return s.event_late[k]; });
      const double slope_early = sweeps_[k + 1].event_early[k], slope_late = sweeps_[k + 1].event_late[k];
      const double nu = theta[k], nu_early = nu - early / slope_early, nu_late = nu - late / slope_late;
      const double kink = nu_early - nu_late;
      if (std::abs(kink) > 1e-9 * (std::abs(nu_early) + std::abs(nu_late))) {
        result->impacts[k].theta = (nu - nu_late) / kink;
      }
    }
  }

  const HybridProblem& problem_;
  HybridInput input_;
  const HybridSystem& system_;
  const HybridFunctions& functions_;
  HybridShooting shooting_;
  RungeKutta integrator_;
  std::vector<double> times_;       // of the ends of control intervals
  std::vector<double> boundaries_;  // of the phases
  std::vector<Step> steps_;
  std::vector<bool> on_node_;                          // of each event: it is at the end of a control interval
  std::vector<int> interval_before_, interval_after_;  // of each event: whose control acts
  std::vector<HybridShooting::TermAt> terms_;
  std::vector<std::pair<FreeVariable, int>> variables_;  // that can move, each with its sign (SignAt)
  std::vector<Constraint> constraints_;
  std::vector<Sweep> sweeps_;    // of the objective, and of each multiplier
  std::vector<double> weights_;  // of these, in sizes: 1, and the multipliers' absolute values
  VectorXd theta_;               // the multipliers
  size_t num_conditions_ = 0;
};

}  // namespace

Certificate Certify(const HybridProblem& problem, const HybridInput& input) {
  Certificate wrong;
  wrong.reason = WhatIsWrongWith(input, problem.system);
  if (wrong.reason.empty() && input.begin != 0) wrong.reason = "the motion does not begin at time 0";
  return wrong.reason.empty() ? HybridConditions(problem, input).Run() : wrong;
}

}  // namespace saltus
