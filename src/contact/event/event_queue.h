// Which event of a step of the event-driven model (event.h) comes next, and when.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <span>

#include "contact/event/event_motion.h"

namespace saltus::internal {

template <typename T, int kRotation>
class EventQueue : protected EventMotion<T, kRotation> {
 protected:
  using Discs = EventMotion<T, kRotation>;
  using Discs::in_, Discs::discs_, Discs::pairs_, Discs::num_pairs, Discs::CandidateOf, Discs::IsTable, Discs::IsPocket,
      Discs::IsOut, Discs::PocketTime, Discs::LastTime, Discs::LastDisc, Discs::ApproachAt, Discs::FirstClosingOf,
      Discs::TouchesAlone, Discs::LeavingTime, Discs::StopTime, Discs::ImpactTime, Discs::SlowTime, Discs::Moves;
  using typename Discs::State, typename Discs::Pair;

  EventQueue(const StepInput<T>& in, std::span<const State> x)
      : EventMotion<T, kRotation>(in, x), limit_(in.h * (1 - kNodeMargin)) {}

  // The pair whose event comes first, -1 if there is none in this step.
  int NextPair() const {
    int next = -1;
    double time = limit_;
    for (int q = 0; q < num_pairs(); ++q) {
      if (pairs_[q].next < time || (pairs_[q].next == time && next >= 0 && Precedes(q, next))) {
        time = pairs_[q].next;
        next = q;
      }
    }
    return next;
  }

  double LeftAfter(double time) const { return std::max(limit_ - time, 0.0); }

  // Finds the next event of pair q.
  void Predict(int q) {
    Pair& pair = pairs_[q];
    if (pair.held) return;
    pair.waits = false;
    const Candidate& c = CandidateOf(q);
    if (IsOut(c)) {
      pair.next = kNever;
      return;
    }
    if (IsTable(c)) {
      const double speed = Value(Length(discs_[c.a].v));
      pair.next = speed > 0 && in_.slowing > 0 ? Value(discs_[c.a].t) + speed / in_.slowing : kNever;
      return;
    }
    const double now = Value(LastTime(c));
    Approach approach = ApproachAt(c, now);
    if (IsPocket(c)) {
      const std::span<const double> wait =
          in_.Solved([&] { return std::array{FirstClosing(approach.polynomial, LeftAfter(now))}; });
      pair.next = now + wait[0];
      return;
    }
    bool ignore_start = false;
    if (approach.Touching(SlowSpeed(q, now)) && !Bounces(q, approach, now)) {
      const bool matters = approach.Pushing() || approach.speed < -kStillSpeed;
      if (matters && pair.passed != LastDisc(c).order) {
        pair.next = now;
        pair.waits = IsCrowded(q);
        return;
      }
      ignore_start = true;
      if (std::abs(approach.speed) <= kStillSpeed) approach.polynomial.c[1] = 0;  // or it might turn at once
      if (std::abs(approach.gap) <= kRoundingGap) approach.polynomial.c[0] = 0;
    }
    const std::span<const double> wait = in_.Solved(
        [&] { return std::array{FirstClosingOf(c, now, approach.polynomial, LeftAfter(now), ignore_start)}; });
    pair.next = now + wait[0];
  }

  // The predicted time of the next event of pair q, with derivatives.
  T EventTime(int q) const {
    const Candidate& c = CandidateOf(q);
    const double time = pairs_[q].next;
    if (IsPocket(c)) return PocketTime(c, time);
    if (pairs_[q].held && pairs_[q].leaving) return LeavingTime(c, time);
    if (pairs_[q].held) return pairs_[q].stopping ? StopTime(c, time) : T(time);
    const Approach approach = ApproachAt(c, time);
    return approach.speed < -SlowSpeed(q, time) ? ImpactTime(c, time) : SlowTime(c, time, approach);
  }

  // Up to which speed pair q touches slowly: it does not bounce. Within a pile, where each bounce sets off others, that
  // grows with their number.
  double SlowSpeed(int q, double time) const {
    const int beyond = Crowding(q) - kCrowdedImpacts;
    if (beyond <= 0 || TouchesAlone(q, time)) return kSlowSpeed;
    return std::min(std::ldexp(kSlowSpeed, beyond), kLargestSlowSpeed);
  }

  double limit_;     // s, events after it are left to the next step
  int impacts_ = 0;  // in this step

 private:
  // Whether a pair that touches is amid the last of its bounces, in which a step began. It meets once more: stopped
  // here, it would lose its speed without the friction of that impact, and at a time without derivative.
  bool Bounces(int q, const Approach& approach, double now) const {
    return std::abs(approach.speed) > kSharpSpeed && approach.gap > kRoundingGap && approach.Pushing() &&
           TouchesAlone(q, now);
  }

  // Of two events at the same time. What ends an arc that was cut there comes before the arc's end.
  bool Precedes(int q, int other) const {
    return pairs_[q].stopping || (pairs_[other].waits && !pairs_[q].waits && !pairs_[q].held);
  }

  // How often pair q has met since there are many impacts, and its discs have met others. With friction piles come to
  // rest by themselves.
  int Crowding(int q) const {
    if (Value(in_.contact.friction) > 0) return 0;
    const Candidate& c = CandidateOf(q);
    const int own = pairs_[q].impacts;
    const auto others = [&](int i) { return Moves(i) ? discs_[i].impacts - own : 0; };
    return std::min(own, others(c.a) + (c.plane ? 0 : others(c.b)));
  }
  bool IsCrowded(int q) const { return Crowding(q) > kCrowdedImpacts; }
};

}  // namespace saltus::internal
