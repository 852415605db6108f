// Sub-steps of discs that move around each other in closed contact, in the event-driven model (event.h).
//
// The normal of two discs that slide or roll around each other turns, so that no constant acceleration keeps them in
// contact at all times. They move in sub-steps.
//
// With friction a sub-step is one of a Runge-Kutta method of order 8 (EventGroup::SetCurves), in which no normal turns
// by more than kLongestTurn; it ends where a contact opens or begins to slide. Its error is below rounding at its end,
// and about 1e-12 of its size in between.
//
// Without friction, and in groups with more than kMostDenseRows conditions of discs that do not spin, sub-steps have a
// constant acceleration, with which the gap is zero at their ends; an event before the end begins the sub-step again,
// to end there. With R the distance of the centres, w = v_t / R the rate at which the normal turns and b its change,
// the gap is off by about
//
//   R w b s^3 / 4 + R b^2 s^4 / 16 + R w^4 s^4 / 8
//
// within s, which is kept below kLargestDrift.
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
  // Keeps references to all arguments, which must outlive this object.
  SubSteps(const StepInput<T>& in, const EventMotion<T, kRotation>& motion, const EventQueue<T, kRotation>& queue,
           EventGroup<T, kRotation>& group)
      : in_(in), motion_(motion), queue_(queue), group_(group) {}

  // Sets the motion of the group from `time` on. Returns the length of its sub-step, until `latest` at most where an
  // event ends it, s; 0 if its discs do not move around each other.
  double SetMotion(const T& time, const T& latest) {
    group_.SetAccelerations(T(0.0));
    if (HasCurves()) return SetCurves(Value(time));
    T length = Length(time, latest);
    // The second pass uses the end that the first has found.
    for (int pass = 0; pass < 2 && Value(length) > 0; ++pass) {
      group_.SetAccelerations(length);
      const bool meets = Overlaps(Value(time), Value(length));
      if (meets) length *= 0.5;
      if (meets || (pass == 1 && group_.OpenPulling())) pass = -1;
    }
    return Value(length);
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
    for (int i : {c.a, c.b}) {
      if ((i == c.b && c.plane) || !motion_.IsMovable(i)) continue;
      const auto& disc = motion_.disc(i);
      const double start = Value(disc.t), length = disc.sub_step_end - start;
      if (disc.curve != nullptr || length == kNever || disc.sub_step_end - end <= kSubStepEnd * length ||
          end - start <= kNodeMargin * in_.h) {
        continue;
      }
      // An event closer than rounding would be found later, again and again.
      if (!queue_.pair(q).closed() && std::abs(motion_.ApproachAt(c, Value(motion_.LastTime(c))).gap) <= kRoundingGap) {
        return std::nullopt;
      }
      for (int closed = 0; closed < motion_.num_pairs(); ++closed) {
        const Candidate& d = motion_.CandidateOf(closed);
        const EventPair& pair = queue_.pair(closed);
        if (pair.closed() && (d.a == i || (!d.plane && d.b == i))) return Closed{closed, i};
      }
    }
    return std::nullopt;
  }

 private:
  // Whether sub-steps have no constant accelerations: with friction, as long as the conditions are few enough to be
  // solved directly. The errors of an iteration would add up over the stages.
  bool HasCurves() const {
    if (!in_.HasFriction()) return false;
    int rows = 0;
    for (const auto& contact : group_.contacts()) rows += contact.closed * (1 + (contact.mode == ContactMode::kStick));
    return rows <= kMostDenseRows || kRotation == kSpin;
  }

  // Sets the motion of a group that HasCurves(); returns the length of its sub-step, s.
  double SetCurves(double time) {
    const double left = in_.h - time;
    double turns = -1;  // rad, of the normals until the end of the step
    for (const auto& contact : group_.contacts()) {
      if (!contact.closed || !contact.Curved()) continue;
      const Candidate& c = motion_.CandidateOf(contact.pair);
      const double distance = std::abs(Value(CurvatureRadius(in_, c, T(in_.ContactDistance(c)))));
      const double speed = group_.PassingSpeed(contact) / distance, change = group_.PassingAcceleration(contact);
      if (contact.mode == ContactMode::kSlip && speed == 0 && change == 0) continue;  // it is about to slide only
      // Where contacts do not move, small disturbances do, at the rate of a pendulum.
      const double pushing = std::abs(change) + contact.force_at_start / contact.force.mass;
      turns = std::max(turns, left * std::sqrt(speed * speed + pushing / distance));
    }
    if (turns < 0 || left <= 0) return 0;
    double length = left / std::max(1.0, std::ceil(turns / kLongestTurn));
    const double at_start = group_.ModeMargin() + kBeyondModeEnd;
    group_.SetCurves(length);
    while (Overlaps(time, length)) group_.SetCurves(length *= 0.5);
    // Forces do not jump where a contact mode ends, so derivatives only need a sub-step that ends there: just beyond
    // it. Not again and again where forces that are not unique stay at the end of a mode.
    const auto left_after = [&](double s) {
      group_.SetCurves(s);
      return group_.ModeMargin() + kBeyondModeEnd;
    };
    const double at_end = group_.ModeMargin() + kBeyondModeEnd;
    const bool cut = at_end < 0 && at_start > 0 && cuts_ < kMostSubStepCuts;
    if (cut) length = FindZero(0.0, at_start, length, at_end, 0.5 * kBeyondModeEnd, left_after);
    cuts_ = cut ? cuts_ + 1 : 0;
    return length;
  }

  T Length(const T& time, const T& latest) const {
    double step = kNever;
    bool curved = false;
    for (const auto& contact : group_.contacts()) {
      if (!contact.closed || !contact.Curved()) continue;
      curved = true;  // even if it does not turn, its derivative does
      const Candidate& c = motion_.CandidateOf(contact.pair);
      const double distance = std::abs(Value(CurvatureRadius(in_, c, T(in_.ContactDistance(c)))));
      step =
          std::min(step, LongestSubStep(distance, group_.PassingSpeed(contact), group_.PassingAcceleration(contact)));
    }
    const double now = Value(time), left = in_.h - now;
    if (!curved || left <= 0) return T(0.0);
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
