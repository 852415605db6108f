// The task of a solve along a given sequence of events, its start and its result, for any kind of system.
//
// Solvers along sequences of events (phase_attempt.h, sequence_update.h, search/sequence_search.h) know a problem as a
// run, a class Run with
//
//   Run::Event        what ends a phase: of discs a pair of them, of a hybrid system a guard of a mode. Comparable.
//   Run::Motion       a control on intervals of any lengths, and its exact simulation:
//                     control, durations, exact {ok, reason, loss, only_impacts, contacts (events in their order),
//                     events (with their times)}
//
// and the functions that PhaseRun has (phase_run.h), which is the run of a scene of discs; that of a hybrid system is
// HybridPhaseRun (hybrid_phases.h).
#pragma once

#include <algorithm>
#include <cmath>
#include <functional>
#include <numeric>
#include <optional>
#include <string>
#include <type_traits>
#include <utility>
#include <vector>

#include "saltus/solve/solver.h"

namespace saltus {

// The events of a motion in their order.
template <typename Event>
struct PlanOf {
  std::vector<std::optional<Event>> cuts;   // between phases: an event; none: an instant that an objective names
  std::vector<bool> tied;                   // by cut: no time passes until the next one, or the final time
  std::vector<std::optional<int>> regimes;  // by cut: the regime in which the event is held, of discs a ContactMode
  std::vector<Event> apart;                 // events that do not happen, by an inequality, but where they are cuts
  bool only_violation = false;              // hard terms as costs, and hardly any others
  bool holds_borders = false;               // guards that stay at zero along it do not cross
  bool on_grid = false;                     // the instants are the ends of all control intervals: no event ends one

  std::vector<Event> Sequence() const {
    std::vector<Event> sequence;
    for (const auto& cut : cuts) {
      if (cut) sequence.push_back(*cut);
    }
    return sequence;
  }
  bool HasTies() const { return std::find(tied.begin(), tied.end(), true) != tied.end(); }
  bool HasRegimes() const {
    return std::any_of(regimes.begin(), regimes.end(), [](const auto& regime) { return regime.has_value(); });
  }
  bool operator==(const PlanOf&) const = default;
};

// Where a solve along a plan begins.
template <typename Motion>
struct PlanStartOf {
  std::vector<double> times;  // s, of the cuts
  Motion trial;               // a real motion, or one that a solve stood at when it left its sequence
};

// The result of a solve along a plan.
template <typename Motion>
struct PlanAttemptOf {
  bool valid = false;          // all else is filled
  std::vector<double> times;   // s, of the cuts as planned, and the final time
  std::vector<double> speeds;  // of the cuts: the rate at which the gap closes, negative if it does; 0 of instants
  Motion trial;
  bool converged = false;          // an optimum along the plan
  bool interrupted = false;        // by the user
  bool realized = false;           // the exact roll-out has the plan's events and no others
  double violation = 0;            // of hard constraints, on the exact roll-out
  double planned_loss = INFINITY;  // along the plan, whatever the exact roll-out
  std::string borders = {};        // that the motion keeps to, by margins: guards that stay at zero
  int jacobians = 0;

  bool feasible() const { return realized && violation <= kFeasible; }  // within what may be left of hard constraints
  double loss() const { return trial.exact.loss; }
};

// One solve along a plan. `may_go_on` is asked after each iteration with PlanAttempt's times and speeds, if the solver
// can leave the plan on the way; where it says no, that is the end, and no interruption.
using ContinuePredicate = std::function<bool(const std::vector<double>& times, const std::vector<double>& speeds)>;
template <typename Run>
using TryPlanOf = std::function<PlanAttemptOf<typename Run::Motion>(const PlanOf<typename Run::Event>&,
                                                                    const PlanStartOf<typename Run::Motion>&,
                                                                    const ContinuePredicate& may_continue)>;

// For each event of a sequence the one of another sequence that it is, or -1: a longest common subsequence.
template <typename Event>
std::vector<int> LongestCommon(const std::vector<Event>& sequence, const std::vector<Event>& other) {
  const int n = static_cast<int>(sequence.size()), m = static_cast<int>(other.size());
  std::vector<std::vector<int>> length(n + 1, std::vector<int>(m + 1, 0));
  for (int i = n - 1; i >= 0; --i) {
    for (int j = m - 1; j >= 0; --j) {
      length[i][j] = sequence[i] == other[j] ? 1 + length[i + 1][j + 1] : std::max(length[i + 1][j], length[i][j + 1]);
    }
  }
  std::vector<int> found(n, -1);
  for (int i = 0, j = 0; i < n && j < m;) {
    if (sequence[i] == other[j]) {
      found[i++] = j++;
    } else if (length[i + 1][j] >= length[i][j + 1]) {
      ++i;
    } else {
      ++j;
    }
  }
  return found;
}

template <typename Motion>
double DurationOf(const Motion& trial) {
  return std::accumulate(trial.durations.begin(), trial.durations.end(), 0.0);
}

// Entry i of a row of `width` numbers of the trial's control holds at its time. The trial must outlive it.
template <typename Motion>
std::function<double(int entry, double t)> ControlOf(const Motion& trial, int width) {
  std::vector<double> ends(trial.durations.size());
  std::partial_sum(trial.durations.begin(), trial.durations.end(), ends.begin());
  return [&trial, width, ends = std::move(ends)](int entry, double t) {
    const size_t last = ends.size() - 1;
    const size_t k = std::min<size_t>(std::upper_bound(ends.begin(), ends.end(), t) - ends.begin(), last);
    return trial.control[k * width + entry];
  };
}

// Whether an exact simulation has these events, at these times, and no others.
template <typename Exact, typename Event>
bool HasEvents(const Exact& exact, const std::vector<Event>& sequence, const std::vector<double>& times,
               double duration) {
  constexpr double kSameTime = 1e-6;  // of the duration
  if (!exact.ok || !exact.only_impacts || exact.contacts != sequence) return false;
  for (size_t k = 0; k < times.size(); ++k) {
    if (std::abs(exact.events[k].time - times[k]) > kSameTime * duration) return false;
  }
  return true;
}

// Leaves a motion that is no optimum: takes steps of many lengths, that of the largest in proportion to `size`, to both
// sides along a direction. move(length, &motion) takes one and simulates it. Returns, of the motions whose merit, by
// default the loss, is better by more than rounding, the best with each sequence of events, best first.
template <typename Motion, typename Move>
std::vector<Motion> StepsToBothSides(
    const Motion& start, double size, const Move& move,
    const std::type_identity_t<std::function<double(const Motion&)>>& merit = [](const Motion& motion) {
      return motion.exact.loss;
    }) {
  constexpr int kLargest = 4, kLengths = 24;  // powers of two
  std::vector<Motion> better;
  const double least = merit(start) - 1e-12 * std::abs(merit(start));
  for (int power = kLargest; power > kLargest - kLengths; --power) {
    for (const double sign : {1.0, -1.0}) {
      Motion moved = start;
      move(sign * std::ldexp(size, power), &moved);
      if (moved.exact.ok && merit(moved) < least) better.push_back(std::move(moved));
    }
  }
  std::ranges::stable_sort(better, {}, merit);
  std::vector<Motion> best;
  for (Motion& candidate : better) {
    const auto same = [&](const Motion& known) { return known.exact.contacts == candidate.exact.contacts; };
    if (std::ranges::none_of(best, same)) best.push_back(std::move(candidate));
  }
  return best;
}

inline constexpr int kMostSaddles = 5;  // left one after the other
// Describes for people that a saddle was left, and what followed.
inline std::string DescribeSaddle(const std::string& then) {
  return "left a saddle" + (then.empty() ? "" : "; " + then);
}

// ----------------------------------------------------------------------------------------------- merit of real motions

inline constexpr double kHardlyBetter = 1e-9;  // relative, of losses
inline constexpr double kSameOptimum = 1e-6;   // relative, between losses along one sequence

// Whether a loss is one of several optima's.
inline bool HasSameLoss(const std::vector<double>& losses, double loss) {
  return std::ranges::any_of(losses,
                             [&](double other) { return std::abs(other - loss) <= kSameOptimum * std::abs(loss); });
}

// Line search from a motion towards another one whose control is known: the best motion met that counts, if its merit
// is below that of the first.
template <typename Run>
std::optional<typename Run::Motion> LineSearch(
    const Run& run, const typename Run::Motion& to, const typename Run::Motion& from,
    const std::function<bool(const typename Run::Motion&)>& counts = [](const auto&) { return true; }) {
  constexpr int kHalvings = 8;
  std::optional<typename Run::Motion> best;
  double least = run.MeritOf(run.ClampToBounds(from));
  if (std::isfinite(least)) least -= kHardlyBetter * std::abs(least);
  const int width = run.control_width();
  double part = 1;
  for (int i = 0; i <= kHalvings; ++i, part /= 2) {
    typename Run::Motion between = to;
    run.BlendStart(to, from, part, &between);
    const auto before = ControlOf(from, width);
    const double stretch = DurationOf(from) / DurationOf(to);
    double begin = 0;
    for (size_t k = 0; k < to.durations.size(); ++k) {
      for (int entry = 0; entry < width; ++entry) {
        double& u = between.control[k * width + entry];
        u = part * u + (1 - part) * before(entry, stretch * (begin + 0.5 * to.durations[k]));
      }
      begin += to.durations[k];
      between.durations[k] *= part + (1 - part) * stretch;
    }
    run.MoveWithin(&between);
    run.Simulate(&between);
    const double merit = run.MeritOf(between);
    if (!(merit < least) || !counts(between)) continue;
    least = merit;
    best = std::move(between);
  }
  return best;
}

}  // namespace saltus
