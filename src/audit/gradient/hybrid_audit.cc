#include "saltus/audit/hybrid_audit.h"

#include <Eigen/Core>
#include <cmath>
#include <map>
#include <ranges>
#include <span>

#include "audit/gradient/step_study.h"
#include "base/number_text.h"
#include "base/statistics.h"
#include "control/hybrid_shooting.h"

namespace saltus {
namespace {

constexpr double kSmall = 0.01;        // error of a segment that is not named
constexpr double kStays = 0.25;        // part of an error that is left with kFiner times the steps, if it stays
constexpr int kFiner = 8;              //
constexpr double kSmooth = 0.05;       // of a first difference, the second one where the state does not jump
constexpr int kAttempts = 2;           // narrower differences of a step,
constexpr double kNarrower = 30;       // each by so much
constexpr double kSweptSteps = 16000;  // of a width sweep, so that a width of many steps is small beside the motion,
constexpr double kSweptPart = 0.1;     // and at most this part of the budget of a level
constexpr int kMostVariables = 8;      // of each quantity, in a width sweep

using Matrix = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;

// The loss of a problem by a scheme's steps, and its gradient.
class SchemeShooting final : public HybridShooting {
 public:
  // `per_interval`: steps in each of the control intervals, which have equal lengths.
  SchemeShooting(const HybridProblem& problem, HybridScheme* scheme, int per_interval, const StopRequest& stop)
      : HybridShooting(problem), scheme_(scheme), stop_(stop), per_interval_(per_interval) {
    set_stop(stop);
    const HybridSystem& system = problem.system;
    for (int mode = 0; mode < system.num_modes(); ++mode) most_ = std::max(most_, system.state_size(mode));
  }

  std::string FailureReason() const override { return stopped() ? kStopped : HybridShooting::FailureReason(); }

  bool Move(const HybridInput& input, bool with_derivatives) override {
    const HybridSystem& system = problem().system;
    const int m = system.num_controls(), steps = input.num_intervals * per_interval_;
    const int most_columns = most_ + m + system.num_parameters();
    modes_ = {input.mode};
    states_ = {input.initial};
    jacobians_.clear();
    for (int k = 0; k < steps; ++k) {
      if (stop_ && stop_()) return Fail(kStopped);
      std::vector<double> next(most_), jacobian(with_derivatives ? most_ * most_columns : 0);
      std::string error;
      const double h = input.duration / steps;
      const SchemeStep step{.mode = modes_.back(),
                            .t = input.begin + k * h,
                            .h = h,
                            .x = states_.back().data(),
                            .u = input.control.data() + static_cast<std::ptrdiff_t>(k / per_interval_) * m,
                            .p = input.parameters.data()};
      const int after = scheme_->Step(step, next.data(), with_derivatives ? jacobian.data() : nullptr, &error);
      const std::string where = " in step " + std::to_string(k) + " of " + std::to_string(steps) + ", in mode '" +
                                system.ModeName(step.mode) + "' at t = " + std::to_string(step.t);
      if (!error.empty()) return Fail(error + where);
      if (after < 0 || after >= system.num_modes()) {
        return Fail("found mode " + std::to_string(after) + " after a step, which does not exist," + where);
      }
      next.resize(system.state_size(after));
      if (!AllFinite(next)) return Fail("the state is not finite" + where);
      modes_.push_back(after);
      states_.push_back(std::move(next));
      if (with_derivatives) jacobians_.push_back(std::move(jacobian));
    }
    return true;
  }
  const std::vector<HybridEvent>& Events() const override { return no_events_; }
  int ModeAt(int node) const override { return modes_[node * per_interval_]; }
  std::span<const double> StateAt(int node) const override { return states_[node * per_interval_]; }
  HybridGradient Adjoint(const HybridCotangent& cotangent) override {
    const int m = problem().system.num_controls(), P = problem().system.num_parameters();
    const int steps = static_cast<int>(jacobians_.size());
    HybridGradient gradient;
    gradient.control.resize(static_cast<std::size_t>(steps / per_interval_) * m);
    gradient.parameters.resize(P);
    const auto add = [](std::span<const double> numbers, Eigen::RowVectorXd* to) {
      for (std::size_t i = 0; i < numbers.size(); ++i) (*to)[static_cast<Eigen::Index>(i)] += numbers[i];
    };
    Eigen::RowVectorXd lambda = Eigen::RowVectorXd::Zero(static_cast<Eigen::Index>(states_.back().size()));
    add(cotangent.final_state, &lambda);
    for (int k = steps - 1; k >= 0; --k) {
      const auto n = static_cast<Eigen::Index>(states_[k].size());
      const Eigen::RowVectorXd by = lambda * Eigen::Map<const Matrix>(jacobians_[k].data(), lambda.size(), n + m + P);
      const int interval = k / per_interval_;
      for (int i = 0; i < m; ++i) gradient.control[static_cast<std::size_t>(interval) * m + i] += by[n + i];
      for (int i = 0; i < P; ++i) gradient.parameters[i] += by[n + m + i];
      lambda = by.head(n);
      if (k % per_interval_ == 0 && !cotangent.nodes.empty()) add(cotangent.nodes[interval], &lambda);
    }
    gradient.initial.assign(lambda.data(), lambda.data() + lambda.size());
    return gradient;
  }

 private:
  HybridScheme* scheme_;
  const StopRequest& stop_;
  const int per_interval_;
  int most_ = 0;  // size of a state
  const std::vector<HybridEvent> no_events_;
  std::vector<int> modes_;
  std::vector<std::vector<double>> states_, jacobians_;  // of the last motion
};

bool HasEqualIntervals(const HybridInput& input) {
  constexpr double kEqual = 1e-9;
  if (input.lengths.empty()) return true;
  const auto [least, most] = std::ranges::minmax(input.lengths);
  return most - least <= kEqual * most;
}

std::string UnsupportedByAudit(const HybridProblem& problem) {
  if (std::string wrong = Validate(problem); !wrong.empty()) return wrong;
  bool any = false;
  for (const HybridTerm& term : problem.terms) {
    if (!term.IsCost()) return term.name + " is a constraint: the loss of an audit has only costs";
    if (term.at == HybridTerm::Timing::kEvent) return term.name + " is a cost at events, of which a scheme has none";
    if (term.interval >= 0 && !HasEqualIntervals(problem.guess)) {
      return term.name + " is a cost at a given time on control intervals of unequal lengths, expected equal ones";
    }
    any = true;
  }
  return any ? "" : "the problem has no cost, whose gradient could be audited";
}

// Returns the input on `count` control intervals of equal lengths, each with the control at its middle.
HybridInput ResampleOnEqualIntervals(HybridInput input, int count) {
  const std::vector<double> times = input.Times(), control = std::move(input.control);
  const std::size_t m = control.size() / input.num_intervals;
  input.control.clear();
  for (int k = 0, from = 0; k < count; ++k) {
    const double middle = input.begin + input.duration * (k + 0.5) / count;
    while (from + 1 < input.num_intervals && times[from + 1] < middle) ++from;
    const auto row = control.begin() + static_cast<std::ptrdiff_t>(from * m);
    input.control.insert(input.control.end(), row, row + static_cast<std::ptrdiff_t>(m));
  }
  input.lengths.clear();
  input.num_intervals = count;
  return input;
}

// An event of the exact motion, or several that are closer than two steps, with the steps around it.
struct Segment {
  HybridEvent event;
  int first = 0, last = 0;  // steps
};

std::vector<Segment> SegmentsOf(const std::vector<HybridEvent>& events, double h, int steps) {
  std::vector<Segment> segments;
  for (const HybridEvent& event : events) {
    if (!segments.empty() && event.time - segments.back().event.time < 4 * h) continue;
    segments.push_back({.event = event});
  }
  for (std::size_t i = 0; i < segments.size(); ++i) {
    const auto middle = [&](std::size_t a) {
      return static_cast<int>(std::round((segments[a].event.time + segments[a + 1].event.time) / (2 * h)));
    };
    segments[i].first = i == 0 ? 0 : middle(i - 1);
    segments[i].last = i + 1 == segments.size() ? steps : middle(i);
  }
  return segments;
}

// Studies the errors of segments. A scheme starts a segment from the exact state; the exact costate at its end, which
// it pulls back, follows from `final_cotangent`, the derivative of the loss by the final state.
std::vector<SegmentError> StudySegments(const HybridProblem& problem, HybridScheme* scheme, int steps,
                                        const std::vector<double>& final_cotangent, const StopRequest& stop) {
  const HybridSystem& system = problem.system;
  const int m = system.num_controls();
  const double h = problem.guess.duration / steps;
  const HybridInput on_steps = ResampleOnEqualIntervals(problem.guess, steps);
  HybridSimulator exact(system, problem.integration);
  if (!exact.Rollout(on_steps)) return {};
  std::vector<Eigen::RowVectorXd> costates = {
      Eigen::Map<const Eigen::RowVectorXd>(final_cotangent.data(), exact.final_state().size())};
  for (const HybridSensitivity& interval : exact.IntervalSensitivities() | std::views::reverse) {
    const Eigen::Map<const Matrix> by(interval.final_state.data(), costates.back().size(), interval.columns);
    const auto states = static_cast<Eigen::Index>(exact.StateAt(steps - static_cast<int>(costates.size())).size());
    costates.emplace_back((costates.back() * by).head(states));
  }
  std::ranges::reverse(costates);
  std::vector<SegmentError> errors;
  for (const Segment& segment : SegmentsOf(exact.events(), h, steps)) {
    const HybridEvent& event = segment.event;
    const std::span<const double> state = exact.StateAt(segment.first);
    const std::span<const double> control(on_steps.control);
    HybridInput part = on_steps;
    part.mode = system.functions().BaseMode(exact.ModeAt(segment.first));
    part.initial.assign(state.begin(), state.end());
    part.begin = segment.first * h;
    part.duration = (segment.last - segment.first) * h;
    part.num_intervals = segment.last - segment.first;
    part.control.assign(control.begin() + static_cast<std::ptrdiff_t>(segment.first) * m, control.end());
    const Eigen::RowVectorXd &begin = costates[segment.first], &end = costates[segment.last];
    const auto error_by = [&](int finer) {
      SchemeShooting by_steps(problem, scheme, finer, stop);
      const int last_mode = system.functions().BaseMode(exact.ModeAt(segment.last));
      if (!by_steps.Move(part, true) || by_steps.ModeAt(part.num_intervals) != last_mode) {
        return std::numeric_limits<double>::infinity();
      }
      HybridCotangent cotangent;
      cotangent.final_state.assign(end.begin(), end.end());
      const std::vector<double> found = by_steps.Adjoint(cotangent).initial;
      return (Eigen::Map<const Eigen::RowVectorXd>(found.data(), begin.size()) - begin).norm() / begin.norm();
    };
    SegmentError& error = errors.emplace_back();
    error.time = event.time;
    error.mode = system.ModeName(event.mode);
    error.guard = system.GuardName(event.mode, event.guard);
    error.step = std::min(static_cast<int>(event.time / h), steps - 1);
    error.error = error_by(1);
    error.stays = !(error_by(kFiner) <= kStays * error.error) || std::isinf(error.error);
  }
  return errors;
}

// Returns the derivative of the terminal costs by the final state of the last motion; ones if they do not depend on it.
std::vector<double> FinalCotangent(HybridShooting* exact) {
  std::vector<double> sum(exact->simulator().final_state().size());
  std::vector<HybridShooting::TermAt> terms;
  exact->EvaluateTerms(&terms);
  for (const HybridShooting::TermAt& at : terms) {
    if (at.term->at != HybridTerm::Timing::kEnd || !at.term->with_state) continue;
    for (std::size_t i = 0; i < at.residuals.size(); ++i) {
      const double slope = at.term->SlopeOf(at.residuals[i]);
      for (std::size_t j = 0; j < sum.size(); ++j) sum[j] += slope * at.jacobians[0][i * sum.size() + j];
    }
  }
  if (Largest(sum) == 0) std::ranges::fill(sum, 1.0);
  return sum;
}

HybridGradient GradientIn(const HybridShooting& shooting, std::span<const double> derivative) {
  HybridInput by = shooting.InputAt(derivative);
  return {.initial = std::move(by.initial), .control = std::move(by.control), .parameters = std::move(by.parameters)};
}

// Returns the variables of a HybridShooting: a component of the state, a control in all intervals, or a parameter.
// Their grid widths are changes that move an event by a step; without an event, a small part of their size.
std::vector<SweptVariable> VariablesOf(const HybridProblem& problem, const HybridSensitivity& events, int steps) {
  const HybridSystem& system = problem.system;
  const HybridInput& guess = problem.guess;
  const int n = static_cast<int>(guess.initial.size()), m = system.num_controls(), K = guess.num_intervals;
  std::vector<SweptVariable> variables;
  // `column`: of the variable in `events`, whose columns are the state, the control and the parameters.
  const auto add = [&](Quantity quantity, const std::string& name, int first, int count, int column, double value) {
    double moves = 0;  // of the time of an event
    for (const std::vector<double>& row : events.times) {
      double sum = 0;
      for (int k = 0; k < count; ++k) sum += row[column + k * m];
      moves = std::max(moves, std::abs(sum));
    }
    const double natural = std::max(std::abs(value), 1.0) / steps;
    const double width = moves > 0 ? std::min(guess.duration / steps / moves, natural) : natural;
    variables.push_back(
        {.quantity = quantity, .entry = name, .first = first, .count = count, .stride = m, .grid_width = width});
  };
  for (int i = 0; i < n; ++i) {
    add(Quantity::kSystemState, system.StateName(guess.mode, i), K * m + i, 1, i, guess.initial[i]);
  }
  for (int i = 0; i < m; ++i) add(Quantity::kSystemControl, system.ControlName(i), i, K, n + i, 0);
  for (int i = 0; i < system.num_parameters(); ++i) {
    const int column = n + K * m + i;  // as among the variables, of which the control comes before the state
    add(Quantity::kSystemParameter, system.ParameterName(i), column, 1, column, guess.parameters[i]);
  }
  return variables;
}

// Returns the entries by state, control and parameters, of those that the problem has.
std::vector<std::vector<double>> PartsOf(const HybridGradient& gradient) {
  std::vector<std::vector<double>> parts;
  for (const std::vector<double>* part : {&gradient.initial, &gradient.control, &gradient.parameters}) {
    if (!part->empty()) parts.push_back(*part);
  }
  return parts;
}

// Returns the quantities of the variables, with the names of all entries.
std::vector<QuantityStudy> QuantitiesOf(const std::vector<SweptVariable>& variables) {
  std::vector<QuantityStudy> quantities;
  for (const SweptVariable& variable : variables) {
    const bool first = quantities.empty() || quantities.back().quantity != variable.quantity;
    QuantityStudy& quantity = first ? quantities.emplace_back() : quantities.back();
    quantity.quantity = variable.quantity;
    if (variable.quantity != Quantity::kSystemControl) quantity.entries.push_back(variable.entry);
    // Controls are ordered by interval.
    for (int k = 0; first && variable.quantity == Quantity::kSystemControl && k < variable.count; ++k) {
      for (const SweptVariable& other : variables) {
        if (other.quantity != variable.quantity) continue;
        quantity.entries.push_back(other.entry + "[" + std::to_string(k) + "]");
      }
    }
  }
  return quantities;
}

WidthSweepStudy SweepWidths(const HybridProblem& problem, HybridScheme* scheme, const HybridAuditOptions& options,
                            int steps, const LossAtGuess& exact, const HybridSensitivity& events) {
  // The number of steps is no multiple, so that an event on the grid is not on the refined grid again.
  const double swept = std::min(kSweptSteps, kSweptPart * options.refinement.budget);
  const int K = problem.guess.num_intervals;
  const int per_interval = std::max(options.widths.refine * steps, static_cast<int>(swept)) / K + 1;
  SchemeShooting shooting(problem, scheme, per_interval, options.stop);
  const LossAtGuess loss(&shooting);
  WidthSweepStudy study;
  if (!loss.ok) {
    study.reason = shooting.FailureReason();
    return study;
  }
  std::vector<SweptVariable> swept_variables;
  std::map<Quantity, int> count;
  for (SweptVariable& variable : VariablesOf(problem, events, per_interval * K)) {
    if (++count[variable.quantity] > kMostVariables) continue;
    variable.function = &shooting;
    variable.gradient = variable.SumOf(loss.gradient);
    variable.exact = variable.SumOf(exact.gradient);
    swept_variables.push_back(std::move(variable));
  }
  Sweep(swept_variables, loss.value, options.widths, &study);
  return study;
}

}  // namespace

int DifferenceStep(const HybridSystem& system, const SchemeStep& step, const StepFunction& function, double* next,
                   double* jacobian, std::string* error, double precision) {
  const int mode = function(step, next, error);
  if (jacobian == nullptr || mode < 0 || mode >= system.num_modes()) return mode;
  const int sizes[] = {system.state_size(step.mode), system.num_controls(), system.num_parameters()};
  const int columns = sizes[0] + sizes[1] + sizes[2], rows = system.state_size(mode);
  int most = 0;
  for (int i = 0; i < system.num_modes(); ++i) most = std::max(most, system.state_size(i));
  const double* parts[] = {step.x, step.u, step.p};
  int column = 0;
  for (int part = 0; part < 3; ++part) {
    std::vector<double> at(parts[part], parts[part] + sizes[part]);
    double scale = 0;
    for (const double number : at) scale = std::max(scale, std::abs(number));
    if (scale == 0) scale = 1;
    SchemeStep other = step;
    (part == 0 ? other.x : part == 1 ? other.u : other.p) = at.data();
    for (int i = 0; i < sizes[part]; ++i, ++column) {
      const double middle = at[i];
      double width = std::cbrt(precision) * scale;
      // Where an event moves into another step the state jumps: differences are narrowed, then taken on one side.
      for (int attempt = 0;; ++attempt, width /= kNarrower) {
        std::vector<double> ends[2] = {std::vector<double>(most), std::vector<double>(most)};
        double change[2] = {0, 0}, first = 0, second = 0;
        for (const int side : {0, 1}) {
          at[i] = middle + (side == 0 ? width : -width);
          const int found = function(other, ends[side].data(), error);
          if (found < 0) return found;
          if (found != mode) change[side] = std::numeric_limits<double>::infinity();
          for (int row = 0; row < rows; ++row) change[side] += std::abs(ends[side][row] - next[row]);
        }
        at[i] = middle;
        for (int row = 0; row < rows; ++row) {
          first += std::abs(ends[0][row] - ends[1][row]);
          second += std::abs(ends[0][row] - 2 * next[row] + ends[1][row]);
        }
        const bool smooth = std::isfinite(change[0] + change[1]) && second <= kSmooth * first + 1e-3 * width;
        if (!smooth && attempt < kAttempts) continue;
        const int side = change[0] <= change[1] ? 0 : 1;
        for (int row = 0; row < rows; ++row) {
          jacobian[row * columns + column] = smooth      ? (ends[0][row] - ends[1][row]) / (2 * width)
                                             : side == 0 ? (ends[0][row] - next[row]) / width
                                                         : (next[row] - ends[1][row]) / width;
        }
        break;
      }
    }
  }
  return mode;
}

HybridAudit AuditScheme(const HybridProblem& given, HybridScheme* scheme, const HybridAuditOptions& options) {
  HybridAudit audit;
  audit.scheme = scheme->name();
  audit.reason = UnsupportedByAudit(given);
  if (!audit.ok()) return audit;
  HybridProblem problem = FreeAllVariables(given);
  problem.free.duration = false;
  const int intervals = HasEqualIntervals(problem.guess) ? problem.guess.num_intervals : std::max(options.steps, 1);
  problem.guess = ResampleOnEqualIntervals(problem.guess, intervals);
  const auto fail = [&](const std::string& reason) {
    audit.reason = reason;
    audit.interrupted = reason == kStopped;
    return audit;
  };

  HybridShooting shooting(problem);
  HybridSimulator& simulator = shooting.simulator();
  const LossAtGuess exact(&shooting);
  if (!exact.ok) {
    const bool moves = !simulator.ReasonNotFinite().empty();
    return fail((moves ? "there is no exact gradient: " : "there is no exact motion: ") + shooting.FailureReason());
  }
  audit.exact_loss = exact.value;
  audit.exact = GradientIn(shooting, exact.gradient);
  const int K = problem.guess.num_intervals, coarsest = std::max(1, (options.steps + K - 1) / K);
  audit.steps = coarsest * K;
  SchemeShooting steps(problem, scheme, coarsest, options.stop);
  const LossAtGuess own(&steps);
  if (!own.ok) return fail(steps.FailureReason());
  audit.loss = own.value;
  audit.gradient = GradientIn(steps, own.gradient);
  if (const std::string remark = simulator.ReasonNotDifferentiable(); !remark.empty()) {
    const auto& ties = simulator.ties();
    const bool ambiguous = std::any_of(ties.begin(), ties.end(), [](const HybridTie& tie) { return tie.ambiguous; });
    audit.verdict = ambiguous ? Verdict::kAmbiguous : Verdict::kOneSided;
    audit.reason = remark;
    return audit;
  }
  const HybridSensitivity events = simulator.Sensitivity();
  const std::vector<SweptVariable> variables = VariablesOf(problem, events, audit.steps);
  if (scheme->HasJacobian()) {
    audit.gradient_check = CompareAlongSums(variables, 1, [&](int, Quantity) -> const LossAtGuess& { return own; });
  }

  RefinementStudy& study = audit.refinement.emplace();
  study.intervals = K;
  study.quantities = QuantitiesOf(variables);
  const std::vector<std::vector<double>> exact_parts = PartsOf(audit.exact);
  for (std::size_t q = 0; q < exact_parts.size(); ++q) study.quantities[q].exact = exact_parts[q];
  const auto by = [](HybridShooting&& function) {
    const LossAtGuess loss(&function);
    return loss.ok ? SteppedGradient::Parts{.entries = PartsOf(GradientIn(function, loss.gradient))}
                   : SteppedGradient::Parts{.reason = function.FailureReason()};
  };
  // Returns the exact problem with so many steps of the integration in a control interval.
  const auto integrated = [&](int per_interval) {
    HybridProblem other = problem;
    other.integration.steps_per_interval = per_interval;
    other.integration.divisions = simulator.divisions();
    return other;
  };
  const auto initial_gradient = [&](const Change& change, int more) {
    HybridProblem changed = integrated(simulator.steps_per_interval() + more);
    for (double& number : changed.guess.initial) number *= change();
    const SteppedGradient::Parts parts = by(HybridShooting(changed));
    return parts.entries.empty() ? std::vector<double>() : parts.entries.front();
  };
  const SteppedGradient gradient{
      .at = [&](int count) { return by(SchemeShooting(problem, scheme, count / K, options.stop)); },
      .exact_at =
          [&](int count) {
            return by(HybridShooting(integrated(std::max(simulator.steps_per_interval(), count / K))));
          },
      .condition = [&] { return MeasureConditioning(initial_gradient, options.stop); },
      .unit = K,
      .coarsest = coarsest,
      .work = [&](int) { return static_cast<double>(audit.steps); }};
  RefinementOptions refinement = options.refinement;
  refinement.threads = 1;
  refinement.threads_now = nullptr;
  StudyErrors(gradient, exact.value, refinement, options.stop, &study);
  if (options.stop && options.stop()) return fail(kStopped);
  if (!study.ok()) return fail(study.reason);
  audit.verdict = study.verdict;
  double order = std::numeric_limits<double>::infinity();
  for (const QuantityStudy& quantity : study.quantities) {
    if (quantity.verdict != Verdict::kRight) order = std::min(order, quantity.order);
  }
  audit.order = std::isinf(order) ? 0 : order;
  if (IsWrong(audit.verdict)) {
    audit.segments = StudySegments(problem, scheme, audit.steps, FinalCotangent(&shooting), options.stop);
    for (std::size_t i = 0; i < audit.segments.size() && audit.first_wrong < 0; ++i) {
      const SegmentError& error = audit.segments[i];
      if (error.stays && error.error > kSmall) audit.first_wrong = static_cast<int>(i);
    }
  }
  if (options.width_sweep) audit.widths = SweepWidths(problem, scheme, options, audit.steps, exact, events);
  audit.interrupted = options.stop && options.stop();
  return audit;
}

std::string HybridAudit::VerdictReason() const {
  if (!ok()) return reason;
  if (verdict == Verdict::kIllConditioned) return refinement->conditioning->Describe();
  if (gradient_check && gradient_check->agreement == Agreement::kDiffers) {
    return "its gradient contradicts its own steps: along a direction by " +
           std::string(QuantityToString(gradient_check->quantity)) + " it is " + ToText(gradient_check->gradient, 4) +
           ", differences of its loss give " + ToText(gradient_check->difference, 4) + "; correct its Jacobians first";
  }
  if (verdict == Verdict::kRight || verdict == Verdict::kConsistent) return "";
  if (first_wrong < 0) {
    if (widths) return widths->Summary();
    return verdict == Verdict::kUnknown ? "the error falls, but not yet below one percent: begin with more steps"
                                        : "no single event is wrong";
  }
  const SegmentError& first = segments[first_wrong];
  return "the first wrong step is " + std::to_string(first.step) + ", with the event of guard '" + first.guard +
         "' in mode '" + first.mode + "' at t = " + ToText(first.time, 6) + ": its derivative is off by " +
         ToText(first.error, 3) + ", whatever the step";
}

}  // namespace saltus
