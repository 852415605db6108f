#include "saltus/hybrid/hybrid_simulator.h"

#include <glog/logging.h>

#include <algorithm>
#include <cmath>
#include <iterator>
#include <limits>
#include <numeric>

#include "base/number_text.h"
#include "base/statistics.h"
#include "base/table.h"
#include "hybrid/hidden_changes.h"
#include "hybrid/motion_derivatives.h"
#include "hybrid/rollout.h"

namespace saltus {
namespace {

// Ends the messages on flows that may be stiff.
constexpr char kOfStiff[] =
    "; lower its fastest rates, or make it linear in the state with numbers in place of parameters as coefficients, "
    "since such flows have a closed form";
constexpr int kFewestSteps = 16;            // of a motion
constexpr int kMostSteps = 1 << 20;         // of a motion
constexpr int kMostGivenSteps = 1 << 24;    // likewise, that the user chooses: a few GB
constexpr int kMostForGuards = 1 << 18;     // likewise, where only guards ask for more
constexpr double kRounding = 1e-15;         // of a component, of the largest of the final state
constexpr double kOfProjections = 1e-12;    // likewise, where the state is projected and more steps do not lower it
constexpr double kSlopeChange = 0.1;        // relative, in the part of a step in which a closed form is compared
constexpr int kMostHalvings = 60;           // of that part
constexpr double kSameFlow = 1e-6;          // of a step: a closed form of the flow and its integration
constexpr double kRoundingOfFlow = 1e-12;   // likewise, of the largest state
constexpr double kSameFlowAsHalves = 4;     // times the difference of one step of the integration and two halves
constexpr int kSameFailures = 4;            // doublings of the steps
constexpr double kSameTime = 6;             // steps: failures at the same time
constexpr double kLater = 16;               // steps: not a failure of steps that are too long
constexpr double kSameRefusal = 1e-3;       // steps: refusals at the same time
constexpr double kSameAccuracy = 10;        // times the error that was reached
constexpr double kHardlyFalls = 1e-2;       // of an error, that is left of it with twice as many steps
constexpr double kHalving = 256;            // of steps: how much the error of a method of order 8 grows
constexpr double kRoundingOfMotion = 1e-7;  // an error that more steps do not lower may be rounding if it is below this
constexpr int kMostWithoutJump = 512;       // steps of a motion after which a jump of the flow is looked for
constexpr int kMostWithoutEnd = 1 << 14;    // likewise, after which an error that does not fall ends the search
constexpr int kHopeless = 6;                // doublings without convergence until then
constexpr double kFirstOrder = 4e-3;  // of an error before as many doublings: it falls hardly faster than the step
constexpr double kBegins = 0.1;       // of the final difference of two motions: where they begin to differ
constexpr int kSlowDoublings = 4;     // of the steps, in which errors fall like a low power of the step
constexpr double kLeastFall = 1.2, kMostFall = 7;  // factors by which they fall in each
constexpr double kMargin = 4;                      // of the number of steps that such a fall leads to
constexpr int kScanned = 128;                      // points in a step
constexpr int kBisections = 46;
constexpr double kJump = 1e-6;                 // of a slope, relative, and of what it does to the motion
constexpr double kPole = 1e6;                  // of the slopes at the ends of the step: beside a pole
constexpr double kSamePlace = 1e-12;           // relative: on both sides of a jump
constexpr double kConverges = 0.3;             // at most, an error in comparison to that of half as many steps
constexpr int kStalls = 2;                     // doublings without convergence after which the error is rounding
constexpr int kScatters = 3;                   // likewise, after which it is that of impacts
constexpr double kMostScatter = 1e-2;          // the largest of these that is accepted
constexpr int kFewestForScatter = 2048;        // steps of a motion with it
constexpr int kFewPlaces = 16;                 // one step in so many at most is divided, of those that do not converge
constexpr double kLooks = 4;                   // times as many steps, after which such steps are looked for again
constexpr double kSamePart = 1e-13;            // of the duration: times so near to each other are one
constexpr std::size_t kMostDivided = 1 << 12;  // times that divide control intervals

constexpr const char* kEndsThere =
    ", however short the steps are: there is no solution after that, or the flow has no value beside it. If the motion "
    "goes on, as that of a tank that is empty, give the mode a guard that falls through zero a little before, with a "
    "reset to a mode whose flow has values there";

}  // namespace

class HybridSimulator::Impl {
 public:
  Impl(HybridSystem of_user, const HybridOptions& chosen)
      : system(std::move(of_user)),
        options(chosen),
        given(chosen.divisions),
        steps(std::max(chosen.steps_per_interval, 0)),
        run(std::make_unique<RolloutRun>(system, options)),
        derivatives(system) {}

  static bool IsSame(const HybridEvent* a, const HybridEvent* b) { return a->guard == b->guard && a->mode == b->mode; }
  // The events of a motion, but switches that it meets where the control jumps: rounding decides whether it meets them
  // before the jump or behind it, and how often.
  std::vector<const HybridEvent*> EventsBesideJumps(const RolloutRun& of) const {
    constexpr double kJumpTime = 1e-9;  // of a control interval
    std::vector<const HybridEvent*> events;
    for (const HybridEvent& event : of.events()) {
      const bool at_jump = event.is_switch && ControlJumpNear(input, system.num_controls(), event.time, kJumpTime) > 0;
      if (!at_jump) events.push_back(&event);
    }
    return events;
  }
  bool HaveSameEvents(const RolloutRun& one, const RolloutRun& other) const {
    return one.tape().final_mode == other.tape().final_mode &&
           std::ranges::equal(EventsBesideJumps(one), EventsBesideJumps(other), IsSame);
  }

  // The largest relative difference of final state and event times of two motions; infinite if they have other events.
  // The last of bounces that accumulate depend on rounding, and count by what they do to the final state. Changes of up
  // to `rounding` of the largest component do not count.
  double Difference(const RolloutRun& one, const RolloutRun& other, double rounding = kRounding) const {
    const bool by_state = system.functions().EndsAccumulations() && one.tape().final_mode == other.tape().final_mode;
    if (!by_state && !HaveSameEvents(one, other)) return std::numeric_limits<double>::infinity();
    const std::vector<const HybridEvent*> events = EventsBesideJumps(one), others = EventsBesideJumps(other);
    const auto end = std::ranges::mismatch(events, others, IsSame);
    double difference = 0;
    auto of_other = others.begin();
    for (auto event = events.begin(); event != end.in1; ++event) {
      difference = std::max(difference, std::abs((*event)->time - (*of_other++)->time) / input.duration);
    }
    const double *at = &one.tape().numbers[one.tape().final_state],
                 *to = &other.tape().numbers[other.tape().final_state];
    return std::max(difference, RelativeChange(one, rounding, [&](int i) { return std::abs(at[i] - to[i]); }));
  }

  // Returns the largest change of a component of the final state, relative to its largest value in the modes that have
  // it: in the final mode or, of a system that creates its modes, in all of them. A mode in which accumulating events
  // end has the states of the modes that lead to it, and is entered with values that are rounding.
  double RelativeChange(const RolloutRun& of, double rounding, const auto& change_of) const {
    const MotionTape& tape = of.tape();
    const int mode = tape.final_mode, n = system.state_size(mode);
    const double* at = &tape.numbers[tape.final_state];
    double relative = 0;
    const double largest = Largest(std::span(at, n));
    for (int i = 0; i < n; ++i) {
      const double change = change_of(i);
      if (change <= rounding * largest) continue;
      double size = std::abs(at[i]);
      for (const TapeEntry& entry : tape.entries) {
        const bool ends_accumulation = of.accumulation() && system.state_size(entry.mode) == n;
        const bool is_piece = system.functions().BaseMode(entry.mode) == system.functions().BaseMode(mode);
        const bool has_it = is_piece || ends_accumulation || system.functions().CreatesModes();
        if (has_it) size = std::max(size, std::abs(tape.numbers[entry.x + i]));
      }
      if (size > 0) relative = std::max(relative, change / size);
    }
    return relative;
  }

  // Returns the error of steps that events cut, by two halves of each: a motion with twice as many steps may take the
  // same ones. Returns that of the steps alone if the motion has no finite derivative after them.
  double ErrorOfCutSteps(const RolloutRun& of, double rounding = kRounding) {
    const MotionDerivatives::Change change =
        derivatives.CompareWithHalvedCutSteps(input, of.tape(), of.events().size());
    double largest = RelativeChange(of, rounding, [&](int i) { return std::abs(change.final_state[i]); });
    for (const double time : change.times) largest = std::max(largest, std::abs(time) / input.duration);
    const bool finite = change.final_state.allFinite() && AllFinite(change.times);
    return finite ? largest : change.of_steps;
  }

  // Returns the error of a motion without that of components that are rounding errors of others: the projection onto
  // the equations of closed contacts adds them in each step. They are no more than kOfProjections of the largest
  // component, and with twice as many steps their difference hardly falls. Infinite if another component has a large
  // error.
  double ErrorButRounding(const RolloutRun& coarse, const RolloutRun& fine, double before, double now) {
    const double inf = std::numeric_limits<double>::infinity();
    if (!system.functions().EndsAccumulations() || !(now > kHardlyFalls * before)) return inf;
    const double most = std::max(options.tolerance, kOfProjections);
    if (Difference(coarse, fine, kOfProjections) > most || ErrorOfCutSteps(coarse, kOfProjections) > most) return inf;
    return most;
  }

  // Returns the value of HybridSimulator::IntegrationError().
  double Error() {
    if (!error) {
      RolloutRun finer(system, options), finest(system, options);
      error = finer.Run(input, Steps(2 * steps), /*compare_guards=*/true) == RolloutEnd::kDone
                  ? std::max(Difference(*run, finer), ErrorOfCutSteps(*run))
                  : std::numeric_limits<double>::infinity();
      if (*error > options.tolerance && std::isfinite(*error) && system.functions().EndsAccumulations() &&
          finest.Run(input, Steps(4 * steps)) == RolloutEnd::kDone) {
        const double but = ErrorButRounding(*run, finer, Difference(*run, finer), Difference(finer, finest));
        error = std::min(*error, but);
      }
      unresolved = finer.unresolved().what;
      NoteHidden(FindHidden(*run));
    }
    return *error;
  }

  // Notes changes of the last rollout whose effect is not known.
  void NoteHidden(const HiddenChanges& changes) {
    hides = changes.length > 0;
    if (hides) error = std::numeric_limits<double>::infinity();
    if (unresolved.empty()) unresolved = changes.what;
  }

  RolloutSteps Steps(int per_interval) const { return {per_interval, options.divisions}; }
  HiddenChanges FindHidden(const RolloutRun& of, Changes which = Changes::kHidden) const {
    return FindHiddenChanges(system, input, of.tape(), options.tolerance, which);
  }

  // Divides control intervals at the ends of parts of steps with changes. Returns whether they were not so yet.
  bool Divide(const HiddenChanges& changes) {
    const auto is_near = [](double a, double b) { return b - a <= kSamePart; };
    std::vector<double> divisions;
    std::ranges::merge(options.divisions, changes.ends, std::back_inserter(divisions));
    const auto repeated = std::ranges::unique(divisions, is_near);
    divisions.erase(repeated.begin(), repeated.end());
    if (divisions.size() > kMostDivided || divisions.size() == options.divisions.size()) return false;
    options.divisions = std::move(divisions);
    return true;
  }

  // Returns the step with which a motion and one of twice as many steps begin to differ; null if they do not.
  const TapeEntry* FirstToDiffer(const RolloutRun& coarse, const RolloutRun& fine, double difference) const {
    const MotionTape &a = coarse.tape(), &b = fine.tape();
    const double same_time = 1e-9 * input.duration;
    const TapeEntry* culprit = nullptr;
    auto other = b.entries.begin();
    for (const TapeEntry& entry : a.entries) {
      if (entry.kind == TapeEntry::Kind::kReset || !(entry.h > 0)) continue;
      while (other != b.entries.end() && (other->kind == TapeEntry::Kind::kReset || other->t < entry.t - same_time))
        ++other;
      if (other == b.entries.end()) break;
      if (other->mode != entry.mode || other->t > entry.t + same_time) continue;
      double largest = 0, apart = 0;
      for (int i = 0; i < system.state_size(entry.mode); ++i) {
        largest = std::max(largest, std::abs(a.numbers[entry.x + i]));
        apart = std::max(apart, std::abs(a.numbers[entry.x + i] - b.numbers[other->x + i]));
      }
      if (culprit != nullptr && apart > kBegins * difference * largest) break;
      culprit = &entry;
    }
    return culprit;
  }

  // Says why the tolerance is out of reach: errors of the last doublings fall like a low power of the step, as they do
  // where the flow is not smooth. Empty if they do not. `errors`: of each number of steps up to `num_steps`, infinite
  // where the motions have other events.
  std::string ReasonSlowConvergence(const std::vector<double>& errors, double num_steps, const RolloutRun& coarse,
                                    const RolloutRun& fine) const {
    if (num_steps < kMostWithoutEnd || errors.size() <= kSlowDoublings) return "";
    const double now = errors.back(), before = errors[errors.size() - 1 - kSlowDoublings];
    for (auto next = errors.end() - kSlowDoublings; next != errors.end(); ++next) {
      if (!(next[-1] > kLeastFall * next[0] && next[-1] < kMostFall * next[0])) return "";
    }
    const double fall = std::pow(before / now, 1.0 / kSlowDoublings);
    const double needed = num_steps * std::exp2(std::log(now / options.tolerance) / std::log(fall));
    const TapeEntry* culprit = FirstToDiffer(coarse, fine, now);
    const bool may_reach = !(needed > kMargin * kMostSteps) && 2 * num_steps <= kMostSteps;
    if (may_reach || culprit == nullptr) return "";
    return "the steps do not reach the tolerance: twice as many lower the error only by a factor of " +
           ToText(fall, 2) + ", to " + ToText(now, 2) + " with " + ToText(num_steps, 10) +
           ". The flow is not smooth in mode '" + system.ModeName(culprit->mode) + "' at t = " + ToText(culprit->t, 6) +
           ", as sqrt(v) is not at v = 0: begin beside that place, make the flow smooth there, "
           "or choose a larger tolerance";
  }

  // Looks for a jump of the flow in the step with which a motion and one of twice as many steps begin to differ:
  // bisects between the points of the step between which the slope changes most. Empty if there is none.
  std::string FindJump(const RolloutRun& coarse, const RolloutRun& fine, double difference) const {
    const MotionTape& a = coarse.tape();
    const TapeEntry* culprit = FirstToDiffer(coarse, fine, difference);
    if (culprit == nullptr) return "";
    const int n = system.state_size(culprit->mode);
    const double* u = input.control.data() + culprit->interval * system.num_controls();
    FlowStep step{{culprit->mode, culprit->t, &a.numbers[culprit->x], u, input.parameters.data()}, 0};
    RungeKutta integrator(system.functions());
    std::vector<double> first(n), after(n);
    system.functions().Flow(step, first.data());
    const auto slope_after = [&](double s) {
      std::vector<double> slope(n);
      step.h = s;
      integrator.Step(step, first.data(), after.data(), slope.data());
      return slope;
    };
    std::vector<double> sizes(n), low = first, high;
    double from = 0, to = 0, most = 0;
    int component = 0;
    std::vector<std::vector<double>> slopes = {first};
    for (int i = 1; i <= kScanned; ++i) slopes.push_back(slope_after(culprit->h * i / kScanned));
    for (const std::vector<double>& slope : slopes) {
      for (int j = 0; j < n; ++j) sizes[j] = std::max(sizes[j], std::abs(slope[j]));
    }
    const double rounding = kRoundingOfFlow * std::ranges::max(sizes);
    for (int i = 1; i <= kScanned; ++i) {
      for (int j = 0; j < n; ++j) {
        const double change = std::abs(slopes[i][j] - slopes[i - 1][j]);
        if (!(change > most * sizes[j]) || sizes[j] <= rounding) continue;
        most = change / sizes[j];
        component = j;
        from = culprit->h * (i - 1) / kScanned;
        to = culprit->h * i / kScanned;
        low = slopes[i - 1];
        high = slopes[i];
      }
    }
    for (int i = 0; i < kBisections && most > 0; ++i) {
      const double middle = 0.5 * (from + to);
      const std::vector<double> at = slope_after(middle);
      const bool before = std::abs(at[component] - low[component]) > std::abs(high[component] - at[component]);
      (before ? to : from) = middle;
      (before ? high : low) = at;
    }
    if (!(most > 0)) return "";
    const double jump = std::abs(high[component] - low[component]);
    const double largest = Largest(std::span(&a.numbers[a.final_state], system.state_size(a.final_mode)));
    if (jump <= kJump * sizes[component] + rounding || jump * culprit->h <= kJump * difference * largest) return "";
    const std::string what = "the flow of mode '" + system.ModeName(culprit->mode) + "' ";
    const std::string where = " at t = " + ToText(culprit->t + from, 10);
    const double beside = std::max(std::abs(slopes.front()[component]), std::abs(slopes.back()[component]));
    if (std::min(std::abs(low[component]), std::abs(high[component])) > kPole * beside) {
      return what + "grows beyond all bounds" + where + ", in the derivative of " +
             system.StateName(culprit->mode, component) + ": there is no solution after that";
    }
    // The states on both sides of a jump are the same. Those of steps that are too long for the flow are not.
    slope_after(from);
    const std::vector<double> before_jump = after;
    slope_after(to);
    for (int i = 0; i < n; ++i) {
      const double size = std::abs(before_jump[i]) + culprit->h * sizes[i];
      if (std::abs(after[i] - before_jump[i]) > kSamePlace * size) return "";
    }
    return what + "jumps" + where + ": the derivative of " + system.StateName(culprit->mode, component) +
           " changes from " + ToText(low[component], 6) + " to " + ToText(high[component], 6) +
           ". Declare a switch there (kNumSwitches; a condition of saltus.where in Python), or give each side a mode "
           "of "
           "its own";
  }

  // Returns the difference of the last rollout from one with another number of steps.
  double DifferenceTo(int other_steps) const {
    RolloutRun other(system, options);
    return other.Run(input, Steps(other_steps)) == RolloutEnd::kDone ? Difference(*run, other)
                                                                     : std::numeric_limits<double>::infinity();
  }

  // Keeps the rollout `of`, whose error is known, as the last one. `guard`: which one its steps do not resolve.
  bool Accept(std::unique_ptr<RolloutRun> of, double its_error, std::string guard) {
    run = std::move(of);
    error = reached = its_error;
    unresolved = std::move(guard);
    return true;
  }

  // Returns the number of control intervals, or parts of them, each of which has so many steps.
  std::size_t num_parts() const { return input.num_intervals + options.divisions.size(); }
  int FewestSteps() const { return (kFewestSteps + input.num_intervals - 1) / input.num_intervals; }

  // Divides control intervals where few steps do not resolve the flow or the guards, if these are longer than the
  // others need to be. The first division is one of the longest steps, which resolves what a change does nearby as
  // well.
  bool DivideAtFew(const RolloutRun& of) {
    if (!divides_early) return false;
    const HiddenChanges changes = FindHidden(of, Changes::kAll);
    if (changes.steps == 0) return false;
    const bool at_most = changes.steps * kFewPlaces > of.tape().num_nodes;
    if (changes.unbounded && !at_most) return false;
    if (at_most) {
      // A motion that misses an event, behind which its flow has no solution, is wrong from there on. Once the event
      // is met the next such place is later.
      if (changes.first <= last_first + kFewPlaces * of.tape().step) return false;
      last_first = changes.first;
      return Divide(FindHidden(of, Changes::kFirst));
    }
    RolloutRun fewest(system, options);
    if (fewest.Run(input, Steps(FewestSteps())) == RolloutEnd::kDone && Divide(FindHidden(fewest, Changes::kAll))) {
      return true;
    }
    return Divide(changes);
  }

  // Chooses the number of steps, and divides control intervals where changes hide within them. Where that leads to no
  // motion, as few steps have hidden most of the changes, no division is made before uniform steps have been tried.
  bool ChooseSteps() {
    last_first = -std::numeric_limits<double>::infinity();
    for (;;) {
      const std::optional<bool> found = ChooseNumber();
      if (!found) continue;
      if (*found || !divides_early || options.divisions == given) return *found;
      divides_early = false;
      options.divisions = given;
    }
  }

  // Doubles the number of steps until they resolve the guards, and the error is at most the tolerance or no longer
  // falls, as it is rounding. Returns whether the motion has such a number; std::nullopt if it has divided intervals.
  std::optional<bool> ChooseNumber() {
    int n = FewestSteps(), stalls = 0;
    std::unique_ptr<RolloutRun> best, finer;
    double least = std::numeric_limits<double>::infinity(), reference = least, last = least, last_failure = least,
           scatter = 0;
    std::vector<double> slow;    // differences, of steps that do not resolve the guards
    std::vector<double> errors;  // of those that do
    int same_failures = 0;
    double next_look = kMostWithoutJump;  // steps, for some that are longer than others need to be
    why.clear();
    if (!run) run = std::make_unique<RolloutRun>(system, options);
    RolloutEnd end = run->Run(input, Steps(n));
    for (;; n *= 2) {
      const double count = static_cast<double>(n) * static_cast<double>(num_parts());
      if (end == RolloutEnd::kDone) why = WrongFlight();
      if (!why.empty()) return false;
      if (end != RolloutEnd::kDone) {
        // A failure that stays at its time is one of the system. Steps that are too long for the flow fail earlier the
        // shorter they are, after some steps.
        const double h = input.duration / n / input.num_intervals, failure = run->failure_time();
        const double apart = std::abs(failure - last_failure);
        const bool stays = apart <= kSameTime * h;
        same_failures = stays && (run->flow_fails() || failure - input.begin > kLater * h) ? same_failures + 1 : 0;
        last_failure = failure;
        if (run->flow_fails() && same_failures >= kSameFailures) break;
        // Steps that are too long may lead where the motion does not. A refusal counts if half as many steps end with
        // one at the same time, or where no step leads to it.
        if (end == RolloutEnd::kRefused &&
            (failure == input.begin || apart <= kSameRefusal * h || count >= kMostWithoutEnd)) {
          break;
        }
      }
      if (2 * count > kMostSteps) {
        if (end == RolloutEnd::kDone) {
          if (finer) why = ReasonSlowConvergence(errors, count, *finer, *run);
          if (finer && why.empty() && !finer->unresolved().what.empty()) {
            why = finer->unresolved().what + "; at most " + std::to_string(kMostSteps) +
                  " steps are tried: shorten the duration";
          }
          if (why.empty()) {
            why = "an explicit method needs more than " + std::to_string(kMostSteps) +
                  " steps to integrate the flow to the tolerance; the system may be stiff" + kOfStiff;
          }
        } else {
          why = run->why() +
                (same_failures >= kSameFailures
                     ? kEndsThere
                     : " with " + ToText(count, 10) +
                           " steps of an explicit method: the flow may be stiff or have no solution" + kOfStiff);
        }
        return false;
      }
      if (!finer) finer = std::make_unique<RolloutRun>(system, options);
      const RolloutEnd end_of_finer = finer->Run(input, Steps(2 * n), /*compare_guards=*/true);
      const bool both = end == RolloutEnd::kDone && end_of_finer == RolloutEnd::kDone;
      const bool resolves = both && (finer->ResolvesGuards() || 4 * count > kMostForGuards);
      const double now = both ? Difference(*run, *finer) : std::numeric_limits<double>::infinity();
      const auto why_hopeless = [&] {
        return "the integration does not converge: the difference between " + std::to_string(n) + " and " +
               std::to_string(2 * n) + " steps per interval is still " +
               (std::isinf(now) ? "that of other events" : ToText(now, 2)) +
               ". The flow may have no solution, or be too sensitive to be computed";
      };
      const bool converges = resolves && now <= kHardlyFalls * reference;
      if (both && !converges && count >= next_look) {
        next_look = kLooks * count;
        if (DivideAtFew(*finer)) return std::nullopt;
      }
      if (both && !resolves) {
        slow.push_back(now);
        const double before = slow.size() > kHopeless ? slow[slow.size() - 1 - kHopeless] : least;
        const bool falls = !std::isfinite(before) || now <= std::max(kFirstOrder * before, kRoundingOfMotion);
        if (!falls && count >= kMostWithoutEnd) {
          why = finer->unresolved().what + "; " + why_hopeless();
          steps = 0;
          return false;
        }
      }
      if (resolves) {
        stalls = now > kConverges * reference || std::isinf(now) ? stalls + 1 : 0;
        if (stalls == 0) reference = now;
        scatter = stalls == 0 ? now : std::max(scatter, now);
        if (now < least) {
          least = now;
          steps = n;
          std::swap(best, run);
        }
        if (least <= options.tolerance || (least < kRoundingOfMotion && stalls >= kStalls)) {
          const double of_cut_steps = ErrorOfCutSteps(*best);
          // Rounding of a guard that is large elsewhere in a step may hide that it falls below zero.
          const HiddenChanges hidden = FindHidden(*best, best->grazings().empty() ? Changes::kHidden : Changes::kAll);
          if (Divide(hidden)) return std::nullopt;
          const bool is_resolvable = hidden.length * kMostForGuards > input.duration;
          if (!is_resolvable && (of_cut_steps <= std::max(least, options.tolerance) || count >= kMostWithoutEnd)) {
            // Derivatives by what moves a narrow change have its error, divided by the width.
            const bool is_narrow = n == steps && options.divisions != given;
            const std::string guard = finer->unresolved().what;
            if (is_narrow) steps *= 2;
            Accept(std::move(is_narrow ? finer : best), std::max(least, of_cut_steps), guard);
            NoteHidden(hidden);
            return true;
          }
          least = reference = std::numeric_limits<double>::infinity();  // blind to cut steps or changes
          stalls = 0;
        }
        const RolloutRun& coarse = run ? *run : *best;
        const double but_rounding = ErrorButRounding(coarse, *finer, last, now);
        last = now;
        if (std::isfinite(but_rounding)) {
          steps = n;
          return Accept(run ? std::move(run) : std::move(best), but_rounding, finer->unresolved().what);
        }
        const bool same_events = HaveSameEvents(coarse, *finer);
        if (count >= kMostWithoutJump && same_events) why = FindJump(coarse, *finer, now);
        // Impacts may amplify rounding errors until no number of steps lowers what is left of them.
        if (why.empty() && stalls >= kScatters && scatter <= kMostScatter && system.functions().EndsAccumulations() &&
            count >= kFewestForScatter) {
          steps = n;
          if (!run) run = std::move(best);
          scatter = std::max(scatter, ErrorOfCutSteps(*run));
          return Accept(std::move(run), scatter, finer->unresolved().what);
        }
        errors.push_back(same_events ? now : std::numeric_limits<double>::infinity());
        if (why.empty()) why = ReasonSlowConvergence(errors, 2 * count, coarse, *finer);
        if (stalls >= kHopeless && count >= kMostWithoutEnd) why = why_hopeless();
        if (!why.empty()) {
          if (!run) run = std::move(best);
          steps = 0;
          return false;
        }
      }
      std::swap(run, finer);
      end = end_of_finer;
    }
    steps = 0;
    why = run->why();
    if (end == RolloutEnd::kNotFinite) why += kEndsThere;
    return false;
  }

  // Whether the motion of `run`, with the steps chosen for another one, is as accurate as that. Most often a rollout
  // with half the steps tells.
  bool KeepsAccuracy() {
    const double most = std::max(options.tolerance, kSameAccuracy * reached);
    if (unresolved.empty() && FindHidden(*run).length > 0) return false;
    if (steps % 2 == 0 && DifferenceTo(steps / 2) <= kHalving * most && ErrorOfCutSteps(*run) <= most) return true;
    return Error() <= most;
  }

  // Compares each mode's closed form of the flow, at the first step in it that this simulator takes, with the
  // integration over a short part of it: shorter where the slope changes much, as that of a stiff flow does.
  std::string WrongFlight() {
    const HybridFunctions& f = system.functions();
    seen.resize(system.num_modes());
    const std::size_t most = f.most_states();
    std::vector<double> slope(most), end_slope(most), after(most), integrated(most), middle(most), by_halves(most);
    std::vector<double> scratch((RungeKutta::kStages + 1) * most);
    for (const TapeEntry& entry : run->tape().entries) {
      if (entry.kind == TapeEntry::Kind::kReset || entry.h <= 0 || seen[entry.mode]++) continue;
      const double* u = input.control.data() + entry.interval * system.num_controls();
      const double* x = &run->tape().numbers[entry.x];
      FlowStep step{{entry.mode, entry.t, x, u, input.parameters.data()}, entry.h / 64};
      const int n = system.state_size(entry.mode);
      const double largest = Largest(std::span(x, n));
      f.Flow(step, slope.data());
      for (int halvings = 0; f.Fly(step, after.data(), nullptr); ++halvings, step.h /= 2) {
        f.HybridFunctions::Step(step, slope.data(), scratch.data(), integrated.data(), end_slope.data());
        f.Flow({step.mode, step.t + step.h, after.data(), step.u, step.p}, end_slope.data());
        int wrong = -1;
        double size = 0, change = 0, rounding = largest;
        for (int i = 0; i < n; ++i)
          rounding = std::max(rounding, std::min(std::abs(integrated[i]), std::abs(after[i])));
        rounding *= kRoundingOfFlow;
        for (int i = 0; i < n; ++i) {
          const double known = kSameFlow * std::abs(integrated[i] - x[i]) + rounding;
          if (!(std::abs(after[i] - integrated[i]) <= known) && wrong < 0) wrong = i;
          size = std::max(size, std::abs(slope[i]));
          change = std::max(change, std::abs(end_slope[i] - slope[i]));
        }
        if (wrong < 0) break;
        if (change > kSlopeChange * size && halvings < kMostHalvings) continue;
        // A state that others reach through a chain changes by so little that the integration has few of its digits.
        FlowStep half = step;
        half.h /= 2;
        f.HybridFunctions::Step(half, slope.data(), scratch.data(), middle.data(), end_slope.data());
        half.t += half.h;
        half.x = middle.data();
        std::swap(slope, end_slope);
        f.HybridFunctions::Step(half, slope.data(), scratch.data(), by_halves.data(), end_slope.data());
        const auto is_wrong = [&](int i) {
          const double known = kSameFlow * std::abs(integrated[i] - x[i]) + rounding +
                               kSameFlowAsHalves * std::abs(by_halves[i] - integrated[i]);
          return !(std::abs(after[i] - integrated[i]) <= known);
        };
        wrong = 0;
        while (wrong < n && !is_wrong(wrong)) ++wrong;
        if (wrong == n) break;
        return "Fly is no closed form of the flow of mode '" + system.ModeName(entry.mode) + "': " + ToText(step.h) +
               " after t = " + ToText(step.t) + " " + system.StateName(entry.mode, wrong) + " is " +
               ToText(after[wrong]) + " by Fly, and " + ToText(integrated[wrong]) + " by integration";
      }
    }
    return "";
  }

  // Returns whether the derivative is one-sided, for each coincidence of a motion that succeeded.
  const std::vector<char>& OneSided() {
    if (done && one_sided.size() != run->tape().coincidences.size()) {
      TiedEvents tied(system, options);
      one_sided = derivatives.FindOneSided(input, run->tape(), &tied);
    }
    return one_sided;
  }
  const std::vector<HybridTie>& Ties() {
    if (ties.size() == run->ties().size()) return ties;
    ties = run->ties();
    TiedEvents tied(system, options);
    for (const Coincidence& coincidence : run->tape().coincidences) {
      if (coincidence.tie < 0 || coincidence.begin + 1 >= run->tape().entries.size()) continue;
      derivatives.Compare(input, run->tape(), coincidence, &tied, &ties[coincidence.tie]);
    }
    return ties;
  }

  // Returns remarks on functions that are not smooth where the motion is, and on resets that jump there.
  std::vector<TimedRemark> RemarksOnKinks() {
    const HybridFunctions& functions = system.functions();
    const MotionTape& tape = run->tape();
    const auto may_break = [&](const TapeEntry& entry) {
      return entry.kind == TapeEntry::Kind::kReset && functions.ResetMayBreak(entry.mode, entry.guard);
    };
    std::vector<TimedRemark> remarks;
    if (!done) return remarks;
    if (!kinks) kinks = derivatives.FindKinks(input, tape);
    std::vector<char> has_kink(tape.entries.size());
    for (const MotionDerivatives::Kink& kink : *kinks) {
      const TapeEntry& entry = tape.entries[kink.entry];
      has_kink[kink.entry] = kink.kind == MotionDerivatives::Kink::kReset;
      if (has_kink[kink.entry] != 0) continue;
      const bool of_flow = kink.kind == MotionDerivatives::Kink::kFlow;
      remarks.push_back({of_flow ? "the flow is not smooth"
                                 : "guard '" + functions.GuardName(entry.mode, entry.guard) + "' is not smooth",
                         of_flow ? entry.t : tape.entries[kink.entry + 1].t,
                         ", where " + Joined(kink.names, ", ", "'") +
                             (kink.names.size() == 1 ? " stays zero" : " stay zero") +
                             ": derivatives differ from side to side"});
    }
    const TiedEvents tied(system, options);
    for (std::size_t i = 0; i < tape.entries.size(); ++i) {
      const TapeEntry& entry = tape.entries[i];
      if (!may_break(entry)) continue;
      const double* u = input.control.data() + static_cast<std::ptrdiff_t>(entry.interval) * system.num_controls();
      const ModePoint at{entry.mode, entry.t, &tape.numbers[entry.x], u, input.parameters.data()};
      const std::string reset = "the reset of guard '" + functions.GuardName(entry.mode, entry.guard) + "' ";
      if (tied.JumpsAtItsEvent(at, entry.guard, input.duration)) {
        remarks.push_back({reset + "jumps at its event",
                           entry.t,
                           ", and rounding decides on which side of the jump it is: let it decide by a mode, or by a "
                           "number that is away from the jump"});
      } else if (has_kink[i] != 0) {
        remarks.push_back({reset + "has a kink at its event", entry.t, ": its derivatives differ from side to side"});
      }
    }
    return remarks;
  }

  static bool IsFinite(const std::vector<std::vector<double>>& rows) { return std::ranges::all_of(rows, AllFinite); }
  static bool IsFinite(const HybridSensitivity& by) {
    return AllFinite(by.final_state) && IsFinite(by.nodes) && IsFinite(by.after) && IsFinite(by.times);
  }
  // Keeps why derivatives are not finite; returns them.
  template <typename Derivatives>
  Derivatives Checked(Derivatives found, bool finite) {
    why_not_finite = finite ? "" : derivatives.ReasonNotFinite(input, run->tape());
    return found;
  }

  const HybridSystem system;
  HybridOptions options;
  const std::vector<double> given;  // options.divided, before any are chosen
  int steps;                        // in a control interval; 0: to be chosen
  bool divides_early = true;        // DivideAtFew() may divide
  double last_first = 0;            // s: where the first change was for which it divided one step only
  double reached = 0;               // the error when they were chosen
  HybridInput input;                // of the last rollout, with zeros where it has no control
  bool done = false;
  std::vector<char> seen;  // modes in which the closed form has been compared
  std::string why, why_not_finite;
  std::unique_ptr<RolloutRun> run;  // the last rollout
  std::optional<double> error;      // of it, where it is known
  bool hides = false;               // changes that its steps do not see
  std::string unresolved;           // of a rollout with twice as many steps: a guard that they do not resolve
  MotionDerivatives derivatives;
  // Results about the last rollout, once they have been asked for.
  std::vector<char> one_sided;
  std::optional<std::vector<MotionDerivatives::Kink>> kinks;
  std::vector<HybridTie> ties;
};

HybridSimulator::HybridSimulator(HybridSystem system, HybridOptions options)
    : impl_(std::make_unique<Impl>(std::move(system), options)) {}
HybridSimulator::HybridSimulator(HybridSimulator&&) noexcept = default;
HybridSimulator::~HybridSimulator() = default;

const HybridSystem& HybridSimulator::system() const { return impl_->system; }

bool HybridSimulator::Rollout(const HybridInput& input) {
  Impl& at = *impl_;
  at.done = false;
  if (at.why = Validate(input, at.system); !at.why.empty()) return false;
  if (at.steps > kMostGivenSteps / input.num_intervals) {
    at.why = "found " + std::to_string(at.steps) + " integration steps in each of " +
             std::to_string(input.num_intervals) + " control intervals, expected at most " +
             std::to_string(kMostGivenSteps) + " in all; choose fewer, or 0 for as many as the tolerance needs";
    return false;
  }
  at.input = input;
  if (input.control.empty())
    at.input.control.resize(static_cast<std::size_t>(input.num_intervals) * at.system.num_controls());
  at.one_sided.clear();
  at.kinks.reset();
  at.ties.clear();
  at.why_not_finite.clear();
  at.error.reset();
  at.hides = false;
  if (at.steps == 0) {
    at.done = at.ChooseSteps();
  } else {
    const bool moves = at.run->Run(at.input, at.Steps(at.steps)) == RolloutEnd::kDone;
    at.why = moves ? at.WrongFlight() : at.run->why();
    at.done = at.why.empty();
  }
  return at.done;
}

bool HybridSimulator::RolloutAccurately(const HybridInput& input) {
  const bool keeps = impl_->steps > 0 && impl_->options.steps_per_interval <= 0;
  if (!keeps) return Rollout(input);
  if (Rollout(input) && impl_->KeepsAccuracy()) return true;
  ResetStepChoice();
  return Rollout(input);
}

const std::string& HybridSimulator::FailureReason() const { return impl_->why; }
std::optional<double> HybridSimulator::accumulation() const { return impl_->run->accumulation(); }
int HybridSimulator::final_mode() const { return impl_->run->tape().final_mode; }

std::span<const double> HybridSimulator::final_state() const {
  const MotionTape& tape = impl_->run->tape();
  return {&tape.numbers[tape.final_state], static_cast<std::size_t>(impl_->system.state_size(tape.final_mode))};
}

const std::vector<HybridEvent>& HybridSimulator::events() const { return impl_->run->events(); }
const std::vector<HybridEvent>& HybridSimulator::switches() const { return impl_->run->switches(); }
const std::vector<HybridGrazing>& HybridSimulator::grazings() const { return impl_->run->grazings(); }
const std::vector<HybridTie>& HybridSimulator::ties() const { return impl_->Ties(); }

int HybridSimulator::ModeAt(int k) const {
  const MotionTape& tape = impl_->run->tape();
  CHECK(k >= 0 && k <= impl_->input.num_intervals);
  return k == impl_->input.num_intervals ? tape.final_mode : tape.entries[tape.intervals[k]].mode;
}

std::span<const double> HybridSimulator::StateAt(int k) const {
  if (k == impl_->input.num_intervals) return final_state();
  const MotionTape& tape = impl_->run->tape();
  CHECK(k >= 0 && k < impl_->input.num_intervals);
  return StepState(static_cast<int>(tape.intervals[k]));
}

int HybridSimulator::num_steps() const { return static_cast<int>(impl_->run->tape().entries.size()); }
double HybridSimulator::StepTime(int step) const { return impl_->run->tape().entries[step].t; }
int HybridSimulator::StepMode(int step) const { return impl_->run->tape().entries[step].mode; }
std::span<const double> HybridSimulator::StepState(int step) const {
  const MotionTape& tape = impl_->run->tape();
  const TapeEntry& entry = tape.entries[step];
  return {&tape.numbers[entry.x], static_cast<std::size_t>(impl_->system.state_size(entry.mode))};
}

bool HybridSimulator::IsReset(int step) const {
  return impl_->run->tape().entries[step].kind == TapeEntry::Kind::kReset;
}

std::string HybridSimulator::ReasonNotDifferentiable() const {
  const RolloutRun& run = *impl_->run;
  const HybridSystem& system = impl_->system;
  std::vector<TimedRemark> remarks;
  for (const RolloutRun::StartDependence& start : run.at_start()) {
    std::vector<std::string> names;
    const auto add = [&](const std::vector<char>& depends, const auto& name_of) {
      for (std::size_t i = 0; i < depends.size(); ++i) {
        if (depends[i] != 0) names.push_back(name_of(static_cast<int>(i)));
      }
    };
    add(start.initial, [&](int i) { return system.StateName(impl_->input.mode, i); });
    add(start.parameters, [&](int i) { return system.ParameterName(i); });
    add(start.control, [&](int i) { return system.ControlName(i); });
    if (names.empty()) continue;
    constexpr std::size_t kMostNames = 6;
    const std::size_t more = names.size() - std::min(names.size(), kMostNames);
    names.resize(names.size() - more);
    const std::string others = more > 0 ? " and " + std::to_string(more) + " more" : "";
    remarks.push_back({start.what + ": derivatives by " + Joined(names) + others + " are one-sided"});
  }
  remarks.insert(remarks.end(), run.remarks().begin(), run.remarks().end());
  if (!impl_->why_not_finite.empty()) remarks.push_back({impl_->why_not_finite});
  const HybridFunctions& functions = system.functions();
  for (const HybridGrazing& grazing : run.grazings()) {
    const bool is_switch = functions.IsSwitch(grazing.mode, grazing.guard);
    remarks.push_back(
        {(is_switch ? "switch '" : "guard '") + functions.GuardName(grazing.mode, grazing.guard) + "' grazes zero",
         grazing.time,
         is_switch ? "" : ": it touches zero and returns, and an event happens only where it falls through zero"});
  }
  const std::vector<TimedRemark> of_kinks = impl_->RemarksOnKinks();
  remarks.insert(remarks.end(), of_kinks.begin(), of_kinks.end());
  const std::vector<HybridTie>& ties = impl_->Ties();
  for (const HybridTie& tie : ties) {
    if (tie.ambiguous) remarks.push_back(RemarkOnTie(system, tie, "the order of their events matters"));
  }
  const std::vector<char>& one_sided = impl_->OneSided();
  for (std::size_t i = 0; i < one_sided.size(); ++i) {
    const Coincidence& coincidence = run.tape().coincidences[i];
    if (one_sided[i] != 0 && (coincidence.tie < 0 || !ties[coincidence.tie].ambiguous)) {
      remarks.push_back(coincidence.remark);
    }
  }
  return JoinRemarks(remarks);
}

const std::string& HybridSimulator::ReasonNotFinite() const { return impl_->why_not_finite; }

int HybridSimulator::steps_per_interval() const { return impl_->steps; }
const std::vector<double>& HybridSimulator::divisions() const { return impl_->options.divisions; }
HybridOptions HybridSimulator::StepsBetween(double begin, double end) const {
  HybridOptions steps{.steps_per_interval = std::max(impl_->steps, 1)};
  for (const double part : impl_->options.divisions) {
    const double time = impl_->input.begin + part * impl_->input.duration;
    if (time > begin && time < end) steps.divisions.push_back((time - begin) / (end - begin));
  }
  return steps;
}
void HybridSimulator::ResetStepChoice() {
  impl_->steps = std::max(impl_->options.steps_per_interval, 0);
  impl_->options.divisions = impl_->given;
}

double HybridSimulator::IntegrationError() {
  CHECK(impl_->done) << "the rollout failed";
  return impl_->Error();
}

std::string HybridSimulator::ReasonInaccurate() {
  const double error = IntegrationError();
  std::string why = impl_->unresolved;
  if (error <= impl_->options.tolerance) return why;
  if (!why.empty()) why += "; ";
  const std::string steps = std::to_string(impl_->steps) + " steps per interval";
  if (impl_->hides) return impl_->unresolved;
  if (std::isinf(error)) return why + "twice as many as " + steps + " give other events: take more";
  return why + "the integration error of " + steps + " is " + ToText(error, 2) + ", above the tolerance " +
         ToText(impl_->options.tolerance, 2);
}

HybridGradient HybridSimulator::Adjoint(const HybridCotangent& cotangent) {
  CHECK(impl_->done) << "the rollout failed";
  HybridGradient found = impl_->derivatives.Adjoint(impl_->input, impl_->run->tape(), impl_->run->events(), cotangent);
  const bool finite = Impl::IsFinite({found.initial, found.control, found.parameters}) && std::isfinite(found.duration);
  return impl_->Checked(std::move(found), finite);
}

HybridGradient HybridSimulator::Adjoint(std::span<const double> final_cotangent) {
  HybridCotangent cotangent;
  cotangent.final_state.assign(final_cotangent.begin(), final_cotangent.end());
  return Adjoint(cotangent);
}

HybridSensitivity HybridSimulator::Sensitivity(bool by_parameters) {
  CHECK(impl_->done) << "the rollout failed";
  HybridSensitivity found =
      impl_->derivatives.Sensitivity(impl_->input, impl_->run->tape(), impl_->run->events(), by_parameters);
  const bool finite = Impl::IsFinite(found);
  return impl_->Checked(std::move(found), finite);
}

std::vector<HybridSensitivity> HybridSimulator::IntervalSensitivities() {
  CHECK(impl_->done) << "the rollout failed";
  std::vector<HybridSensitivity> found = impl_->derivatives.Intervals(impl_->input, impl_->run->tape());
  const bool finite = std::ranges::all_of(found, [](const HybridSensitivity& by) { return Impl::IsFinite(by); });
  return impl_->Checked(std::move(found), finite);
}

std::vector<double> HybridInput::Times() const {
  std::vector<double> times(num_intervals + 1);
  const double whole = std::accumulate(lengths.begin(), lengths.end(), 0.0);
  double sum = 0;
  for (int k = 0; k < num_intervals; ++k) {
    times[k] = begin + (lengths.empty() ? duration * k / num_intervals : duration * (sum / whole));
    if (!lengths.empty()) sum += lengths[k];
  }
  times.back() = begin + duration;
  return times;
}

std::string Validate(const HybridInput& input, const HybridSystem& system) {
  const auto found = [](const char* what, std::size_t count, std::size_t expected) {
    return std::string("found ") + std::to_string(count) + " numbers of the " + what + ", expected " +
           std::to_string(expected);
  };
  if (input.mode < 0 || input.mode >= system.num_modes()) {
    return "found mode " + std::to_string(input.mode) + ", expected 0 to " + std::to_string(system.num_modes() - 1);
  }
  const auto n = static_cast<std::size_t>(system.state_size(input.mode));
  const auto num_parameters = static_cast<std::size_t>(system.num_parameters());
  if (input.initial.size() != n) return found("initial state", input.initial.size(), n);
  if (input.parameters.size() != num_parameters) return found("parameters", input.parameters.size(), num_parameters);
  if (input.num_intervals < 1)
    return "found " + std::to_string(input.num_intervals) + " control intervals, expected 1 or more";
  const std::size_t controls = static_cast<std::size_t>(input.num_intervals) * system.num_controls();
  if (!input.control.empty() && input.control.size() != controls)
    return found("control", input.control.size(), controls);
  if (!input.lengths.empty() && input.lengths.size() != static_cast<std::size_t>(input.num_intervals)) {
    return found("lengths of the control intervals", input.lengths.size(), input.num_intervals);
  }
  for (const double length : input.lengths) {
    if (!(length > 0) || !std::isfinite(length)) return "expected finite lengths of the control intervals above zero";
  }
  if (!(input.duration > 0) || !std::isfinite(input.duration)) return "expected a finite duration above zero";
  if (!std::isfinite(input.begin)) return "the time of the beginning is not finite";
  if (!AllFinite(input.initial)) return "the initial state is not finite";
  if (!AllFinite(input.parameters)) return "a parameter is not finite";
  if (!AllFinite(input.control)) return "the control is not finite";
  return "";
}

std::vector<double> SaltationMatrix(const HybridSystem& system, int mode, int guard, double t,
                                    std::span<const double> x, std::span<const double> u, std::span<const double> p) {
  using Matrix = RungeKutta::Matrix;
  const int n = system.state_size(mode), columns = n + 1 + system.num_parameters();
  const HybridFunctions& f = system.functions();
  const int most = f.most_states();
  std::vector<double> after(most), reset(most * columns), gradient(columns + system.num_controls()), out(most), in(n);
  const ModePoint at{mode, t, x.data(), u.data(), p.data()};
  const int next = f.ResetJacobian(at, guard, after.data(), reset.data());
  CHECK(next >= 0 && next < system.num_modes());
  const int rows = system.state_size(next);
  f.GuardGradient(at, guard, gradient.data());
  f.Flow(at, in.data());
  f.Flow({next, t, after.data(), at.u, at.p}, out.data());
  const Eigen::Map<const Matrix> R(reset.data(), rows, columns);
  const Eigen::Map<const Eigen::RowVectorXd> G(gradient.data(), columns);
  const Eigen::Map<const Eigen::VectorXd> f_before(in.data(), n), f_after(out.data(), rows);
  const double rate = G[n] + G.head(n) * f_before;
  const Matrix xi = R.leftCols(n) + (f_after - R.leftCols(n) * f_before - R.col(n)) * G.head(n) / rate;
  return {xi.data(), xi.data() + xi.size()};
}

}  // namespace saltus
