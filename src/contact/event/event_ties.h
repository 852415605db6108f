// Ties of the event-driven model (event.h): impacts at the same time that share discs.
//
// Where one disc strikes two at once, or a row of discs that touch is struck at both ends, Newton's law says what each
// impact does but not which comes first, and another order may lead to other velocities. A tie is a set of contacts
// that meet at the time of one impact and are connected through discs that move. It is ambiguous if its outcome, the
// velocities after all of its impacts, depends on the order in which contacts are preferred; in an order, the next
// impact is that of the first contact that closes. Each order is tried on the values of the discs, and its outcome
// compared.
#pragma once

#include <algorithm>
#include <cmath>
#include <memory_resource>
#include <span>
#include <type_traits>
#include <vector>

#include "contact/event/event_changes.h"

namespace saltus {

// Returns the number of orders that are tried for a tie of so many contacts: all permutations of up to kAllTieOrders
// contacts; for more contacts the same number of permutations, drawn by a generator with a fixed seed.
int NumTieOrders(int num_contacts);

// Rearranges the contacts of a tie, given in the order of the candidates, to order 1..NumTieOrders(contacts.size()).
// Higher numbers start again from the first.
void ArrangeTie(int order, std::span<int> contacts);

namespace internal {

// Whether a pair meets at the time of an impact: its gap is at most kTieGap of its contact distance and closes (or has
// opened) within kTieTime of the step; or it touches already. distance: at which the two touch, m; size: of the
// coordinates of the discs, m.
inline bool IsTied(const Approach& approach, double distance, double size, double h) {
  if (approach.Touching() || approach.gap <= kTieRounding * size) return true;
  return approach.gap <= kTieGap * distance && approach.gap <= kTieTime * h * std::abs(approach.speed);
}

template <typename T, int kRotation, typename Law>
class EventTies {
 public:
  // Keeps references to all arguments, which must outlive this object.
  EventTies(const StepInput<T>& in, EventMotion<T, kRotation>& motion, EventQueue<T, kRotation>& queue,
            EventChanges<T, kRotation, Law>& changes)
      : in_(in), motion_(motion), queue_(queue), changes_(changes), tied_(in.scratch), trial_(in.scratch) {}

  // Looks for other contacts that meet at the time of pair q's impact, and reports them if their order matters. Returns
  // true if it has taken the impacts, in the order that was asked for.
  bool ProcessTie(int q, double time) {
    if (motion_.num_pairs() < 2 || (in_.ties == nullptr && in_.tie_order == 0)) return false;
    if (time - queue_.pair(q).tied <= kTieTime * in_.h) return false;
    Find(q, time);
    if (tied_.size() < 2) return false;
    for (int r : tied_) queue_.pair(r).tied = time;
    if constexpr (std::is_same_v<T, double>) {
      if (in_.ties != nullptr && OrderMatters(time)) Report(time);
    }
    if (in_.tie_order == 0) return false;
    ArrangeTie(in_.tie_order, tied_);
    Take(time);
    return true;
  }

 private:
  using Disc = EventDisc<T, kRotation>;
  // The step before an order of impacts is tried, and the outcome of the first order.
  struct Trial {
    explicit Trial(std::pmr::memory_resource* scratch)
        : tied(scratch), discs(scratch), outcome(scratch), pairs(scratch) {}
    std::pmr::vector<int> tied;
    std::pmr::vector<Disc> discs, outcome;
    std::pmr::vector<EventPair> pairs;
  };

  // Pair q and all that meet at `time` and are connected with it through discs that move, in the order of the pairs.
  void Find(int q, double time) {
    tied_.assign(1, q);
    for (std::size_t k = 0; k < tied_.size(); ++k) {
      motion_.ForEachPairBeside(motion_.CandidateOf(tied_[k]), [&](int r) {
        const Candidate& d = motion_.CandidateOf(r);
        if (std::ranges::find(tied_, r) != tied_.end()) return;
        if (IsTied(motion_.ApproachAt(d, time), in_.ContactDistance(d), motion_.SizeAt(d, time), in_.h)) {
          tied_.push_back(r);
        }
      });
    }
    std::ranges::sort(tied_);
  }

  // Takes the impacts among tied_, which lists them in order of preference; after kMostTiedImpacts, the others are left
  // to the queue. Returns whether there was ever a choice.
  bool Take(double time) {
    bool choice = false;
    for (int count = 0; count < kMostTiedImpacts; ++count) {
      int next = -1;
      for (int r : tied_) {
        if (motion_.ApproachAt(motion_.CandidateOf(r), time).speed >= -kSlowSpeed) continue;
        choice = choice || next >= 0;
        if (next < 0) next = r;
        if (choice) break;
      }
      if (next < 0) break;
      const T at = motion_.ImpactTime(motion_.CandidateOf(next), time);
      changes_.Impact(next, {at, changes_.NewEvent()}, /*pressed=*/false);
    }
    return choice;
  }

  // Tries the orders, and restores the step.
  bool OrderMatters(double time) {
    double fastest = 0;
    for (int r : tied_) fastest = std::max(fastest, -motion_.ApproachAt(motion_.CandidateOf(r), time).speed);
    if (fastest <= kTieSlowSpeed) return false;
    const double same = kTieSpeed * fastest + kTieSlowSpeed;
    trial_.tied = tied_;
    trial_.discs = motion_.discs();
    trial_.pairs = queue_.pairs();
    const auto counts = changes_.counts();
    const std::size_t touches = in_.touches != nullptr ? in_.touches->size() : 0;
    bool matters = false, choice = true;
    for (int k = 1; k <= NumTieOrders(static_cast<int>(tied_.size())) && choice && !matters; ++k) {
      tied_ = trial_.tied;
      ArrangeTie(k, tied_);
      choice = Take(time) || k > 1;
      if (k == 1) trial_.outcome = motion_.discs();
      for (int i = 0; i < motion_.num_discs(); ++i) matters = matters || Difference(i, time) > same;
      motion_.discs() = trial_.discs;
      queue_.pairs() = trial_.pairs;
      changes_.set_counts(counts);
      if (in_.touches != nullptr) in_.touches->resize(touches);
    }
    tied_ = trial_.tied;
    return matters;
  }

  // Returns how much the velocity of disc i, and of its rim by spin, differs between the first order and this one, m/s.
  double Difference(int i, double time) const {
    const Disc &first = trial_.outcome[i], &now = motion_.disc(i);
    double difference = (first.VelocityAt(time) - now.VelocityAt(time)).norm();
    if constexpr (kRotation == kSpin) {
      const double turning = first.turn.SpeedAfter(time - first.t) - now.turn.SpeedAfter(time - now.t);
      difference += in_.bodies[i].radius * std::abs(turning);
    }
    return difference;
  }

  void Report(double time) const {
    const int tie = in_.ties->empty() ? 0 : in_.ties->back().tie + 1;
    for (int r : tied_) in_.ties->push_back({motion_.CandidateOf(r), std::clamp(time, 0.0, in_.h), tie});
  }

  const StepInput<T>& in_;
  EventMotion<T, kRotation>& motion_;
  EventQueue<T, kRotation>& queue_;
  EventChanges<T, kRotation, Law>& changes_;
  std::pmr::vector<int> tied_;  // pairs
  Trial trial_;
};

}  // namespace internal
}  // namespace saltus
