// The states of the pairs of a step of the event-driven model (event.h), and their next events in order of time.
//
// A pair is free (flight, impacts), or closed: a contact force keeps its gap at zero. The README of this folder draws
// the states and the transitions of kPairTransitions with the equation of each.
#pragma once

#include <glog/logging.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <memory_resource>
#include <span>
#include <vector>

#include "contact/event/event_motion.h"

namespace saltus::internal {

// The state of a pair, by which its next event is known.
enum class PairState : char {
  kFree,      // no contact force; the next event is an impact or a slow touch, if there is one
  kWaiting,   // touches slowly within a pile; its contact group is formed after the impacts at the same time
  kClosed,    // a contact force keeps the gap at zero; the next event is the end of its sub-step, if it has one
  kStopping,  // closed and sliding; the next event is the end of sliding
  kLeaving,   // closed; the next event is that the disc reaches the end of its edge
};
inline constexpr int kNumPairStates = 5;
inline const char* PairStateToString(PairState state) {
  constexpr const char* kNames[kNumPairStates] = {"free", "waiting", "closed", "stopping", "leaving"};
  return kNames[static_cast<int>(state)];
}
inline constexpr bool IsClosed(PairState state) { return state >= PairState::kClosed; }

// The reason for a change of the state of a pair.
enum class PairChange : char {
  kPredicted,  // its next event has been found again, after the motion of one of its discs has changed
  kSettled,    // the forces of its contact group have been found
  kReleased,   // an event of one of its discs has ended the contact
};

struct PairTransition {
  PairState from;
  PairChange change;
  PairState to;
};
// All transitions. Contact forces are found for pairs in any state; a closed pair is predicted only after its release.
inline constexpr auto kPairTransitions = [] {
  using enum PairState;
  using enum PairChange;
  return std::array{
      PairTransition{kFree, kPredicted, kFree},
      PairTransition{kFree, kPredicted, kWaiting},
      PairTransition{kWaiting, kPredicted, kFree},
      PairTransition{kWaiting, kPredicted, kWaiting},
      PairTransition{kFree, kSettled, kFree},
      PairTransition{kFree, kSettled, kClosed},
      PairTransition{kFree, kSettled, kStopping},
      PairTransition{kFree, kSettled, kLeaving},
      PairTransition{kWaiting, kSettled, kFree},
      PairTransition{kWaiting, kSettled, kClosed},
      PairTransition{kWaiting, kSettled, kStopping},
      PairTransition{kWaiting, kSettled, kLeaving},
      PairTransition{kClosed, kReleased, kFree},
      PairTransition{kStopping, kReleased, kFree},
      PairTransition{kLeaving, kReleased, kFree},
  };
}();
inline constexpr bool IsTransition(PairState from, PairChange change, PairState to) {
  return std::ranges::any_of(
      kPairTransitions, [&](const PairTransition& t) { return t.from == from && t.change == change && t.to == to; });
}

struct EventPair {
  double next = kNever;  // s, its next event
  PairState state = PairState::kFree;
  bool turns = false;  // its discs have moved around each other since it was last closed exactly
  // For the order of events at the same time; both outlast a change of the state.
  bool precedes = false;   // when its forces were last found, sliding was to end
  bool waits = false;      // when it was last predicted, it was to wait
  int passed = -1;         // number of the event since which its touching needs nothing
  int released = -1;       // number of the event that last ended its contact
  int impacts = 0;         // in this step, once there are kManyImpacts
  int meetings = 0;        // impacts in this step
  int reported_mode = -1;  // of the last report as a sustained contact
  double met = -kNever;    // s, its last impact
  double tied = -kNever;   // s, when it was last found in a tie

  bool closed() const { return IsClosed(state); }
  void Change(PairChange change, PairState to) {
    DCHECK(IsTransition(state, change, to)) << PairStateToString(state) << " to " << PairStateToString(to);
    state = to;
  }
};

template <typename T, int kRotation>
class EventQueue {
 public:
  // Both must outlive this object.
  EventQueue(const StepInput<T>& in, const EventMotion<T, kRotation>& motion)
      : in_(in),
        motion_(motion),
        pairs_(in.candidates.size(), in.scratch),
        at_once_(in.scratch),
        limit_(in.h * (1 - kNodeMargin)) {}

  std::pmr::vector<EventPair>& pairs() { return pairs_; }
  EventPair& pair(int q) { return pairs_[q]; }
  const EventPair& pair(int q) const { return pairs_[q]; }

  // Returns the pair whose event comes first, -1 if there is none in this step.
  int NextPair() const {
    int next = -1;
    double time = limit_;
    for (int q = 0; q < motion_.num_pairs(); ++q) {
      if (pairs_[q].next < time || (pairs_[q].next == time && next >= 0 && Precedes(q, next))) {
        time = pairs_[q].next;
        next = q;
      }
    }
    return next;
  }

  // Returns the first candidate among the impacts at the time of pair q's event that are connected with it through
  // moving discs. Without this rule, rounding would decide which of them comes first; the derivatives would then belong
  // to an order that depends on where steps begin and that may not occur in any disturbed motion.
  int FirstSimultaneous(int q) {
    const double time = pairs_[q].next;
    bool alone = true;
    for (int r = 0; r < motion_.num_pairs(); ++r) alone = alone && (r == q || !IsSimultaneous(r, time));
    if (alone || !MayPrecede(q, time)) return q;
    at_once_.assign(1, q);
    for (std::size_t k = 0; k < at_once_.size(); ++k) {
      motion_.ForEachPairBeside(motion_.CandidateOf(at_once_[k]), [&](int r) {
        if (std::ranges::find(at_once_, r) == at_once_.end() && MayPrecede(r, time)) at_once_.push_back(r);
      });
    }
    const int first = *std::ranges::min_element(at_once_);
    pairs_[first].next = time;
    return first;
  }

  // Finds the next events of all pairs, or of those whose discs have changed their motion.
  void PredictAll() {
    for (int q = 0; q < motion_.num_pairs(); ++q) Predict(q);
  }
  void PredictDirty() {
    for (int q = 0; q < motion_.num_pairs(); ++q) {
      if (motion_.IsDirty(q)) Predict(q);
    }
  }

  // Sets the next event of pair q, which touches slowly and separates by itself, to the following impact, if any.
  void Pass(int q, const Approach& approach) {
    const double time = pairs_[q].next;
    const Candidate& c = motion_.CandidateOf(q);
    pairs_[q].passed = motion_.LastDisc(c).event;
    const auto next = [&](double from, const GapPolynomial& gap) {
      return from + motion_.FirstClosingOf(c, from, gap, TimeLeft(from), true);
    };
    pairs_[q].next = next(time, approach.polynomial);
    if (pairs_[q].next > time) return;
    // Where the gap grows slowly, rounding would close it at this time again and again: it is measured a bit later.
    const double wait = kNodeMargin * in_.h;
    pairs_[q].next = next(time + wait, ShiftedTo(approach.polynomial, wait));
  }

  // The predicted time of the next event of pair q, with derivatives.
  T EventTime(int q) const {
    const Candidate& c = motion_.CandidateOf(q);
    const double time = pairs_[q].next;
    if (motion_.IsPocket(c)) return motion_.PocketTime(c, time);
    switch (pairs_[q].state) {
      case PairState::kLeaving:
        return motion_.LeavingTime(c, time);
      case PairState::kStopping:
        return motion_.StopTime(c, time);
      case PairState::kClosed:
        return T(time);
      default:
        break;
    }
    const Approach approach = motion_.ApproachAt(c, time);
    return approach.speed < -SlowSpeed(q, time) ? motion_.ImpactTime(c, time) : motion_.SlowTime(c, time, approach);
  }

  // The largest speed at which pair q does not bounce, m/s. Within a pile, where each bounce causes others (Zeno
  // behaviour), it grows with their number.
  double SlowSpeed(int q, double time) const {
    const int beyond = Repetitions(q) - kRepeatedImpacts;
    if (beyond <= 0 || motion_.TouchesAlone(q, time)) return kSlowSpeed;
    return std::min(std::ldexp(kSlowSpeed, beyond), kLargestSlowSpeed);
  }

 private:
  double TimeLeft(double time) const { return std::max(limit_ - time, 0.0); }

  void Predict(int q) {
    EventPair& pair = pairs_[q];
    if (pair.closed()) return;
    pair.Change(PairChange::kPredicted, PairState::kFree);
    pair.waits = false;
    const Candidate& c = motion_.CandidateOf(q);
    if (motion_.IsPocketed(c)) {
      pair.next = kNever;
      return;
    }
    if (motion_.IsTable(c)) {
      const double speed = Value(Length(motion_.disc(c.a).v));
      pair.next = speed > 0 && in_.slowing > 0 ? Value(motion_.disc(c.a).t) + speed / in_.slowing : kNever;
      return;
    }
    const double now = Value(motion_.LastTime(c));
    Approach approach = motion_.ApproachAt(c, now);
    if (motion_.IsPocket(c)) {
      const std::span<const double> wait =
          in_.Solved([&] { return std::array{FirstClosing(approach.polynomial, TimeLeft(now))}; });
      pair.next = now + wait[0];
      return;
    }
    bool ignore_start = false;
    if (approach.Touching(SlowSpeed(q, now)) && !Bounces(q, approach, now)) {
      const bool matters = approach.HasClosingForce() || approach.speed < -kStillSpeed;
      if (matters && pair.passed != motion_.LastDisc(c).event) {
        pair.next = now;
        pair.waits = Repetitions(q) > kRepeatedImpacts;
        if (pair.waits) pair.Change(PairChange::kPredicted, PairState::kWaiting);
        return;
      }
      ignore_start = true;
      if (std::abs(approach.speed) <= kStillSpeed) approach.polynomial.c[1] = 0;  // or it might turn at once
      if (std::abs(approach.gap) <= kRoundingGap) approach.polynomial.c[0] = 0;
    }
    const std::span<const double> wait = in_.Solved(
        [&] { return std::array{motion_.FirstClosingOf(c, now, approach.polynomial, TimeLeft(now), ignore_start)}; });
    pair.next = now + wait[0];
  }

  // Whether a pair that touches is among the last of its bounces when the step begins. It meets once more: stopping it
  // here would take its speed without the friction of that impact, and at a time that has no derivative.
  bool Bounces(int q, const Approach& approach, double now) const {
    return std::abs(approach.speed) > kSharpSpeed && approach.gap > kRoundingGap && approach.HasClosingForce() &&
           motion_.TouchesAlone(q, now);
  }

  // Whether q comes first of two events at one time. The end of sliding precedes the end of the sub-step cut there.
  bool Precedes(int q, int other) const {
    return pairs_[q].precedes || (pairs_[other].waits && pairs_[q].state == PairState::kFree);
  }
  bool IsSimultaneous(int r, double time) const { return pairs_[r].next - time <= kTieTime * in_.h; }
  // Whether the next event of pair r is an impact or the rim of a pocket, at `time` up to rounding.
  bool MayPrecede(int r, double time) const {
    const Candidate& c = motion_.CandidateOf(r);
    const double wait = pairs_[r].next - time;
    if (pairs_[r].closed() || motion_.IsTable(c) || !IsSimultaneous(r, time)) return false;
    const double speed = motion_.ApproachAt(c, time).speed;
    return speed < -SlowSpeed(r, time) && -speed * wait <= kRoundingGap * (1 + motion_.SizeAt(c, time)) &&
           Value(motion_.LastTime(c)) <= time;
  }

  // Returns how often pair q has met since the step has had kManyImpacts, at most as often as its discs have met
  // others. It is 0 with friction, with which piles come to rest, and for elastic impacts, with which they never do.
  int Repetitions(int q) const {
    const Candidate& c = motion_.CandidateOf(q);
    const PairConstants<T>& contact = in_.ContactOf(c);
    if (Value(contact.friction) > 0 || Value(contact.restitution) >= 1) return 0;
    const int own = pairs_[q].impacts;
    const auto others = [&](int i) { return motion_.IsMovable(i) ? motion_.disc(i).impacts - own : 0; };
    return std::min(own, others(c.a) + (c.plane ? 0 : others(c.b)));
  }

  const StepInput<T>& in_;
  const EventMotion<T, kRotation>& motion_;
  std::pmr::vector<EventPair> pairs_;
  std::pmr::vector<int> at_once_;  // pairs, of FirstSimultaneous
  const double limit_;             // s; later events are left to the next step
};

}  // namespace saltus::internal
