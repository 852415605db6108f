// Sub-steps of discs that move around each other in closed contact, in the event-driven model (event.h).
//
// The normal of two discs that slide or roll around each other turns, so that no constant acceleration keeps them in
// contact at all times. They move in sub-steps of constant acceleration. With R the distance of the centres, w = v_t /
// R the rate at which the normal turns and b its change, the gap is off by about
//
//   R w b s^3 / 4 + R b^2 s^4 / 16 + R w^4 s^4 / 8
//
// within s, which is kept below kLargestDrift. Without friction, and where they roll, the accelerations are those with
// which the gap (and the sliding) is zero at the end of the sub-step; an event before that end begins it again, to end
// there. With friction the forces are those at half the time, sub-steps are a tenth as long, and end where a contact
// opens or begins to slide.
#pragma once

#include <algorithm>
#include <cmath>
#include <optional>

#include "contact/event/event_group.h"
#include "contact/event/event_queue.h"

namespace saltus::internal {

// The longest sub-step of discs that move around each other at a distance, m, with a speed and acceleration along each
// other, s.
inline double LongestSubStep(double distance, double speed, double acceleration) {
  const double drift = kLargestDrift / distance;
  const double turn = std::abs(speed) / distance, change = std::abs(acceleration) / distance;
  double longest = kNever;
  if (turn * change > 0) longest = std::min(longest, std::cbrt(4 * drift / (turn * change)));
  if (change > 0) longest = std::min(longest, std::sqrt(4 * std::sqrt(drift) / change));
  if (turn > 0) longest = std::min(longest, std::sqrt(std::sqrt(8 * drift)) / turn);
  return longest;
}

template <typename T, int kRotation>
class SubSteps {
 public:
  // All must outlive this object.
  SubSteps(const StepInput<T>& in, const EventMotion<T, kRotation>& motion, const EventQueue<T, kRotation>& queue,
           EventGroup<T, kRotation>& group)
      : in_(in), motion_(motion), queue_(queue), group_(group) {}

  // Sets the accelerations of the group from `time` on. Returns the length of its sub-step, until `latest` at most, s;
  // 0 if its discs do not move around each other.
  T SetAccelerations(const T& time, const T& latest) {
    group_.SetAccelerations(T(0.0));
    T length = Length(time, latest);
    // The second pass uses the end that the first has found. With friction the sub-step is cut once, where a contact
    // mode ends; not again and again where forces that are not unique stay at the end of one.
    const int passes = EndsExactly() || group_.RollsAround() ? 2 : 1;
    bool cut = EndsExactly() || cuts_ >= kMostSubStepCuts;
    for (int pass = 0; pass < passes && Value(length) > 0; ++pass) {
      group_.SetAccelerations(length);
      const bool meets = Overlaps(Value(time), Value(length));
      if (meets) length *= 0.5;
      const double share = meets || cut || pass + 1 < passes ? 1.0 : group_.ShareInMode();
      const bool ends = share < 1;
      if (ends) length *= share;
      cut = cut || ends;
      if (meets || ends || (pass == 1 && group_.OpenPulling())) pass = -1;
    }
    cuts_ = cut && cuts_ < kMostSubStepCuts ? cuts_ + 1 : 0;
    return length;
  }

  // A closed pair, and one of its discs.
  struct Closed {
    int pair, disc;
  };
  // The closed pair whose sub-step is to begin again so that it ends at the next event of pair q, if there is one: its
  // accelerations are right at its end only, and the event comes before.
  std::optional<Closed> CutBy(int q) const {
    const Candidate& c = motion_.CandidateOf(q);
    const double end = queue_.pair(q).next;
    // An event closer than rounding would be found later, again and again.
    if (!queue_.pair(q).closed() && std::abs(motion_.ApproachAt(c, Value(motion_.LastTime(c))).gap) <= kRoundingGap) {
      return std::nullopt;
    }
    for (int i : {c.a, c.b}) {
      if ((i == c.b && c.plane) || !motion_.Moves(i)) continue;
      const auto& disc = motion_.disc(i);
      const double start = Value(disc.t), length = disc.sub_step_end - start;
      if (length == kNever || disc.sub_step_end - end <= kSubStepEnd * length || end - start <= kNodeMargin * in_.h) {
        continue;
      }
      for (int closed = 0; closed < motion_.num_pairs(); ++closed) {
        const Candidate& d = motion_.CandidateOf(closed);
        const EventPair& pair = queue_.pair(closed);
        if (!pair.closed() || (d.a != i && (d.plane || d.b != i))) continue;
        if (EndsExactly() || pair.turning == PairTurning::kRolling) return Closed{closed, i};
      }
    }
    return std::nullopt;
  }

 private:
  // Whether discs that slide around each other touch exactly at the end of each sub-step, as those that roll do. With
  // friction their mean force is right, wherever a sub-step ends; its work to second order in the sub-step.
  bool EndsExactly() const { return !(Value(in_.contact.friction) > 0); }

  T Length(const T& time, const T& latest) const {
    double step = kNever;
    bool curved = false;
    for (const auto& contact : group_.contacts()) {
      if (!contact.closed || !contact.Curved()) continue;
      curved = true;  // even if it does not turn, its derivative does
      const Candidate& c = motion_.CandidateOf(contact.pair);
      const double distance = std::abs(Value(TurningDistance(in_, c, T(in_.ContactDistance(c)))));
      step =
          std::min(step, LongestSubStep(distance, group_.PassingSpeed(contact), group_.PassingAcceleration(contact)));
    }
    const double now = Value(time), left = in_.h - now;
    if (!curved || left <= 0) return T(0.0);
    if (!EndsExactly()) {
      step *= kRoughSubStep;
      if (!group_.RollsAround()) return T(step == kNever ? 0.0 : left / std::ceil(left / step));
    }
    if (Value(latest) - now < step) return latest - time;
    return (now + left / std::max(1.0, std::ceil(left / step))) - time;
  }

  // Whether contacts without force overlap at the end of the sub-step.
  bool Overlaps(double time, double length) const {
    if (length <= kNodeMargin * in_.h) return false;
    return std::ranges::any_of(group_.contacts(), [&](const auto& contact) {
      if (contact.closed) return false;
      const Candidate& c = motion_.CandidateOf(contact.pair);
      return motion_.ApproachAt(c, time + length).gap < std::min(motion_.ApproachAt(c, time).gap, 0.0) - kLargestDrift;
    });
  }

  const StepInput<T>& in_;
  const EventMotion<T, kRotation>& motion_;
  const EventQueue<T, kRotation>& queue_;
  EventGroup<T, kRotation>& group_;
  int cuts_ = 0;  // of the last sub-steps in succession
};

}  // namespace saltus::internal
