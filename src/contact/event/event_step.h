// One step of the event-driven model (event.h), composed of
//
//   EventMotion   the discs between events: gaps, times of events            event_motion.h
//   EventQueue    the states of the pairs, and their next events             event_queue.h
//   EventChanges  impacts, releases, stops, pockets                          event_changes.h
//   EventTies     impacts at the same time                                   event_ties.h
//   EventGroup    closed contacts and their forces                           event_group.h
//   SubSteps      sub-steps of discs that move around each other             event_sub_steps.h
//
// Every disc carries the time since which its acceleration is constant, and is moved only by its own events; discs that
// never meet therefore do not influence each other's bits. All decisions are taken on values.
#pragma once

#include <algorithm>
#include <cmath>
#include <limits>
#include <string_view>
#include <type_traits>

#include "contact/event/event_sub_steps.h"
#include "contact/event/event_ties.h"

namespace saltus::internal {

// `Law` gives the restitution and friction of an impact; resting contacts have those of `in`.
template <typename T, int kRotation, typename Law>
class EventStep {
 public:
  using State = BodyState<T, kRotation>;
  static constexpr bool kMayFallBack = EventChanges<T, kRotation, Law>::kMayFallBack;

  EventStep(const StepInput<T>& in, const Law& law, std::span<const State> x)
      : in_(in),
        motion_(in, x),
        queue_(in, motion_),
        changes_(in, law, motion_, queue_),
        ties_(in, motion_, queue_, changes_),
        group_(in),
        sub_steps_(in, motion_, queue_, group_) {
    group_.SetDiscs(motion_.discs());
    group_.SetIterationLimited(changes_.MayFallBack());
  }
  EventStep(const EventStep&) = delete;  // its parts refer to each other
  EventStep& operator=(const EventStep&) = delete;

  bool MayHaveContact() const { return motion_.MayHaveContact(); }

  // Whether the step is to be taken by time-stepping instead (event_fallback.h). Then it has reported nothing.
  bool FallsBack() const {
    if (!changes_.falls_back()) return false;
    if (in_.touches != nullptr) in_.touches->clear();
    if (in_.ties != nullptr) in_.ties->clear();
    if (in_.solved != nullptr) in_.solved->Clear();
    return true;
  }

  // Takes the step. Not inlined, because GCC 12 cannot flatten it as a whole.
  [[gnu::noinline]] void Run() {
    for (int q = 0; in_.num_pockets > 0 && q < motion_.num_pairs(); ++q) {
      const Candidate& c = motion_.CandidateOf(q);
      if (motion_.IsInPocket(c) && !motion_.IsPocketed(c)) changes_.PocketDisc(q, {motion_.PocketTime(c, 0)});
    }
    for (int i = 0; in_.table >= 0 && i < motion_.num_discs(); ++i) changes_.Slide(i);
    queue_.PredictAll();
    for (int count = 0; count < kMaxEvents; ++count) {
      int q = queue_.NextPair();
      if (q < 0) return Finish();
      q = queue_.FirstSimultaneous(q);
      if (const auto cut = sub_steps_.CutBy(q)) {
        const auto& disc = motion_.disc(cut->disc);
        FindContactForces(cut->pair, Instant<T>{disc.t, disc.event}, queue_.EventTime(q));
      } else {
        ProcessEvent(q, changes_.NewEvent());
      }
      if (changes_.failed()) return;
      queue_.PredictDirty();
      for (auto& disc : motion_.discs()) disc.dirty = false;
    }
    static_assert(kMaxEvents == 200000);
    changes_.Fail("more than 200000 events happen within the step, the most that are resolved: use more `steps`");
  }

  // Whether an event changed disc i, and if so its state at the end of the step (not a number if the step has failed).
  // A disc that was only examined, because of others, flies freely.
  bool HasMoved(int i) const { return motion_.disc(i).moved && (motion_.disc(i).reported || changes_.failed()); }
  State End(int i) const {
    const auto& disc = motion_.disc(i);
    const T end(changes_.failed() ? std::numeric_limits<double>::quiet_NaN() : in_.h);
    const Vec2<T> p = disc.PositionAt(end), v = disc.VelocityAt(end);
    if constexpr (kRotation == kSpin) {
      const T s = end - disc.t;
      return {p, v, {disc.turn.AngleAfter(s), disc.turn.SpeedAfter(s)}};
    } else {
      return {p, v};
    }
  }

 private:
  using Group = EventGroup<T, kRotation>;

  // Processes the next event of pair q.
  void ProcessEvent(int q, int event) {
    const Candidate& c = motion_.CandidateOf(q);
    const double time = queue_.pair(q).next;
    if (motion_.IsTable(c)) return changes_.Stop(c.a, event);
    if (motion_.IsPocket(c)) return changes_.PocketDisc(q, {queue_.EventTime(q), event});
    if (queue_.pair(q).state == PairState::kLeaving) return changes_.Release(c.a, {queue_.EventTime(q), event});
    if (queue_.pair(q).closed()) return FindContactForces(q, {queue_.EventTime(q), event}, T(kNever));
    const Approach approach = motion_.ApproachAt(c, time);
    if (approach.speed < -queue_.SlowSpeed(q, time)) {
      const bool pressed = approach.HasClosingForce() && motion_.TouchesAlone(q, time);
      if (!ties_.ProcessTie(q, time)) changes_.Impact(q, {motion_.ImpactTime(c, time), event}, pressed);
      return;
    }
    const Instant<T> at{motion_.SlowTime(c, time, approach), event};
    // Within a pile, taking the speed of one pair away makes the next close, without end: the group is settled at once.
    if (approach.HasClosingForce() || (!approach.Grazing() && !motion_.TouchesAlone(q, time))) {
      return FindContactForces(q, at, T(kNever));
    }
    changes_.Report(c, ContactMode::kFrictionless, at.time, ContactKind::kGrazing);
    if (approach.Grazing()) return queue_.Pass(q, approach);  // the motion does not change
    changes_.StopClosing(q, at);
  }

  // Finds the contact forces, at an instant, of all pairs that touch and are connected with pair q through discs, and
  // the accelerations from then on: for discs that move around each other until `latest` at most. The instant may be
  // that of an earlier event, whose sub-step begins again.
  void FindContactForces(int q, const Instant<T>& at, const T& latest) {
    if (in_.table >= 0) return changes_.Fail("discs have active contacts with each other while they slide on a table");
    group_.Clear();
    AddPair(q, at);
    while (AddConnectedPairs(at)) continue;
    if (changes_.MayFallBack() && group_.contacts().size() >= std::size_t{kManyDiscs} &&
        ++large_groups_ > kMostLargeGroups) {
      return changes_.Fail("contact groups without end");
    }
    if (!group_.SolveForces() || !group_.Close()) {
      return changes_.Fail("the forces of contacts at rest are not found");
    }
    const double sub_step = sub_steps_.SetMotion(at.time, latest);
    for (const auto& contact : group_.contacts()) UpdatePair(contact, at, sub_step);
  }

  void AddPair(int q, const Instant<T>& at) {
    const Candidate& c = motion_.CandidateOf(q);
    if (!group_.HasDisc(c.a)) changes_.Release(c.a, at);
    if (!c.plane && !group_.HasDisc(c.b)) changes_.Release(c.b, at);
    group_.Add(q, queue_.pair(q).turns);
  }
  // Adds the pairs that touch a disc of the group. Returns whether there are any.
  bool AddConnectedPairs(const Instant<T>& at) {
    bool grows = false;
    const double time = Value(at.time);
    for (int q = 0; q < motion_.num_pairs(); ++q) {
      const Candidate& c = motion_.CandidateOf(q);
      if (group_.Contains(q) || (!group_.HasDisc(c.a) && (c.plane || !group_.HasDisc(c.b)))) continue;
      if (Value(motion_.LastTime(c)) > time) continue;  // the sub-step of the group begins again, before that
      const bool drifted = queue_.pair(q).turns && queue_.pair(q).released == at.event;
      if (!drifted && !motion_.ApproachAt(c, time).Touching(queue_.SlowSpeed(q, time))) continue;
      AddPair(q, at);
      grows = true;
    }
    return grows;
  }

  // Sets the state of a pair whose group has been settled, and its next event: `sub_step` is 0 if there is no end.
  void UpdatePair(const typename Group::Contact& contact, const Instant<T>& at, double sub_step) {
    const Candidate& c = motion_.CandidateOf(contact.pair);
    EventPair& pair = queue_.pair(contact.pair);
    const bool curved = contact.closed && contact.Curved() && sub_step > 0;
    pair.turns = curved;
    pair.passed = at.event;
    pair.precedes = false;
    if (contact.closed || contact.stopped) ReportSustained(contact, at.time);
    if (!contact.closed) return pair.Change(PairChange::kSettled, PairState::kFree);
    const double now = Value(at.time), end = sub_step > 0 ? now + sub_step : kNever;
    motion_.disc(c.a).sub_step_end = end;
    if (!c.plane) motion_.disc(c.b).sub_step_end = end;
    PairState state = PairState::kClosed;
    pair.next = curved ? end : kNever;
    // Events at the end of a sub-step that was cut there count as before it.
    const auto comes_first = [&](double event) {
      return event < kNever && event - pair.next <= kSubStepEnd * sub_step;
    };
    if (const double leaves = now + motion_.TimeOnEdge(c, now); comes_first(leaves)) {
      pair.next = std::min(leaves, pair.next);
      state = PairState::kLeaving;
    }
    const double sliding = group_.SlidingSpeed(contact), change = group_.SlidingAcceleration(contact);
    if (contact.mode == ContactMode::kSlip && std::abs(sliding) > kStickSpeed) {
      double stop = sliding * change < 0 ? now - sliding / change : kNever;
      if (sub_step > 0) stop = motion_.FirstStop(c, now, end + kSubStepEnd * sub_step);
      if (comes_first(stop)) {
        pair.next = std::min(stop, pair.next);
        state = PairState::kStopping;
      }
    }
    pair.precedes = state == PairState::kStopping;
    pair.Change(PairChange::kSettled, state);
  }

  // Reports a sustained contact, once for each of its modes.
  void ReportSustained(const typename Group::Contact& contact, const T& time) {
    int& reported = queue_.pair(contact.pair).reported_mode;
    if (reported == static_cast<int>(contact.mode)) return;
    reported = static_cast<int>(contact.mode);
    changes_.Report(motion_.CandidateOf(contact.pair), contact.mode, time, ContactKind::kSustained);
  }

  void Finish() {
    CloseTurningPairs();
    if constexpr (std::is_same_v<T, double>) {
      const std::string_view wrong = motion_.ReasonInconsistent(changes_.pocketed_energy());
      if (!wrong.empty()) changes_.Fail(wrong);
    }
  }
  // Makes discs that moved around each other end the step exactly in contact.
  void CloseTurningPairs() {
    for (int q = 0; q < motion_.num_pairs(); ++q) {
      if (!queue_.pair(q).closed() || !queue_.pair(q).turns) continue;
      group_.Clear();
      AdvanceGroup(q, {T(in_.h), changes_.counts().events});
      for (const auto& contact : group_.contacts()) queue_.pair(contact.pair).turns = false;
      group_.ProjectPositions();
      group_.ProjectVelocities();
    }
  }
  // Moves all discs in closed contact with those of pair q to an instant.
  void AdvanceGroup(int q, const Instant<T>& at) {
    const EventPair& pair = queue_.pair(q);
    if (!pair.closed() || group_.Contains(q)) return;
    const Candidate& c = motion_.CandidateOf(q);
    changes_.MoveTo(c.a, at);
    if (!c.plane) changes_.MoveTo(c.b, at);
    group_.AddClosed(q, static_cast<ContactMode>(pair.reported_mode), pair.turns);
    motion_.ForEachPairBeside(c, [&](int other) { AdvanceGroup(other, at); });
  }

  const StepInput<T>& in_;
  EventMotion<T, kRotation> motion_;
  EventQueue<T, kRotation> queue_;
  EventChanges<T, kRotation, Law> changes_;
  EventTies<T, kRotation, Law> ties_;
  Group group_;
  SubSteps<T, kRotation> sub_steps_;
  int large_groups_ = 0;  // that have been settled
};

}  // namespace saltus::internal
