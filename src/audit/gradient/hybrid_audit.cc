#include "saltus/audit/hybrid_audit.h"

#include <ceres/cost_function.h>

#include <Eigen/Core>
#include <algorithm>
#include <chrono>
#include <cmath>
#include <limits>

#include "audit/gradient/judgement.h"
#include "base/number_text.h"
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
constexpr int kMostVariables = 8;      // of each part, in a width sweep

using Matrix = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;

// Returns rows `first` to `last` - 1 of a control with m columns, of which each row is held over `held` of them.
std::vector<double> HeldRows(const std::vector<double>& control, int m, int held, int first, int last) {
  std::vector<double> rows;
  for (int k = first; k < last; ++k) {
    const auto row = control.begin() + static_cast<std::ptrdiff_t>(k / held) * m;
    rows.insert(rows.end(), row, row + m);
  }
  return rows;
}

// The motion by a scheme's steps from an input, the loss of a problem along it, and the gradient.
class SchemeRun {
 public:
  SchemeRun(const HybridProblem& problem, HybridScheme* scheme, const StopRequest& stop)
      : problem_(problem), system_(problem.system), scheme_(scheme), stop_(stop) {
    for (int mode = 0; mode < system_.num_modes(); ++mode) most_ = std::max(most_, system_.state_size(mode));
  }

  const std::string& reason() const { return reason_; }

  // Moves from the state in `mode` at time t by steps of length h, with the rows of `control`, one for each step.
  bool Move(int mode, const std::vector<double>& x, double t, double h, int steps, const double* control,
            const std::vector<double>& p, bool with_jacobians) {
    modes_ = {mode};
    states_ = {x};
    jacobians_.clear();
    const int m = system_.num_controls();
    const int most_columns = most_ + m + system_.num_parameters();
    for (int k = 0; k < steps; ++k) {
      if (stop_ && stop_()) return Fail(kStopped);
      std::vector<double> next(most_), jacobian(with_jacobians ? most_ * most_columns : 0);
      std::string error;
      const SchemeStep step{.mode = modes_.back(),
                            .t = t + k * h,
                            .h = h,
                            .x = states_.back().data(),
                            .u = control + k * m,
                            .p = p.data()};
      const int after = scheme_->Step(step, next.data(), with_jacobians ? jacobian.data() : nullptr, &error);
      const std::string where = " in step " + std::to_string(k) + " of " + std::to_string(steps) + ", in mode '" +
                                system_.ModeName(step.mode) + "' at t = " + std::to_string(step.t);
      if (!error.empty()) return Fail(error + where);
      if (after < 0 || after >= system_.num_modes()) {
        return Fail("found mode " + std::to_string(after) + " after a step, which does not exist," + where);
      }
      next.resize(system_.state_size(after));
      if (!std::all_of(next.begin(), next.end(), [](double number) { return std::isfinite(number); })) {
        return Fail("the state is not finite" + where);
      }
      modes_.push_back(after);
      states_.push_back(std::move(next));
      if (with_jacobians) jacobians_.push_back(std::move(jacobian));
    }
    return true;
  }

  int final_mode() const { return modes_.back(); }

  // Pulls a cotangent of the final state back to the first, adding `at_node(k)` (empty: nothing) at each state on the
  // way. `visit(k, by_control, by_parameters)` is called for each step, from the last to the first.
  template <typename AtNode, typename Visit>
  Eigen::RowVectorXd PullBack(Eigen::RowVectorXd lambda, const AtNode& at_node, const Visit& visit) const {
    for (int k = static_cast<int>(jacobians_.size()) - 1; k >= 0; --k) {
      const int n = static_cast<int>(states_[k].size()), m = system_.num_controls(), P = system_.num_parameters();
      const Eigen::Map<const Matrix> J(jacobians_[k].data(), static_cast<int>(states_[k + 1].size()), n + m + P);
      const Eigen::RowVectorXd by = lambda * J;
      visit(k, by.segment(n, m), by.tail(P));
      lambda = by.head(n);
      at_node(k, &lambda);
    }
    return lambda;
  }

  // Computes loss and gradient with `per_interval` steps in each control interval. Returns false with a reason.
  bool Evaluate(const HybridInput& input, int per_interval, double* loss, HybridGradient* gradient) {
    const int K = input.num_intervals, steps = K * per_interval, m = system_.num_controls();
    const double h = input.duration / steps, length = input.duration / K;
    const std::vector<double> control = HeldRows(input.control, m, per_interval, 0, steps);
    if (!Move(input.mode, input.initial, 0, h, steps, control.data(), input.parameters, gradient != nullptr)) {
      return false;
    }
    *loss = 0;
    std::vector<Eigen::RowVectorXd> at_interval(K);
    Eigen::RowVectorXd by_start = Eigen::RowVectorXd::Zero(static_cast<int>(input.initial.size()));
    Eigen::RowVectorXd at_end = Eigen::RowVectorXd::Zero(static_cast<int>(states_.back().size()));
    if (gradient != nullptr) {
      gradient->control.assign(static_cast<std::size_t>(K) * m, 0.0);
      gradient->parameters.assign(input.parameters.size(), 0.0);
    }
    for (const HybridTerm& term : problem_.terms) {
      const bool end = term.at == HybridTerm::At::kEnd;
      for (int k = end ? K : 0; k < (end ? K + 1 : K); ++k) {
        if (term.interval >= 0 && term.interval != k) continue;
        const std::vector<double>& x = states_[k * per_interval];
        const int mode = modes_[k * per_interval];
        const bool fits = (term.mode < 0 || term.mode == mode) &&
                          (!term.with_state || term.function->parameter_block_sizes()[0] == static_cast<int>(x.size()));
        if (!fits && !end) continue;
        if (!fits) return Fail(term.name + ": the scheme ends in mode '" + system_.ModeName(mode) + "'");
        const double time = k * length;
        std::vector<const double*> blocks;
        if (term.with_state) blocks.push_back(x.data());
        if (term.with_initial) blocks.push_back(input.initial.data());
        if (term.with_control) blocks.push_back(input.control.data() + static_cast<std::ptrdiff_t>(k) * m);
        if (term.with_parameters) blocks.push_back(input.parameters.data());
        if (term.with_time) blocks.push_back(&time);
        if (term.with_length) blocks.push_back(&length);
        Eigen::RowVectorXd r(term.function->num_residuals());
        std::vector<Matrix> jacobians;
        std::vector<double*> places;
        for (const int size : term.function->parameter_block_sizes()) jacobians.emplace_back(r.size(), size);
        for (Matrix& jacobian : jacobians) places.push_back(jacobian.data());
        if (!term.function->Evaluate(blocks.data(), r.data(), gradient == nullptr ? nullptr : places.data())) {
          return Fail(term.name + ": the function has no value");
        }
        *loss += r.squaredNorm();
        if (gradient == nullptr) continue;
        std::size_t block = 0;
        const auto by_block = [&] { return Eigen::RowVectorXd(2 * r * jacobians[block++]); };
        if (term.with_state) {
          Eigen::RowVectorXd& sum = end ? at_end : at_interval[k];
          if (sum.size() == 0) sum = Eigen::RowVectorXd::Zero(static_cast<int>(x.size()));
          sum += by_block();
        }
        if (term.with_initial) by_start += by_block();
        if (term.with_control) Eigen::Map<Eigen::RowVectorXd>(gradient->control.data() + k * m, m) += by_block();
        if (term.with_parameters) {
          Eigen::Map<Eigen::RowVectorXd>(gradient->parameters.data(), system_.num_parameters()) += by_block();
        }
      }
    }
    if (!std::isfinite(*loss)) return Fail("the loss is not finite");
    if (gradient == nullptr) return true;
    const Eigen::RowVectorXd first =
        by_start +
        PullBack(
            at_end,
            [&](int k, Eigen::RowVectorXd* lambda) {
              if (k % per_interval == 0 && at_interval[k / per_interval].size() > 0)
                *lambda += at_interval[k / per_interval];
            },
            [&](int k, const auto& by_control, const auto& by_parameters) {
              Eigen::Map<Eigen::RowVectorXd>(
                  gradient->control.data() + static_cast<std::ptrdiff_t>(k / per_interval) * m, m) += by_control;
              Eigen::Map<Eigen::RowVectorXd>(gradient->parameters.data(), system_.num_parameters()) += by_parameters;
            });
    gradient->initial.assign(first.data(), first.data() + first.size());
    return true;
  }

 private:
  bool Fail(const std::string& reason) {
    reason_ = reason;
    return false;
  }

  const HybridProblem& problem_;
  const HybridSystem& system_;
  HybridScheme* scheme_;
  const StopRequest& stop_;
  int most_ = 0;
  std::string reason_;
  std::vector<int> modes_;
  std::vector<std::vector<double>> states_, jacobians_;
};

bool HasEqualIntervals(const HybridInput& input) {
  constexpr double kEqual = 1e-9;
  if (input.lengths.empty()) return true;
  const auto [least, most] = std::ranges::minmax(input.lengths);
  return most - least <= kEqual * most;
}

std::string WhyNotAudited(const HybridProblem& problem) {
  if (std::string wrong = WhatIsWrongWith(problem); !wrong.empty()) return wrong;
  bool any = false;
  for (const HybridTerm& term : problem.terms) {
    if (!term.IsCost()) return term.name + " is a constraint: the loss of an audit has only costs";
    if (term.at == HybridTerm::At::kEvent) return term.name + " is a cost at events, of which a scheme has none";
    if (term.interval >= 0 && !HasEqualIntervals(problem.guess)) {
      return term.name + " is a cost at a given time on control intervals of unequal lengths, expected equal ones";
    }
    any = true;
  }
  return any ? "" : "the problem has no cost, whose gradient could be audited";
}

// Replaces control intervals of unequal lengths by `count` equal ones, each with the control at its middle.
HybridInput OnEqualIntervals(HybridInput input, int count) {
  if (HasEqualIntervals(input)) {
    input.lengths.clear();
    return input;
  }
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

// The study of the errors of segments, with `finer` times as many steps.
class SegmentStudy {
 public:
  SegmentStudy(const HybridProblem& problem, HybridScheme* scheme, int steps, const StopRequest& stop)
      : problem_(problem), steps_(steps), run_(problem, scheme, stop), input_(problem.guess) {
    const int per_interval = steps / problem.guess.num_intervals, m = problem.system.num_controls();
    input_.num_intervals = steps;
    input_.control = HeldRows(problem.guess.control, m, per_interval, 0, steps);
  }

  std::vector<SegmentError> Study() {
    HybridSimulator exact(problem_.system, problem_.integration);
    if (!exact.Rollout(input_)) return {};
    const double h = input_.duration / steps_;
    std::vector<SegmentError> errors;
    for (const Segment& segment : SegmentsOf(exact.events(), h, steps_)) {
      SegmentError& error = errors.emplace_back();
      error.time = segment.event.time;
      error.mode = problem_.system.ModeName(segment.event.mode);
      error.guard = problem_.system.GuardName(segment.event.mode, segment.event.guard);
      error.step = std::min(static_cast<int>(segment.event.time / h), steps_ - 1);
      // The costate at the end of the segment is that of the final state, pulled back exactly.
      const std::vector<double> end(exact.StateAt(segment.last).begin(), exact.StateAt(segment.last).end());
      const std::vector<double> begin(exact.StateAt(segment.first).begin(), exact.StateAt(segment.first).end());
      const HybridFunctions& functions = problem_.system.functions();
      const int mode = functions.BaseMode(exact.ModeAt(segment.first)),
                last_mode = functions.BaseMode(exact.ModeAt(segment.last));
      std::vector<double> costate = FinalCotangent(exact);
      if (segment.last < steps_) costate = ExactPullBack(last_mode, end, segment.last, steps_, costate);
      const std::vector<double> right = ExactPullBack(mode, begin, segment.first, segment.last, costate);
      if (costate.empty() || right.empty()) {
        error.error = std::numeric_limits<double>::quiet_NaN();
        continue;
      }
      const auto at = [&](int finer) { return ErrorOf(segment, mode, begin, last_mode, costate, right, finer); };
      error.error = at(1);
      error.stays = !(at(kFiner) <= kStays * error.error) || std::isinf(error.error);
    }
    return errors;
  }

 private:
  // Returns the gradient of the terminal costs by the final state; a vector of ones if these read no state.
  std::vector<double> FinalCotangent(const HybridSimulator& exact) const {
    const std::vector<double> x(exact.final_state().begin(), exact.final_state().end());
    Eigen::RowVectorXd sum = Eigen::RowVectorXd::Zero(static_cast<int>(x.size()));
    for (const HybridTerm& term : problem_.terms) {
      if (term.at != HybridTerm::At::kEnd || !term.with_state) continue;
      std::vector<const double*> blocks = {x.data()};
      if (term.with_parameters) blocks.push_back(input_.parameters.data());
      if (term.with_time) blocks.push_back(&input_.duration);
      Eigen::RowVectorXd r(term.function->num_residuals());
      Matrix J(r.size(), sum.size());
      std::vector<double*> places(blocks.size(), nullptr);
      places[0] = J.data();
      if (term.function->Evaluate(blocks.data(), r.data(), places.data())) sum += 2 * r * J;
    }
    if (sum.isZero(0)) sum.setOnes();
    return {sum.data(), sum.data() + sum.size()};
  }

  std::vector<double> ExactPullBack(int mode, const std::vector<double>& x, int first, int last,
                                    const std::vector<double>& cotangent) const {
    const double h = input_.duration / steps_;
    const int m = problem_.system.num_controls();
    HybridOptions options = problem_.integration;
    options.wait_behind_guards = true;  // the state after an event may be below zero by rounding
    HybridSimulator part(problem_.system, options);
    const bool ok = part.Rollout({.mode = mode,
                                  .initial = x,
                                  .parameters = input_.parameters,
                                  .duration = (last - first) * h,
                                  .num_intervals = last - first,
                                  .control = {input_.control.begin() + static_cast<std::ptrdiff_t>(first) * m,
                                              input_.control.begin() + static_cast<std::ptrdiff_t>(last) * m},
                                  .begin = first * h});
    if (!ok || part.final_state().size() != cotangent.size()) return {};
    return part.Adjoint(cotangent).initial;
  }

  double ErrorOf(const Segment& segment, int mode, const std::vector<double>& begin, int last_mode,
                 const std::vector<double>& costate, const std::vector<double>& right, int finer) {
    const double h = input_.duration / steps_;
    const int m = problem_.system.num_controls();
    const std::vector<double> control = HeldRows(input_.control, m, finer, segment.first * finer, segment.last * finer);
    const int steps = (segment.last - segment.first) * finer;
    if (!run_.Move(mode, begin, segment.first * h, h / finer, steps, control.data(), input_.parameters, true) ||
        run_.final_mode() != last_mode) {
      return std::numeric_limits<double>::infinity();
    }
    const Eigen::Map<const Eigen::RowVectorXd> lambda(costate.data(), static_cast<int>(costate.size()));
    const Eigen::Map<const Eigen::RowVectorXd> exact(right.data(), static_cast<int>(right.size()));
    const auto nothing = [](auto&&...) {};
    return (run_.PullBack(lambda, nothing, nothing) - exact).norm() / exact.norm();
  }

  const HybridProblem& problem_;
  const int steps_;
  SchemeRun run_;
  HybridInput input_;  // with a control interval for each step
};

std::vector<double> EntriesOf(const HybridGradient& gradient, const std::string& part) {
  return part == "initial" ? gradient.initial : part == "control" ? gradient.control : gradient.parameters;
}

std::vector<HybridAudit::Part> PartsOf(const HybridProblem& problem, const HybridGradient& exact) {
  const HybridSystem& system = problem.system;
  std::vector<HybridAudit::Part> parts;
  for (const char* name : {"initial", "control", "parameters"}) {
    HybridAudit::Part part{.name = name, .entries = {}, .study = {}};
    part.study.exact = EntriesOf(exact, name);
    for (int i = 0; i < static_cast<int>(part.study.exact.size()); ++i) {
      const int m = system.num_controls();
      part.entries.push_back(part.name == "initial"   ? system.StateName(problem.guess.mode, i)
                             : part.name == "control" ? system.ControlName(i % m) + "[" + std::to_string(i / m) + "]"
                                                      : system.ParameterName(i));
    }
    if (!part.entries.empty()) parts.push_back(std::move(part));
  }
  return parts;
}

void SweepWidthsOf(const HybridProblem& problem, const HybridAuditOptions& options, SchemeRun* run,
                   HybridAudit* audit) {
  // The number of steps is no multiple, so that an event on the grid is not on the refined grid again.
  const double swept = std::min(kSweptSteps, kSweptPart * options.refinement.budget);
  const int steps = std::max(options.widths.refine * audit->steps, static_cast<int>(swept));
  const int per_interval = steps / problem.guess.num_intervals + 1;
  const double h = problem.guess.duration / (per_interval * problem.guess.num_intervals);
  WidthSweepStudy& study = audit->widths.emplace();
  double loss = 0;
  HybridGradient gradient;
  if (!run->Evaluate(problem.guess, per_interval, &loss, &gradient)) {
    study.reason = run->reason();
    return;
  }
  // Finds how far each variable moves the events.
  HybridSimulator exact(problem.system, problem.integration);
  HybridSensitivity events;
  if (exact.Rollout(problem.guess)) events = exact.Sensitivity();
  const auto grid_width = [&](int first, int count, int stride, double value) {
    double most = 0;
    for (const std::vector<double>& row : events.times) {
      double sum = 0;
      for (int i = 0; i < count; ++i) sum += row[first + i * stride];
      most = std::max(most, std::abs(sum));
    }
    const double natural = std::max(std::abs(value), 1.0) / (per_interval * problem.guess.num_intervals);
    return most > 0 ? std::min(h / most, natural) : natural;
  };
  const auto sweep = [&](const std::string& entry, double slope, double grid, const auto& change) {
    WidthSweep& added = study.sweeps.emplace_back();
    added.entry = entry;
    added.gradient = slope;
    added.grid_width = grid;
    for (const double width : WidthsOf(options.widths, grid)) {
      double values[2] = {0, 0};
      bool ok = true;
      for (const int side : {0, 1}) {
        HybridInput input = problem.guess;
        change(side == 0 ? width : -width, &input);
        ok = ok && run->Evaluate(input, per_interval, &values[side], nullptr);
      }
      added.widths.push_back(width);
      added.slopes.push_back(ok ? (values[0] - values[1]) / (2 * width) : std::numeric_limits<double>::quiet_NaN());
    }
    std::vector<WidthSweep> alone = {std::move(added)};  // each entry has a unit of its own
    const Verdict verdict = JudgeSweeps(loss, options.widths, &alone);
    added = std::move(alone[0]);
    if (IsWrong(verdict) && study.verdict != Verdict::kWrongSign) study.verdict = verdict;
  };
  const HybridSystem& system = problem.system;
  const int n0 = static_cast<int>(problem.guess.initial.size()), m = system.num_controls();
  const int K = problem.guess.num_intervals;
  for (int i = 0; i < std::min(n0, kMostVariables); ++i) {
    sweep(system.StateName(problem.guess.mode, i),
          gradient.initial[i],
          grid_width(i, 1, 1, problem.guess.initial[i]),
          [i](double width, HybridInput* input) { input->initial[i] += width; });
  }
  for (int i = 0; i < std::min(m, kMostVariables); ++i) {
    double sum = 0;
    for (int k = 0; k < K; ++k) sum += gradient.control[k * m + i];
    sweep(system.ControlName(i), sum, grid_width(n0 + i, K, m, 1.0), [=](double width, HybridInput* input) {
      for (int k = 0; k < K; ++k) input->control[k * m + i] += width;
    });
  }
  for (int i = 0; i < std::min(system.num_parameters(), kMostVariables); ++i) {
    sweep(system.ParameterName(i),
          gradient.parameters[i],
          grid_width(n0 + K * m + i, 1, 1, problem.guess.parameters[i]),
          [i](double width, HybridInput* input) { input->parameters[i] += width; });
  }
}

// Returns the worst verdict of the parts.
Verdict Overall(const std::vector<HybridAudit::Part>& parts) {
  const auto any = [&](Verdict verdict) {
    return std::any_of(parts.begin(), parts.end(), [&](const auto& part) { return part.study.verdict == verdict; });
  };
  for (const Verdict verdict : {Verdict::kWrongSign, Verdict::kWrong, Verdict::kUnknown, Verdict::kConsistent}) {
    if (any(verdict)) return verdict;
  }
  return Verdict::kRight;
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
  audit.reason = WhyNotAudited(given);
  if (!audit.ok()) return audit;
  HybridProblem problem = WithAllFree(given);
  problem.guess = OnEqualIntervals(problem.guess, std::max(options.steps, 1));
  const int K = problem.guess.num_intervals, base = std::max(1, (options.steps + K - 1) / K);
  audit.steps = base * K;
  SchemeRun run(problem, scheme, options.stop);
  const auto fail = [&](const std::string& reason) {
    audit.reason = reason;
    audit.interrupted = reason == kStopped;
    return audit;
  };

  HybridShooting shooting(problem);
  std::vector<double> derivative(shooting.num_variables());
  if (!shooting.Evaluate(shooting.initial_guess(), &audit.exact_loss, derivative.data())) {
    const bool moves = !shooting.simulator().WhyNotFinite().empty();
    return fail((moves ? "there is no exact gradient: " : "there is no exact motion: ") + shooting.WhyFailed());
  }
  const HybridInput by = shooting.InputAt(derivative);
  audit.exact = {.initial = by.initial, .control = by.control, .parameters = by.parameters};
  const std::string remark = shooting.simulator().WhyNotDifferentiable();
  if (!run.Evaluate(problem.guess, base, &audit.loss, &audit.gradient)) return fail(run.reason());
  if (!remark.empty()) {
    const auto& ties = shooting.simulator().ties();
    const bool ambiguous = std::any_of(ties.begin(), ties.end(), [](const HybridTie& tie) { return tie.ambiguous; });
    audit.verdict = ambiguous ? Verdict::kAmbiguous : Verdict::kOneSided;
    audit.reason = remark;
    return audit;
  }

  audit.parts = PartsOf(problem, audit.exact);
  std::vector<QuantityLevels> levels;
  for (const HybridAudit::Part& part : audit.parts) {
    levels.push_back({.names = part.entries, .scale = ScaleOf(part.study, part.entries, audit.exact_loss)});
  }
  const RefinementOptions& refinement = options.refinement;
  constexpr int kFewest = 4;  // levels of which an order can be told
  const auto undecided = [&] {
    return std::ranges::any_of(audit.parts, [](const auto& part) { return MayHaveAFloor(part.study); });
  };
  const auto begin = std::chrono::steady_clock::now();
  for (int level = 0; level < refinement.levels || (level < refinement.most_levels && undecided()); ++level) {
    const int coarse = base << level;
    // A level takes about as long as all before it.
    const std::chrono::duration<double> passed = std::chrono::steady_clock::now() - begin;
    const bool too_long = options.seconds > 0 && 2 * passed.count() > options.seconds;
    const bool too_many = static_cast<double>(coarse) * K * refinement.samples > refinement.budget;
    if (level >= kFewest && (too_long || too_many)) break;
    std::vector<HybridGradient> gradients(refinement.samples);
    double log_steps = 0;
    for (int sample = 0; sample < refinement.samples; ++sample) {
      double loss = 0;
      if (!run.Evaluate(problem.guess, coarse + sample, &loss, &gradients[sample])) return fail(run.reason());
      log_steps += std::log((coarse + sample) * K) / refinement.samples;
    }
    for (std::size_t i = 0; i < audit.parts.size(); ++i) {
      std::vector<std::vector<double>> entries;
      for (const HybridGradient& gradient : gradients) entries.push_back(EntriesOf(gradient, audit.parts[i].name));
      levels[i].Add(std::exp(log_steps), entries, refinement, &audit.parts[i].study);
    }
  }
  audit.order = std::numeric_limits<double>::infinity();
  for (HybridAudit::Part& part : audit.parts) {
    if (MayHaveAFloor(part.study)) part.study.verdict = Verdict::kUnknown;
    if (part.study.verdict != Verdict::kRight) audit.order = std::min(audit.order, part.study.order);
  }
  if (std::isinf(audit.order)) audit.order = 0;
  audit.verdict = Overall(audit.parts);
  if (IsWrong(audit.verdict)) {
    audit.segments = SegmentStudy(problem, scheme, audit.steps, options.stop).Study();
    for (std::size_t i = 0; i < audit.segments.size() && audit.first_wrong < 0; ++i) {
      const SegmentError& error = audit.segments[i];
      if (error.stays && error.error > kSmall) audit.first_wrong = static_cast<int>(i);
    }
  }
  if (options.width_sweep) SweepWidthsOf(problem, options, &run, &audit);
  audit.interrupted = options.stop && options.stop();
  return audit;
}

std::string HybridAudit::Why() const {
  if (!ok()) return reason;
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
