// The conditions of saltus/optimality/hybrid_certificate.h, from the steps of the exact motion.
//
// With multipliers theta of events, equalities and active inequalities, the derivatives of the Lagrangian by controls,
// initial state, parameters, the times of the events and the final time are affine in theta: one backward sweep through
// the motion for the objective, and one for each multiplier. Those theta are found that leave least of all conditions
// (cone_conditions.h).
#include <glog/logging.h>

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "control/hybrid_shooting.h"
#include "hybrid/runge_kutta.h"
#include "optimality/cone_conditions.h"
#include "saltus/optimality/hybrid_certificate.h"

namespace saltus {
namespace {

using Matrix = RungeKutta::Matrix;
using Eigen::VectorXd;

constexpr double kAtBound = 1e-6;      // of a bound's range, or an inequality's violation that counts as active
constexpr double kAtNode = 1e-6;       // of an interval: an event so near to its end is at it
constexpr double kSameTime = 1e-14;    // of the duration
constexpr double kNoInterval = 1e-9;   // of the duration: of an interval so short nothing is asked
constexpr int kMostMultipliers = 200;  // of which conditions are looked at

// A step of the motion, from `begin` to `end`, with its derivatives [x t p u h].
struct Step {
  int mode = 0, interval = 0, phase = 0;
  double begin = 0, end = 0;
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
    FindMultipliers();
    if (num_multipliers() > kMostMultipliers) {
      result.reason = "more than " + std::to_string(kMostMultipliers) + " multipliers";
      return result;
    }
    for (int j = -1; j < num_multipliers(); ++j) sweeps_.push_back(SweepOf(j));
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
    if (result.verdict == Certificate::Verdict::kNotStationary) {
      OfFixedGrid(&result);
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

  // -------------------------------------------------------------------------------------------------- the motion as
  // steps

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
    const int mode = simulator().StepMode(i), n = system_.state_size(mode), P = system_.num_parameters(), m = width();
    Step step{mode, interval, phase, begin, end, {}};
    integrator_.Linearize(
        {mode, begin, end - begin, simulator().StepState(i).data(), ControlOf(interval), input_.parameters.data()});
    const int columns = n + 1 + P + m + 1;
    RungeKutta::Tangent seeds{Matrix::Zero(n, columns),
                              Eigen::RowVectorXd::Zero(columns),
                              Eigen::RowVectorXd::Zero(columns),
                              Matrix::Zero(P, columns),
                              Matrix::Zero(m, columns)};
    seeds.x.leftCols(n).setIdentity();
    seeds.t[n] = 1;
    seeds.p.middleCols(n + 1, P).setIdentity();
    seeds.u.middleCols(n + 1 + P, m).setIdentity();
    seeds.h[columns - 1] = 1;
    step.by = integrator_.PushForward(seeds);
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

  // The derivative of what a term adds to the Lagrangian for a multiplier, by block; nothing if it adds nothing.
  struct Source {
    VectorXd state, control, parameters;
    double time = 0, length = 0;
    bool before = false;  // of an event: of the state before the reset
  };
  std::optional<Source> SourceOf(size_t term, int multiplier) const {
    const HybridShooting::TermAt& at = terms_[term];
    const auto rows = static_cast<Eigen::Index>(at.residuals.size());
    Eigen::RowVectorXd weights = Eigen::RowVectorXd::Zero(rows);
    if (multiplier < 0) {
      if (at.term->role != HybridTerm::Role::kCost) return std::nullopt;
      weights = 2 * Eigen::Map<const Eigen::RowVectorXd>(at.residuals.data(), rows);
    } else {
      if (multiplier < num_events()) return std::nullopt;
      const Constraint& constraint = constraints_[multiplier - num_events()];
      if (constraint.term != static_cast<int>(term)) return std::nullopt;
      weights[constraint.row] = 1;
    }
    Source source;
    source.before = at.term->before;
    size_t block = 0;
    const auto next = [&] {
      const std::vector<double>& jacobian = at.jacobians[block++];
      const auto columns = static_cast<Eigen::Index>(jacobian.size()) / rows;
      return VectorXd((weights * Eigen::Map<const Matrix>(jacobian.data(), rows, columns)).transpose());
    };
    if (at.term->with_state) source.state = next();
    if (at.term->with_control) source.control = next();
    if (at.term->with_parameters) source.parameters = next();
    if (at.term->with_time) source.time = next()[0];
    if (at.term->with_length) source.length = next()[0];
    return source;
  }

  // -------------------------------------------------------------------------------------------------------------
  // sweeps

  // Adds the derivative by a time that is not a boundary of phases but lies in one, as these move.
  void AddTime(double t, int phase, double by, VectorXd* times) const {
    const double begin = boundaries_[phase], length = boundaries_[phase + 1] - begin;
    const double part = length > 0 ? std::clamp((t - begin) / length, 0.0, 1.0) : 1.0;
    (*times)[phase] += (1 - part) * by;
    (*times)[phase + 1] += part * by;
  }

  static double OwnTimeOf(const std::vector<Source>& sources) {
    double sum = 0;
    for (const Source& source : sources) sum += source.time;
    return sum;
  }

  int PhaseAt(double t, bool before) const {  // of two phases that meet there, the first
    int phase = 0;
    while (phase < num_events() && (before ? boundaries_[phase + 1] < t : boundaries_[phase + 1] <= t)) ++phase;
    return phase;
  }

  Sweep SweepOf(int multiplier) const {
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
      std::optional<Source> source = SourceOf(i, multiplier);
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
      while (event >= step.phase) JumpBack(event--, multiplier, at_event, &sweep, &costate);
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
    while (event >= 0) JumpBack(event--, multiplier, at_event, &sweep, &costate);
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

  // The costate before event k from that after it.
  void JumpBack(int k, int multiplier, const std::vector<std::vector<Source>>& at_event, Sweep* sweep,
                VectorXd* costate) const {
    const HybridEvent& event = events()[k];
    const int n = system_.state_size(event.mode), P = system_.num_parameters(), columns = n + 1 + P;
    const auto add = [&](bool before) {
      for (const Source& source : at_event[k]) {
        if (source.before == before && source.state.size() > 0) *costate += source.state;
      }
    };
    add(false);
    const std::vector<int>& sizes = system_.layout().state_sizes;
    const int most = *std::max_element(sizes.begin(), sizes.end());
    VectorXd after(most);
    Matrix reset(most, columns);
    functions_.ResetJacobian(event.mode,
                             event.guard,
                             event.time,
                             event.before.data(),
                             nullptr,
                             input_.parameters.data(),
                             after.data(),
                             reset.data());
    const VectorXd costate_after = *costate;
    const Eigen::RowVectorXd by = costate->transpose() * reset.topRows(costate->size());
    VectorXd before = by.head(n).transpose();
    double by_time = by[n];
    sweep->parameters += by.tail(P).transpose();
    sweep->parameters_size += by.tail(P).transpose().cwiseAbs();
    if (multiplier == k) {
      Eigen::RowVectorXd guard(columns + system_.num_controls());
      functions_.GuardGradient(
          event.mode, event.guard, event.time, event.before.data(), nullptr, input_.parameters.data(), guard.data());
      before += guard.head(n).transpose();
      by_time += guard[n];
      sweep->parameters += guard.segment(n + 1, P).transpose();
      sweep->parameters_size += guard.segment(n + 1, P).transpose().cwiseAbs();
    }
    *costate = std::move(before);
    add(true);
    sweep->times[k + 1] += by_time;
    sweep->scale += by_time * event.time / input_.duration;
    by_time += OwnTimeOf(at_event[k]);
    // Of the event alone, with one control on both sides: H before less H after.
    const auto one_sided = [&](const double* u) {
      VectorXd in(n), out(costate_after.size());
      functions_.Flow(event.mode, event.time, event.before.data(), u, input_.parameters.data(), in.data());
      functions_.Flow(event.next_mode, event.time, event.after.data(), u, input_.parameters.data(), out.data());
      return by_time + costate->dot(in) - costate_after.dot(out);
    };
    sweep->event_early[k] = one_sided(ControlOf(interval_before_[k]));
    sweep->event_late[k] = one_sided(ControlOf(interval_after_[k]));
  }

  // ---------------------------------------------------------------------------------------------------------
  // conditions

  // Of a variable: the sign that the derivative of the loss may have at its bounds; nothing if it cannot move.
  static std::optional<int> SignAt(double value, double min, double max) {
    const double range = std::isfinite(max - min) ? max - min : std::max(1.0, std::abs(value));
    const bool low = value <= min + kAtBound * range, high = value >= max - kAtBound * range;
    if (low && high) return std::nullopt;
    return low ? 1 : high ? -1 : 0;
  }
  static double BoundAt(const std::vector<double>& bounds, size_t i, double none) {
    return bounds.empty() ? none : bounds[i];
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
    const HybridFree& free = problem_.free;
    const int m = width();
    for (int i = 0; free.control && i < input_.num_intervals * m; ++i) {
      const double length = times_[i / m + 1] - times_[i / m];
      if (length <= kNoInterval * input_.duration) continue;
      const auto sign = SignAt(
          input_.control[i], BoundAt(free.control_min, i % m, -INFINITY), BoundAt(free.control_max, i % m, INFINITY));
      if (!sign) continue;
      const double size = SizeOf([&](const Sweep& s) { return s.control_size[i % m]; });
      Add([&](const Sweep& s) { return s.control[i] / length; }, size, *sign, conditions, &kinds->controls);
    }
    for (size_t i = 0; i < free.initial.size(); ++i) {
      const int c = free.initial[i];
      const auto sign =
          SignAt(input_.initial[c], BoundAt(free.initial_min, i, -INFINITY), BoundAt(free.initial_max, i, INFINITY));
      if (sign) {
        const double size = SizeOf([&](const Sweep& s) { return s.initial_size[c]; });
        Add([&](const Sweep& s) { return s.initial[c]; }, size, *sign, conditions, &kinds->variables);
      }
    }
    for (size_t i = 0; i < free.parameters.size(); ++i) {
      const int c = free.parameters[i];
      const auto sign = SignAt(
          input_.parameters[c], BoundAt(free.parameters_min, i, -INFINITY), BoundAt(free.parameters_max, i, INFINITY));
      if (sign) {
        const double size = SizeOf([&](const Sweep& s) { return s.parameters_size[c]; });
        Add([&](const Sweep& s) { return s.parameters[c]; }, size, *sign, conditions, &kinds->variables);
      }
    }
    if (free.duration) {
      if (const auto sign = SignAt(input_.duration, free.duration_min, free.duration_max)) {
        const auto by_duration = [&](const Sweep& s) { return moving ? s.times[num_events() + 1] : s.scale; };
        Add(by_duration, HamiltonianSize(), *sign, conditions, &kinds->duration);
      }
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
    SetWeights(conditions.theta());
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
    const VectorXd& theta = conditions.theta();
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
  std::vector<Constraint> constraints_;
  std::vector<Sweep> sweeps_;    // of the objective, and of each multiplier
  std::vector<double> weights_;  // of these, in sizes: 1, and the multipliers' absolute values
  size_t num_conditions_ = 0;
};

}  // namespace

Certificate Certify(const HybridProblem& problem, const HybridInput& input) {
  if (std::string wrong = WhatIsWrongWith(input, problem.system); !wrong.empty()) {
    Certificate certificate;
    certificate.reason = wrong;
    return certificate;
  }
  if (problem.system.functions().CreatesModes()) {
    Certificate certificate;
    certificate.reason = "the system creates its modes as a motion meets them";
    return certificate;
  }
  return HybridConditions(problem, input).Run();
}

}  // namespace saltus
