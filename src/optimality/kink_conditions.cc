#include "optimality/kink_conditions.h"

#include <ceres/cost_function.h>

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <memory>
#include <numeric>
#include <optional>
#include <string>
#include <utility>

#include "control/hybrid_shooting.h"
#include "hybrid/runge_kutta.h"
#include "optimality/hybrid_conditions.h"
#include "saltus/control/contact_sequence.h"
#include "saltus/control/scene_problem.h"

namespace saltus {
namespace {

using Eigen::VectorXd;

constexpr double kAtEnd = 1e-8;    // of the duration
constexpr double kBefore = 1e-10;  // of the duration: before an event
constexpr double kOpen = 1e-6;     // of the duration: before the end, where no event is near
constexpr double kTouch = 1e-6;    // of the size of a guard
constexpr double kApart = 1e-3;    // of the duration, between a touch and an event of the same guard
constexpr double kKick = 1e-5;     // the largest part of the size of a state that a jump is
constexpr double kTilt = 1e-6;     // of the size of the state, by which a rate is changed
constexpr double kNoJump = 1e-9;   // of the loss
constexpr int kHalvings = 60;      // of a step in which a guard is least

struct Kink {
  int mode = 0, guard = 0;
  double time = 0;        // s; that of a strike without its event is behind the final time
  bool strikes = false;   // the guard falls through zero at the final time
  bool has_event = true;  // of a strike: it is one of the motion
};

// The row (t - T) / T of the time t of an event.
class EventTimeRow final : public ceres::SizedCostFunction<1, 1> {
 public:
  explicit EventTimeRow(double duration) : duration_(duration) {}
  bool Evaluate(double const* const* blocks, double* row, double** jacobians) const override {
    row[0] = blocks[0][0] / duration_ - 1;
    if (jacobians != nullptr && jacobians[0] != nullptr) jacobians[0][0] = 1 / duration_;
    return true;
  }

 private:
  const double duration_;
};

class KinkCertifier {
 public:
  KinkCertifier(const HybridProblem& problem, const HybridInput& input)
      : problem_(ReplaceGuess(problem, input)),
        input_(problem_.guess),
        functions_(problem_.system.functions()),
        shooting_(problem_),
        integrator_(functions_) {}

  Certificate Run() {
    HybridShooting::Outcome outcome;
    if (functions_.CreatesModes() || !shooting_.Simulate(input_, &outcome)) return {};
    loss_ = outcome.loss;
    FindKinks();
    if (kinks_.empty()) return {};
    Certificate certificate = CertifySide(nullptr, &multipliers_);
    const bool leaves_node = std::ranges::any_of(certificate.impacts, &ImpactCertificate::LeavesNode);
    if (leaves_node && certificate.verdict == Certificate::Verdict::kNotStationary) return certificate;
    if (!certificate.IsStationary()) return {};
    certificate.verdict = Certificate::Verdict::kStationaryOnGrid;
    std::string names;
    for (const Kink& kink : kinks_) {
      const std::string guard = problem_.system.GuardName(kink.mode, kink.guard);
      const std::string name = guard + (kink.strikes ? " at the final time" : " just touches");
      names += (names.empty() ? "" : ", ") + name;
      const std::optional<std::string> less = DescribeLowerSide(kink);
      if (!less) return {};
      if (less->empty()) continue;
      certificate.verdict = Certificate::Verdict::kNotStationary;
      certificate.reason = name + ", and the loss falls " + *less;
      return certificate;
    }
    certificate.reason = names + ": a kink, with multipliers of the right sign on both sides";
    if (!certificate.curvature) certificate.curvature = std::move(curvature_);
    return certificate;
  }

 private:
  static HybridProblem ReplaceGuess(HybridProblem problem, const HybridInput& input) {
    problem.guess = input;
    if (problem.guess.control.empty()) {
      problem.guess.control.assign(static_cast<std::size_t>(input.num_intervals) * problem.system.num_controls(), 0.0);
    }
    problem.guess_states.clear();
    if (problem.integration.steps_per_interval == 0) {
      // The final state of a motion with an event at its end is not accurate, however many steps it has.
      HybridSimulator simulator(problem.system, problem.integration);
      if (simulator.Rollout(TruncateInput(problem.guess, (1 - kOpen) * input.duration))) {
        problem.integration.steps_per_interval = simulator.steps_per_interval();
        problem.integration.divisions = simulator.divisions();
      }
    }
    return problem;
  }

  int width() const { return problem_.system.num_controls(); }
  HybridSimulator& simulator() { return shooting_.simulator(); }
  ModePoint PointAt(int mode, double t, const double* x) const {
    const std::vector<double> times = input_.Times();
    const auto next = std::ranges::upper_bound(times, t - kBefore * input_.duration);
    const auto k = std::clamp<std::ptrdiff_t>(next - times.begin() - 1, 0, input_.num_intervals - 1);
    return {mode, t, x, input_.control.data() + k * width(), input_.parameters.data()};
  }
  // Returns the rate of a guard, and sets its value.
  double RateAt(const ModePoint& at, int guard, double* value) const {
    std::vector<double> slope(functions_.most_states());
    functions_.Flow(at, slope.data());
    double rate = 0;
    *value = functions_.GuardRate(at, guard, slope.data(), &rate);
    return rate;
  }

  // ------------------------------------------------------------------------------------------------------------ kinks

  void FindKinks() {
    const double end = input_.duration * (1 - kAtEnd);
    for (const HybridEvent& event : simulator().events()) {
      if (event.time >= end) kinks_.push_back({event.mode, event.guard, event.time, true, true});
    }
    const bool has_end = !kinks_.empty();
    std::map<std::pair<int, int>, double> sizes;
    std::vector<std::pair<Kink, double>> least;  // with their values
    const int count = simulator().num_steps();
    for (int i = 0; i < count; ++i) {
      if (simulator().IsReset(i)) continue;
      const int mode = simulator().StepMode(i);
      const double begin = simulator().StepTime(i),
                   length = (i + 1 < count ? simulator().StepTime(i + 1) : input_.duration) - begin;
      const ModePoint from = PointAt(mode, begin + 2 * kBefore * input_.duration, simulator().StepState(i).data());
      for (int guard = 0; guard < functions_.num_guards(mode); ++guard) {
        double& size = sizes[{mode, guard}];
        double value = 0, at_end = 0;
        const double falls = RateAt({mode, begin, from.x, from.u, from.p}, guard, &value);
        size = std::max(size, std::abs(value));
        if (functions_.IsSwitch(mode, guard) || !(length > 0)) continue;
        const double rises = RateAfter(from, begin, length, guard, &at_end);
        const bool is_last = i + 1 == count;
        if (falls < 0 && rises >= 0) {
          least.push_back(FindMinimum(from, begin, length, guard));
        } else if (is_last && rises < 0 && !has_end) {
          least.emplace_back(Kink{mode, guard, input_.duration + at_end / -rises, true, false}, at_end);
        }
      }
    }
    for (const auto& [kink, value] : least) {
      const bool near = std::ranges::any_of(simulator().events(), [&, &kink = kink](const HybridEvent& event) {
        return event.guard == kink.guard && std::abs(event.time - kink.time) <= kApart * input_.duration;
      });
      if (!near && std::abs(value) <= kTouch * sizes[{kink.mode, kink.guard}]) kinks_.push_back(kink);
    }
  }

  double RateAfter(const ModePoint& from, double begin, double length, int guard, double* value) {
    std::vector<double> after(functions_.most_states());
    integrator_.Step({{from.mode, begin, from.x, from.u, from.p}, length, false}, after.data());
    return RateAt({from.mode, begin + length, after.data(), from.u, from.p}, guard, value);
  }

  // Halves a step in which a guard falls first and then rises.
  std::pair<Kink, double> FindMinimum(const ModePoint& from, double begin, double length, int guard) {
    double low = 0, high = length, value = 0;
    for (int k = 0; k < kHalvings; ++k) {
      const double middle = 0.5 * (low + high);
      (RateAfter(from, begin, middle, guard, &value) < 0 ? low : high) = middle;
    }
    return {Kink{from.mode, guard, begin + high, false, false}, value};
  }

  // ------------------------------------------------------------------------------------------------------------ sides

  // Returns the input until a time, to which the last interval is made longer if that is behind its end.
  static HybridInput TruncateInput(HybridInput input, double time) {
    std::vector<double> times = input.Times();
    times.back() = std::max(times.back(), time);
    const std::size_t width = input.control.size() / static_cast<std::size_t>(input.num_intervals);
    input.lengths.clear();
    for (int k = 0; k < input.num_intervals && times[k] < time; ++k) {
      input.lengths.push_back(std::min(times[k + 1], time) - times[k]);
    }
    input.num_intervals = static_cast<int>(input.lengths.size());
    input.control.resize(input.lengths.size() * width);
    input.duration = time;
    return input;
  }

  // The motion on one side of the kinks: of all strikes as they are, but of `other` the other side.
  struct Side {
    HybridProblem problem;
    HybridInput input;
    std::vector<GuardTouch> touches;
  };
  // Returns the side, with the rows that keep motions there. Its motion ends just before a strike without its event,
  // and just behind one with it; nothing if one of several strikes is with its event, and another one without.
  std::optional<Side> SideOf(const Kink* other) const {
    Side side{problem_, input_, {}};
    bool with = false, without = false;
    for (const Kink& kink : kinks_) {
      if (!kink.strikes) {
        side.touches.push_back({kink.mode, kink.guard, kink.time});
        continue;
      }
      if (problem_.free.duration) return std::nullopt;  // the kink would move with it
      const bool has_event = kink.has_event != (&kink == other);
      if (has_event) {
        with = true;
        HybridTerm term{.name = "kink", .at = HybridTerm::Timing::kEvent, .role = HybridTerm::Role::kInequality};
        const std::string name = problem_.system.GuardName(kink.mode, kink.guard);
        const auto is_same = [&](const HybridEvent& event) {
          return problem_.system.GuardName(event.mode, event.guard) == name && event.time < kink.time;
        };
        term.event = name;
        term.with_time = true;
        term.occurrence = static_cast<int>(std::ranges::count_if(shooting_.simulator().events(), is_same));
        if (!kink.has_event) side.input = TruncateInput(input_, kink.time + kBefore * input_.duration);
        term.function = std::make_shared<EventTimeRow>(side.input.duration);
        side.problem.terms.push_back(std::move(term));
      } else {
        without = true;
        if (kink.has_event) side.input = TruncateInput(input_, kink.time - kBefore * input_.duration);
        side.touches.push_back({kink.mode, kink.guard, side.input.duration});
      }
    }
    if (with && without) return std::nullopt;
    return side;
  }
  Certificate CertifySide(const Kink* other, std::vector<TermMultiplier>* multipliers = nullptr) const {
    const std::optional<Side> side = SideOf(other);
    if (!side) return {};
    return CertifyConditions(side->problem, side->input, {.touches = side->touches, .multipliers = multipliers});
  }

  // Returns how the other side of a kink has a lower loss; empty if it has not; nothing if that cannot be computed.
  std::optional<std::string> DescribeLowerSide(const Kink& kink) {
    HybridSimulator before(problem_.system, problem_.integration);
    const double time = std::min(kink.time, input_.duration) - (kink.strikes ? kBefore * input_.duration : 0);
    if (!before.Rollout(TruncateInput(input_, time)) || before.final_mode() != kink.mode) return std::nullopt;
    const std::vector<double> x(before.final_state().begin(), before.final_state().end());
    const ModePoint at = PointAt(kink.mode, time, x.data());
    std::vector<double> after(functions_.most_states());
    const int next = functions_.Reset(at, kink.guard, after.data());
    if (next < 0) return "";  // no motion has this event
    if (!kink.strikes) {
      const std::optional<double> slope = SlopeByJump(kink, at, next);
      if (!slope) return std::nullopt;
      return *slope < -kCertificateTolerance ? "with an event" : "";
    }
    const std::string falls = kink.has_event ? "without the event" : "with the event";
    const std::optional<Side> side = SideOf(&kink);
    if (!side) return std::nullopt;
    HybridShooting shooting(side->problem);
    HybridShooting::Outcome outcome;
    if (!shooting.Simulate(side->input, &outcome)) return std::nullopt;
    const double left_out = 100 * std::abs(1 - side->input.duration / input_.duration);
    const double jump = outcome.loss - loss_, noise = std::max(kNoJump, left_out) * std::abs(loss_);
    if (std::abs(jump) > noise) return jump < 0 ? falls : "";
    Certificate certificate = CertifySide(&kink);
    if (!certificate.IsStationary()) return falls;
    curvature_ = std::move(certificate.curvature);
    return "";
  }

  // Returns the sizes of the components of the state over the motion.
  VectorXd SizesOf(int mode) {
    VectorXd sizes = VectorXd::Zero(problem_.system.state_size(mode));
    for (int i = 0; i < simulator().num_steps(); ++i) {
      const std::span<const double> x = simulator().StepState(i);
      if (simulator().StepMode(i) != mode) continue;
      sizes = sizes.cwiseMax(Eigen::Map<const VectorXd>(x.data(), sizes.size()).cwiseAbs());
    }
    const double largest = sizes.maxCoeff();
    return sizes.unaryExpr([&](double size) { return size > 0 ? size : std::max(largest, 1.0); });
  }

  // Returns the derivative of the Lagrangian by the jump of the state that the reset is behind a touch, as a part of
  // the size of the state; nothing if the jump does not vanish with the rate of the guard, or if it leads to no motion.
  std::optional<double> SlopeByJump(const Kink& kink, const ModePoint& at, int next) {
    const VectorXd sizes = SizesOf(kink.mode);
    const Eigen::Map<const VectorXd> x(at.x, sizes.size());
    const auto rate = [&](const VectorXd& state) {
      double value = 0;
      return RateAt({kink.mode, at.t, state.data(), at.u, at.p}, kink.guard, &value);
    };
    VectorXd by = VectorXd::Zero(sizes.size());  // of the rate, by parts of the sizes
    for (Eigen::Index i = 0; i < sizes.size(); ++i) {
      VectorXd above = x, below = x;
      above[i] += kTilt * sizes[i];
      below[i] -= kTilt * sizes[i];
      by[i] = (rate(above) - rate(below)) / (2 * kTilt);
    }
    if (problem_.system.state_size(next) != sizes.size() || by.isZero(0)) return std::nullopt;
    const auto jump_from = [&](double tilt) {
      const VectorXd tilted = x - tilt * by.normalized().cwiseProduct(sizes);
      VectorXd after(functions_.most_states());
      functions_.Reset({kink.mode, at.t, tilted.data(), at.u, at.p}, kink.guard, after.data());
      return VectorXd((after.head(sizes.size()) - tilted).cwiseQuotient(sizes));
    };
    const VectorXd jump = jump_from(kTilt);
    if (!(jump.norm() > 0)) return 0;
    if (!((jump_from(2 * kTilt) - 2 * jump).norm() < 0.1 * jump.norm())) return std::nullopt;
    const VectorXd step = jump.normalized().cwiseProduct(sizes);
    const std::optional<std::vector<HybridTerm>> terms = TermsBehind(kink);
    if (!terms) return std::nullopt;
    const auto loss = [&](double part) { return LossAfterKink(kink, *terms, next, x + part * step); };
    const double slope = (loss(2 * kKick) - loss(kKick)) / kKick / std::abs(loss_);
    return std::isfinite(slope) ? std::optional(slope) : std::nullopt;
  }

  // Returns the control intervals that end before a kink.
  int IntervalsBefore(const Kink& kink) const { return TruncateInput(input_, kink.time).num_intervals - 1; }

  // Returns the terms of the Lagrangian behind a kink, whose intervals and events are numbered from there; what comes
  // before it does not change. Returns nothing if a term counts the event of the kink, or reads what lies on both of
  // its sides.
  std::optional<std::vector<HybridTerm>> TermsBehind(const Kink& kink) {
    std::vector<HybridTerm> terms;
    const std::vector<HybridEvent>& events = simulator().events();
    const auto count_before = [&](const HybridTerm& term, double time) {
      return static_cast<int>(std::ranges::count_if(events, [&](const HybridEvent& event) {
        return event.time < time && term.CountsAt(functions_, event.mode, event.guard);
      }));
    };
    const auto add = [&](HybridTerm term) {
      if (term.with_initial) return false;
      if (term.always) return term.interval < IntervalsBefore(kink);
      if (term.at == HybridTerm::Timing::kEvent) {
        if (term.CountsAt(functions_, kink.mode, kink.guard)) return false;
        const int before = count_before(term, kink.time);
        if (term.occurrence >= 0 && term.occurrence < before) return true;
        if (term.occurrence >= 0) term.occurrence -= before;
      }
      if (term.at != HybridTerm::Timing::kEachInterval) {
        terms.push_back(std::move(term));
        return true;
      }
      const int skipped = IntervalsBefore(kink);
      for (int k = skipped + 1; k < input_.num_intervals; ++k) {
        if (term.interval >= 0 && term.interval != k) continue;
        terms.push_back(term);
        terms.back().interval = k - skipped;
      }
      return true;
    };
    for (const HybridTerm& term : problem_.terms) {
      if (term.IsCost() && !add(term)) return std::nullopt;
    }
    for (const TermMultiplier& multiplier : multipliers_) {
      if (multiplier.value == 0) continue;
      if (multiplier.term >= std::ssize(problem_.terms)) return std::nullopt;
      HybridTerm term = problem_.terms[multiplier.term];
      VectorXd factors = VectorXd::Zero(term.NumRows());
      factors[multiplier.row] = multiplier.value;
      term.role = HybridTerm::Role::kValue;
      term.function = WithFactors(term.function, std::move(factors));
      term.interval = multiplier.interval;
      if (multiplier.event >= 0) term.occurrence = count_before(term, events[multiplier.event].time);
      if (!add(std::move(term))) return std::nullopt;
    }
    return terms;
  }

  // Returns the sum of terms behind a kink from a state there; not a number without a motion.
  double LossAfterKink(const Kink& kink, const std::vector<HybridTerm>& terms, int mode, const VectorXd& state) const {
    HybridProblem rest = problem_;
    rest.terms = terms;
    HybridInput input = input_;
    const int skipped = IntervalsBefore(kink);
    const std::vector<double> times = input_.Times();
    input.mode = mode;
    input.initial.assign(state.begin(), state.end());
    input.begin = input_.begin + kink.time;
    input.duration = input_.duration - kink.time;
    input.control.erase(input.control.begin(), input.control.begin() + static_cast<std::ptrdiff_t>(skipped) * width());
    input.num_intervals = input_.num_intervals - skipped;
    input.lengths = {times[skipped + 1] - kink.time};
    for (int k = skipped + 1; k < input_.num_intervals; ++k) input.lengths.push_back(times[k + 1] - times[k]);
    rest.guess = input;
    rest.guess.begin = 0;
    rest.integration.wait_behind_guards = true;  // the touch is at a guard of zero within rounding
    HybridShooting shooting(rest);
    HybridShooting::Outcome outcome;
    return shooting.Simulate(input, &outcome) ? outcome.loss : std::numeric_limits<double>::quiet_NaN();
  }

  const HybridProblem problem_;
  const HybridInput& input_;
  const HybridFunctions& functions_;
  mutable HybridShooting shooting_;
  RungeKutta integrator_;
  std::vector<Kink> kinks_;
  std::vector<TermMultiplier> multipliers_;  // of the constraints, with the conditions of the motion as it is
  // The curvature on the other side of a strike. It is along motions whose guard is zero at the final time, on which
  // the losses of both sides are the same.
  std::optional<Curvature> curvature_;
  double loss_ = 0;
};

}  // namespace

Certificate CertifyKinks(const HybridProblem& problem, const HybridInput& input) {
  return KinkCertifier(problem, input).Run();
}

Certificate CertifyKinks(const Scene& scene, const std::vector<double>& control, const std::vector<double>& durations) {
  if (!scene.design.empty() || !UnsupportedByHybridProblem(scene).empty()) return {};
  const HybridProblem problem = MakeHybridProblem(scene);
  HybridInput input = problem.guess;
  input.control = control;
  input.lengths = durations;
  if (!durations.empty()) input.duration = std::accumulate(durations.begin(), durations.end(), 0.0);
  input.num_intervals = static_cast<int>(control.size()) / scene.control_width();
  Certificate certificate = CertifyKinks(problem, input);
  if (std::ranges::any_of(certificate.impacts, &ImpactCertificate::LeavesNode)) return {};
  std::erase_if(certificate.impacts, [](const ImpactCertificate& one) { return one.b.starts_with("waypoint "); });
  const ContactSequence pairs = AllPairs(scene);
  for (ImpactCertificate& impact : certificate.impacts) {
    NamePair(scene,
             *std::ranges::find_if(pairs,
                                   [&](const Candidate& c) { return ContactSequenceToString(scene, {c}) == impact.b; }),
             &impact);
  }
  return certificate;
}

}  // namespace saltus
