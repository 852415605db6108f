// One solve along a plan by a transcription with a cost for every step, and the exact roll-out of what it finds.
//
// Run::Transcriber makes the transcriptions of a plan (hybrid_transcription.h).
#pragma once

#include <algorithm>
#include <cmath>
#include <utility>
#include <vector>

#include "solve/phases/augmented_lagrangian.h"
#include "solve/phases/phase_plan.h"

namespace saltus {

// Shares `steps` out over phases that end at `ends`, as a grid of equal steps would: none to those that are tied, at
// least one to each other, and if possible two.
inline std::vector<int> ShareSteps(int steps, const std::vector<double>& ends, const std::vector<bool>& empty) {
  int left = static_cast<int>(std::count(empty.begin(), empty.end(), false));  // phases still to be served
  const int least = steps >= 2 * left ? 2 : 1;
  std::vector<int> share;
  int node = 0;
  for (size_t j = 0; j < ends.size(); ++j) {
    if (empty[j]) {
      share.push_back(0);
      continue;
    }
    --left;
    const int last = steps - least * left;  // leaves enough for those that follow
    const int end = left == 0 ? steps : static_cast<int>(std::floor(steps * (ends[j] / ends.back())));
    share.push_back(std::clamp(end, node + least, last) - node);
    node += share.back();
  }
  return share;
}

// The exact roll-out of attempt->trial: fills trial.exact and realized. `motions` simulates motions of the run, as
// Run::Transcriber does.
template <typename Motions, typename Event, typename Motion>
void SimulatePlan(const Motions& motions, const PlanOf<Event>& plan, PlanAttemptOf<Motion>* attempt) {
  motions.Simulate(&attempt->trial);
  std::vector<double> times;
  for (size_t k = 0; k < plan.cuts.size(); ++k) {
    if (plan.cuts[k]) times.push_back(attempt->times[k]);
  }
  attempt->realized = motions.IsRealized(attempt->trial, plan.Sequence(), times);
}

// Moves nodes to half of Motions::NodeMargin before the events that are meant to be there (after them, if it is
// negative), where the exact model takes the event at the node; Motions::SideOf is 1, or -1 for events that want the
// other side and 0 for those that happen at nodes anyway.
//
// The intervals of a phase stretch with the node n at its end, so that the event moves with it, to e(n), often by more
// than the node. Nodes are moved to where their events are, n <- e(n); those that this does not bring nearer, by
//
//   n <- n + (e - n) / (1 - s),   s = (e - e') / (n - n') of two nodes n', n and their events e', e
template <typename Motions, typename Event, typename Motion>
class NodesAtEvents {
 public:
  NodesAtEvents(const Motions& motions, const PlanOf<Event>& plan, const std::vector<int>& steps)
      : motions_(motions), plan_(plan), steps_(steps), followed_(plan.cuts.size()) {}

  // Takes the times of the events of attempt->trial, which has been simulated, and moves its nodes. Returns false if
  // they are in place.
  bool Move(PlanAttemptOf<Motion>* attempt) {
    Motion& trial = attempt->trial;
    const double margin = motions_.NodeMargin(trial);
    std::vector<double> nodes;  // at the ends of phases, as they are
    double end = 0;
    std::size_t interval = 0;
    for (const int steps : steps_) {
      for (int k = 0; k < steps; ++k) end += trial.durations[interval++];
      nodes.push_back(end);
    }
    std::vector<double> ends;  // as they are to be
    std::size_t event = 0;
    bool moved = false;
    for (std::size_t k = 0; k < plan_.cuts.size(); ++k) {
      if (plan_.cuts[k]) attempt->times[k] = trial.exact.events[event++].time;
      const double side = plan_.cuts[k] ? motions_.SideOf(*plan_.cuts[k]) : 0;
      const Place place{nodes[k], attempt->times[k] - side * 0.5 * margin};
      moved = moved || (steps_[k] > 0 && std::abs(place.wanted - place.node) > 0.25 * std::abs(margin));
      FindSlope(place, std::abs(margin), &followed_[k]);
      ends.push_back(place.node + (place.wanted - place.node) / (1 - followed_[k].slope));
    }
    ends.push_back(DurationOf(trial));
    for (std::size_t k = plan_.cuts.size(); k-- > 0;) {
      if (plan_.tied[k]) ends[k] = ends[k + 1];
    }
    if (moved) SetEnds(ends, &trial);
    return moved;
  }

 private:
  struct Place {
    double node = NAN, wanted = NAN;
  };
  struct Followed {
    Place last;
    double slope = 0;
  };

  // Finds the slope of the wanted place by the node where a step, if it was longer than rounding, has not brought them
  // nearer.
  static void FindSlope(const Place& now, double margin, Followed* followed) {
    constexpr double kRounding = 10;  // margins
    const Place last = std::exchange(followed->last, now);
    if (!(std::abs(now.node - last.node) > kRounding * margin)) return;
    const double slope = (now.wanted - last.wanted) / (now.node - last.node);
    const bool nearer = std::abs(now.wanted - now.node) < std::abs(last.wanted - last.node);
    if (!nearer && slope < 0) followed->slope = slope;
  }

  void SetEnds(const std::vector<double>& ends, Motion* trial) const {
    trial->durations.clear();
    double begin = 0;
    for (std::size_t j = 0; j < steps_.size(); ++j) {
      if (steps_[j] == 0) continue;
      trial->durations.insert(trial->durations.end(), steps_[j], (ends[j] - begin) / steps_[j]);
      begin = ends[j];
    }
  }

  const Motions& motions_;
  const PlanOf<Event>& plan_;
  const std::vector<int>& steps_;
  std::vector<Followed> followed_;  // of each cut
};

// Follows the events of attempt->trial, which has been simulated and whose phases have so many steps: what a solve
// leaves of gaps moves events off their nodes, by far less than a step.
template <typename Motions, typename Event, typename Motion>
void FollowEvents(const Motions& motions, const PlanOf<Event>& plan, const std::vector<int>& steps,
                  PlanAttemptOf<Motion>* attempt) {
  constexpr int kSnaps = 60;  // of events to nodes, at most
  NodesAtEvents<Motions, Event, Motion> nodes(motions, plan, steps);
  for (int round = 0; round < kSnaps && attempt->realized && nodes.Move(attempt); ++round) {
    SimulatePlan(motions, plan, attempt);
  }
}

template <typename Run>
class TranscribedPlan {
 public:
  using PhasePlan = PlanOf<typename Run::Event>;
  using PlanStart = PlanStartOf<typename Run::Motion>;
  using PlanAttempt = PlanAttemptOf<typename Run::Motion>;

  TranscribedPlan(Run* run, const PhasePlan& plan, const PlanStart& start, std::vector<int> steps)
      : run_(*run),
        plan_(plan),
        transcriber_(*run, plan, start),
        start_(start),
        steps_(std::move(steps)),
        are_given_(!steps_.empty()) {
    std::vector<double> ends = start.times;
    ends.push_back(transcriber_.duration());
    empty_ = {false};
    empty_.insert(empty_.end(), plan.tied.begin(), plan.tied.end());
    const auto phases = std::count(empty_.begin(), empty_.end(), false);
    if (are_given_) return;
    if (plan.on_grid) {
      for (const bool is_empty : empty_) steps_.push_back(is_empty ? 0 : 1);
    } else if (phases <= run_.num_steps()) {
      steps_ = ShareSteps(run_.num_steps(), ends, empty_);
    }
  }

  PlanAttempt Try(const ContinuePredicate& may_continue) {
    PlanAttempt attempt;
    if (steps_.empty()) return attempt;
    for (const double margin : kMargins) {
      const bool tied = plan_.HasTies();
      if (tied && margin == 0) continue;
      if (!Solve(margin, may_continue, &attempt)) return attempt;
      if (attempt.converged && !plan_.on_grid && !are_given_ && IsUneven(attempt.times)) {
        steps_ = ShareSteps(run_.num_steps(), attempt.times, empty_);
        ContinueFrom(attempt);
        if (!Solve(margin, may_continue, &attempt)) return attempt;
      }
      if (!attempt.converged || (!TouchesApart(attempt) && !crosses_ && (!tied || attempt.realized))) break;
      ContinueFrom(attempt);
    }
    return attempt;
  }

 private:
  static constexpr int kMostIterations = 400;  // of one solve
  // Relative to the scale of gaps: gaps that must not close stay open by so much, and the earlier of events at the same
  // time come early by so much, until rounding no longer decides the roll-out.
  static constexpr double kMargins[] = {0, 1e-9, 1e-8, 1e-7, 1e-6, 1e-5, 1e-4};

  void ContinueFrom(const PlanAttempt& attempt) {
    start_ = {{attempt.times.begin(), attempt.times.end() - 1}, attempt.trial};
  }

  // Whether some phase has become so long that its steps are too few.
  bool IsUneven(const std::vector<double>& times) const {
    double begin = 0;
    for (size_t j = 0; j < steps_.size(); ++j) {
      if (times[j] - begin > Run::kUneven * steps_[j] * times.back() / run_.num_steps()) return true;
      begin = times[j];
    }
    return false;
  }

  // Solves with a margin. Returns false if the start has no motion.
  bool Solve(double margin, const ContinuePredicate& may_continue, PlanAttempt* attempt) {
    std::vector<double> overlaps(plan_.cuts.size());
    int ties = 0;  // the earlier of events at the same time come earlier
    for (size_t k = plan_.cuts.size(); k-- > 0;) {
      ties = plan_.tied[k] ? ties + 1 : 0;
      overlaps[k] = ties * margin;
    }
    const auto transcription = transcriber_.Make(start_, overlaps, steps_, margin);
    if (transcription == nullptr) return false;
    const auto read = [&] {
      attempt->times = transcription->CutTimes();
      attempt->times.push_back(transcription->Duration());
      attempt->speeds = transcription->CutSpeeds();
    };
    bool left = false;
    AugmentedLagrangian::Options options;
    options.algorithm = run_.algorithm();
    options.one_of_many = run_.is_one_of_many();
    options.stop = run_.options().monitor.stop;
    if (!plan_.only_violation) options.most_cost = run_.most_loss();
    options.iterations = std::min(kMostIterations, run_.iterations_left());
    options.callback = [&](double cost) {
      if (!run_.Record(cost)) return false;
      read();
      left = !may_continue(attempt->times, attempt->speeds);
      return !left;
    };
    const AugmentedLagrangian::Summary summary = transcription->Minimize(options);
    read();
    attempt->valid = true;
    attempt->converged = summary.converged;
    attempt->planned_loss = summary.cost;
    attempt->interrupted = summary.interrupted && !left;
    attempt->jacobians += summary.jacobians;
    transcriber_.TakeControl(*transcription, &attempt->trial);
    SimulatePlan(transcriber_, plan_, attempt);
    if (!plan_.on_grid) FollowEvents(transcriber_, plan_, steps_, attempt);
    crosses_ = plan_.holds_borders && attempt->converged && !attempt->realized && !plan_.HasTies() &&
               transcriber_.HoldBorders(transcription.get(), attempt->trial);
    attempt->borders = transcriber_.borders();
    attempt->violation = transcriber_.ViolationOf(attempt->trial);
    return true;
  }

  // An event that must not happen has happened.
  bool TouchesApart(const PlanAttempt& attempt) const {
    const auto &met = attempt.trial.exact.contacts, planned = plan_.Sequence();
    const auto& apart = transcriber_.apart();
    return std::any_of(apart.begin(), apart.end(), [&](const auto& event) {
      return std::count(met.begin(), met.end(), event) > std::count(planned.begin(), planned.end(), event);
    });
  }

  Run& run_;
  const PhasePlan& plan_;
  typename Run::Transcriber transcriber_;
  PlanStart start_;
  std::vector<bool> empty_;  // by phase: without steps
  std::vector<int> steps_;   // of each phase; none if there are too few
  const bool are_given_;     // the steps
  bool crosses_ = false;     // the last motion, a guard that stays at zero along the plan
};

// With so many steps in each phase, or with those that suit the lengths of the phases.
template <typename Run>
PlanAttemptOf<typename Run::Motion> TryByTranscription(Run* run, const PlanOf<typename Run::Event>& plan,
                                                       const PlanStartOf<typename Run::Motion>& start,
                                                       const ContinuePredicate& may_continue,
                                                       std::vector<int> steps = {}) {
  return TranscribedPlan<Run>(run, plan, start, std::move(steps)).Try(may_continue);
}

}  // namespace saltus
