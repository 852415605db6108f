// The discs of one step of the event-driven model (event.h) on their way: where they and pairs of them are at any time,
// and when two meet, with the derivatives of that time.
#pragma once

#include <algorithm>
#include <cmath>
#include <memory_resource>
#include <span>
#include <string_view>
#include <type_traits>
#include <vector>

#include "contact/event/event_press.h"

namespace saltus::internal {

// For how long discs that move around each other at a distance, sliding at a speed, may keep a constant acceleration,
// s: it does not follow a normal that turns with rate w and its change b, and within s the gap is off by about R w b
// s^3 / 4 + R b^2 s^4 / 16 + R w^4 s^4 / 8.
inline double LongestArc(double distance, double speed, double acceleration) {
  const double drift = kLargestDrift / distance;
  const double turn = std::abs(speed) / distance, change = std::abs(acceleration) / distance;
  double longest = kNever;
  if (turn * change > 0) longest = std::min(longest, std::cbrt(4 * drift / (turn * change)));
  if (change > 0) longest = std::min(longest, std::sqrt(4 * std::sqrt(drift) / change));
  if (turn > 0) longest = std::min(longest, std::sqrt(std::sqrt(8 * drift)) / turn);
  return longest;
}

template <typename T, int kRotation>
class EventMotion {
 public:
  using State = BodyState<T, kRotation>;
  using Disc = EventDisc<T, kRotation>;
  static_assert(std::is_same_v<Base<T>, double>, "the event-driven model computes in double");

 protected:
  struct Pair {
    double next = kNever;  // s, its next event
    int passed = -1;       // number of the event since which it is ignored while it touches
    int released = -1;     // number of the event that last ended held
    int impacts = 0;
    int meetings = 0;        // impacts in this step
    bool waits = false;      // touches slowly, and impacts at the same time come first
    bool held = false;       // closed, and kept closed by the accelerations of its discs
    bool curved = false;     // its discs move around each other while held, or did
    bool rolls = false;      // they roll around each other
    bool stopping = false;   // held, and its next event is that sliding ends
    bool leaving = false;    // held, and its next event is that the disc has slid off the edge
    int reported_mode = -1;  // of the last report as a sustained contact
    double tied = -kNever;   // s, when it was last looked at as a part of a tie
  };

  EventMotion(const StepInput<T>& in, std::span<const State> x)
      : in_(in),
        start_(x),
        discs_(in.scratch),
        pairs_(in.candidates.size(), in.scratch),
        pairs_of_(in.scratch),
        first_pair_of_(in.scratch) {
    discs_.reserve(x.size());
    for (int i = 0; i < static_cast<int>(x.size()); ++i) {
      discs_.push_back({T(0.0), x[i].p, x[i].v, in.Acceleration(i)});
      if constexpr (kRotation == kSpin) {
        discs_.back().turn = {x[i].rotation[0], x[i].rotation[1], in.AngularAcceleration(i)};
      }
    }
    if (num_pairs() > kFewPairs) ListPairs();
  }

  bool Moves(int i) const { return !in_.bodies[i].fixed; }
  const Candidate& CandidateOf(int q) const { return in_.candidates[q]; }
  bool IsTable(const Candidate& c) const { return c.plane && c.b == in_.table; }
  bool IsPocket(const Candidate& c) const { return in_.num_pockets > 0 && in_.IsPocket(c); }
  // Whether a disc of the pair is out of play.
  bool IsOut(const Candidate& c) const {
    return in_.num_pockets > 0 && (discs_[c.a].out || (!c.plane && discs_[c.b].out));
  }
  // Whether the disc of a pair with a pocket is in it at the start of the step: it has come to the rim, or was taken.
  bool LiesIn(const Candidate& c) const {
    return IsPocket(c) && Separate<double>(ValueOf(start_[c.a].p, start_[c.a].v).p, in_.planes[c.b]).distance <= kSeam;
  }
  int num_pairs() const { return static_cast<int>(pairs_.size()); }
  bool IsDirty(int q) const {
    const Candidate& c = CandidateOf(q);
    return discs_[c.a].dirty || (!c.plane && discs_[c.b].dirty);
  }
  // Whether two pairs have a disc that moves in common.
  bool ShareDisc(const Candidate& c, const Candidate& d) const {
    const auto has = [&](int i) { return Moves(i) && (d.a == i || (!d.plane && d.b == i)); };
    return has(c.a) || (!c.plane && has(c.b));
  }
  // Calls visit(q) for the pairs of disc i, in ascending order.
  template <typename Visit>
  void ForEachPairOf(int i, const Visit& visit) const {
    if (num_pairs() <= kFewPairs) {
      for (int q = 0; q < num_pairs(); ++q) {
        const Candidate& c = CandidateOf(q);
        if (c.a == i || (!c.plane && c.b == i)) visit(q);
      }
      return;
    }
    for (int k = first_pair_of_[i]; k < first_pair_of_[i + 1]; ++k) visit(pairs_of_[k]);
  }
  // Likewise for those that share a disc that moves with c.
  template <typename Visit>
  void ForEachPairBeside(const Candidate& c, const Visit& visit) const {
    if (num_pairs() <= kFewPairs) {
      for (int q = 0; q < num_pairs(); ++q) {
        if (ShareDisc(c, CandidateOf(q))) visit(q);
      }
      return;
    }
    int at[2] = {0, 0}, end[2] = {0, 0};
    const auto list = [&](int side, int i) {
      if (!Moves(i)) return;
      at[side] = first_pair_of_[i];
      end[side] = first_pair_of_[i + 1];
    };
    list(0, c.a);
    if (!c.plane) list(1, c.b);
    while (at[0] < end[0] || at[1] < end[1]) {
      const int a = at[0] < end[0] ? pairs_of_[at[0]] : num_pairs(),
                b = at[1] < end[1] ? pairs_of_[at[1]] : num_pairs();
      at[0] += a <= b;
      at[1] += b <= a;
      visit(std::min(a, b));
    }
  }
  // Whether the discs of pair q touch nothing else.
  bool TouchesAlone(int q, double time) const {
    const Candidate& c = CandidateOf(q);
    bool alone = true;
    ForEachPairBeside(c, [&](int other) {
      alone = alone && (other == q || !(ApproachAt(CandidateOf(other), time).gap <= kContactGap));
    });
    return alone;
  }

  Vec2<T> RelativeVelocityAt(const Candidate& c, const T& time) const {
    return RelativeVelocity<T>(c, [&](int i) { return discs_[i].VelocityAt(time); });
  }
  Separation<T> SeparationAtTime(const Candidate& c, const T& time) const {
    return SeparationAt(in_, c, [&](int i) { return discs_[i].PositionAt(time); });
  }
  // The same at the last events of both discs. Precondition: that is the same instant, or a disc is fixed.
  Vec2<T> LastRelativeVelocity(const Candidate& c) const {
    return RelativeVelocity<T>(c, [&](int i) -> const Vec2<T>& { return discs_[i].v; });
  }
  Separation<T> LastSeparation(const Candidate& c) const {
    return SeparationAt(in_, c, [&](int i) -> const Vec2<T>& { return discs_[i].p; });
  }
  static Motion ValueOf(const Vec2<T>& p, const Vec2<T>& v, const Vec2<T>& a = Vec2<T>(T(0.0), T(0.0))) {
    const auto value = [](const Vec2<T>& x) { return Vec2d(Value(x[0]), Value(x[1])); };
    return {value(p), value(v), value(a)};
  }
  Motion MotionAt(int i, double time) const {
    const Disc& disc = discs_[i];
    return ValueOf(disc.p, disc.v, disc.a).After(time - Value(disc.t));
  }
  // The gap is infinite where a part of an edge does not count, of a pocket, which nothing touches, and of what is out
  // of play; its polynomial still is the part's.
  template <typename MotionOf>
  Approach Measure(const Candidate& c, const MotionOf& motion) const {
    Approach approach;
    if (!c.plane) {
      approach = MeasureApproach(motion(c.a), motion(c.b), in_.ContactDistance(c));
    } else {
      const Motion a = motion(c.a);
      approach = MeasureApproach(a, in_.planes[c.b], in_.ContactDistance(c));
      if (IsEdge(c) && !CountsAt(c, a.p)) approach.gap = kNever;
    }
    if (IsPocket(c) || IsOut(c)) approach.gap = kNever;
    return approach;
  }
  bool IsEdge(const Candidate& c) const { return c.plane && !in_.extents.empty() && !in_.extents[c.b].endless; }
  // Whether a part of an edge counts (walls.h) for a disc at p. Precondition: IsEdge(c).
  bool CountsAt(const Candidate& c, const Vec2d& p) const {
    return Separate<double>(p, in_.planes[c.b]).distance > 0 && in_.extents[c.b].Covers(p, kSeam);
  }

  // How long after `now` a pair closes, given its approach then, s. The line of an edge goes on beyond its ends, where
  // a disc crosses it freely.
  double FirstClosingOf(const Candidate& c, double now, GapPolynomial g, double horizon, bool ignore_start) const {
    double after = FirstClosing(g, horizon, ignore_start);
    if (!IsEdge(c)) return after;
    constexpr int kMostClosings = 4;  // of a quartic, where it has a maximum below zero included
    for (int closing = 0; closing < kMostClosings; ++closing) {
      if (after > horizon || CountsAt(c, MotionAt(c.a, now + after).p)) return after;
      GapPolynomial rest = ShiftedTo(g, after);
      rest.c[0] = std::min(rest.c[0], 0.0);  // it has just closed
      after += FirstClosing(rest, horizon - after, /*ignore_start=*/true);
    }
    return kNever;
  }

  // How long a held pair stays on its part of an edge, while its disc moves as it does from `now` on, s.
  double TimeOnEdge(const Candidate& c, double now) const {
    double first = kNever;
    if (!IsEdge(c)) return first;
    const Motion motion = MotionAt(c.a, now);
    for (const WallExtent::Bound& bound : in_.extents[c.b].bounds) {
      const double speed = Dot(bound.normal, motion.v), change = Dot(bound.normal, motion.a);
      const GapPolynomial left{{bound.Inside(motion.p) + 2 * kSeam, speed, 0.5 * change, 0, 0}};
      const double after = FirstClosing(left, in_.h - now);
      if (after < first && !in_.extents[c.b].Covers(motion.After(after).p, kSeam)) first = after;
    }
    return first;
  }
  Approach ApproachAt(const Candidate& c, double time) const {
    return Measure(c, [&](int i) { return MotionAt(i, time); });
  }

  // The time and the number of the last event of a pair's discs.
  const T& LastTime(const Candidate& c) const { return LastDisc(c).t; }
  const Disc& LastDisc(const Candidate& c) const {
    return c.plane || discs_[c.a].order >= discs_[c.b].order ? discs_[c.a] : discs_[c.b];
  }

  double TimeInStep(const T& time) const { return std::clamp(Value(time), 0.0, in_.h); }
  void Report(const Candidate& c, ContactMode mode, const T& time, ContactKind kind) {
    in_.Report(c, mode, TimeInStep(time), kind);
    discs_[c.a].reported = true;
    if (!c.plane) discs_[c.b].reported = true;
  }

  // The predicted time with the derivatives of one Newton step in T, which are those of the impact time. A pair that
  // overlapped at the start of the step has no impact time of its own where it closes; it meets at its last event.
  SALTUS_FLATTEN T ImpactTime(const Candidate& c, double predicted) const {
    if (predicted <= Value(LastTime(c)) && OverlapsAtStart(c)) return LastTime(c);
    const T time(predicted);
    const Separation<T> at = SeparationAtTime(c, time);
    const T gap = at.distance - in_.ContactDistance(c);
    const double speed = Value(Dot(at.normal, RelativeVelocityAt(c, time)));
    return time - Divide(T(gap - Value(gap)), speed);
  }
  // Beyond what the impacts in the last kNodeMargin of the step before leave, of which there may be several.
  bool OverlapsAtStart(const Candidate& c) const {
    const Approach start = ApproachAtStart(c);
    return start.gap < -(kContactGap + 2 * kNodeMargin * in_.h * std::abs(start.speed));
  }
  // Likewise when they touch slowly.
  T SlowTime(const Candidate& c, double predicted, const Approach& approach) const {
    const T time(predicted);
    if (predicted <= Value(LastTime(c))) return LastTime(c);
    if (approach.speed < -kSharpSpeed) return ImpactTime(c, predicted);
    if (!approach.Pushing()) return time;
    // They never parted by more than rounding: this is when they begin to close.
    const T speed = Dot(SeparationAtTime(c, time).normal, RelativeVelocityAt(c, time));
    return time - Divide(T(speed - Value(speed)), approach.acceleration);
  }
  // Likewise for the time at which sliding ends.
  T StopTime(const Candidate& c, double predicted) const {
    const T time(predicted);
    const Vec2<T> tangent = Perpendicular(SeparationAtTime(c, time).normal);
    const Vec2<T> a = RelativeVelocity<T>(c, [&](int i) { return discs_[i].a; });
    const T sliding = AlongSurface<kRotation>(in_, c, T(Dot(tangent, RelativeVelocityAt(c, time))), [&](auto i) {
      return discs_[i].turn.SpeedAfter(T(time - discs_[i].t));
    });
    const T change =
        AlongSurface<kRotation>(in_, c, T(Dot(tangent, a)), [&](auto i) { return discs_[i].turn.acceleration; });
    return time - Divide(T(sliding - Value(sliding)), Value(change));
  }

  // Likewise for the time at which a disc comes to a pocket.
  T PocketTime(const Candidate& c, double predicted) const {
    const T time(predicted);
    const Separation<T> at = SeparationAtTime(c, time);
    const double speed = Value(Dot(at.normal, RelativeVelocityAt(c, time)));
    if (speed >= -kSharpSpeed) return time;
    return time - Divide(T(at.distance - Value(at.distance)), speed);
  }

  // Likewise for the time at which a disc has slid off an edge.
  T LeavingTime(const Candidate& c, double predicted) const {
    const T time(predicted);
    const Vec2<T> p = discs_[c.a].PositionAt(time), v = discs_[c.a].VelocityAt(time);
    const WallExtent::Bound* passed = nullptr;
    for (const WallExtent::Bound& bound : in_.extents[c.b].bounds) {
      const double off = std::abs(bound.Inside(ValueOf(p, v).p) + 2 * kSeam);
      if (passed == nullptr || off < std::abs(passed->Inside(ValueOf(p, v).p) + 2 * kSeam)) passed = &bound;
    }
    const T inside = Dot(passed->normal, p);
    return time - Divide(T(inside - Value(inside)), Value(Dot(passed->normal, v)));
  }

  // On a table disc i slows against its velocity as it is now, or rests.
  void Slide(int i) {
    if (in_.table < 0 || !Moves(i) || discs_[i].out) return;
    Disc& disc = discs_[i];
    const T speed = Length(disc.v);
    const bool slides = Value(speed) > 0;
    // A small velocity would stop after a way that is smaller still.
    if (!slides) disc.v = Vec2<T>(T(0.0), T(0.0));
    disc.a = slides ? Scale(-in_.slowing, Quotient(disc.v, speed)) : Vec2<T>(T(0.0), T(0.0));
    disc.moved = true;
    ReportOnTable(i, slides ? ContactMode::kSlip : ContactMode::kStick);
  }
  void SlideOn(const Candidate& c) {
    Slide(c.a);
    if (!c.plane) Slide(c.b);
  }
  void ReportOnTable(int i, ContactMode mode) {
    for (int q = 0; q < num_pairs(); ++q) {
      const Candidate& c = CandidateOf(q);
      if (c.a != i || !IsTable(c) || pairs_[q].reported_mode == static_cast<int>(mode)) continue;
      pairs_[q].reported_mode = static_cast<int>(mode);
      Report(c, mode, discs_[i].t, ContactKind::kSustained);
    }
  }

  // Takes away the speed at which a touching pair closes. Precondition: its discs are at the same instant.
  void StopClosing(const Candidate& c) {
    const Vec2<T> normal = LastSeparation(c).normal;
    const Vec2<T> impulse = Scale(T(-in_.EffectiveMass(c) * Dot(normal, LastRelativeVelocity(c))), normal);
    ApplyImpulse(in_, c, impulse, [&](int i, const Vec2<T>& dv) { discs_[i].v += dv; });
  }

  // The gap at the start of the step; along edges the least of all that the disc meets, whichever it was nearest to.
  double StartGap(const Candidate& c) const {
    double gap = ApproachAtStart(c).gap;
    if (!IsEdge(c)) return gap;
    for (const Candidate& d : in_.candidates) {
      if (IsEdge(d) && d.a == c.a) gap = std::min(gap, ApproachAtStart(d).gap);
    }
    return gap;
  }
  Approach ApproachAtStart(const Candidate& c) const {
    return Measure(c, [&](int i) { return ValueOf(start_[i].p, start_[i].v); });
  }

  // What no motion of rigid discs does, and this one has done by the end of the step; empty if nothing. Contacts that
  // last are followed to thresholds, and now and then in a crowd these are not enough.
  std::string_view WhatIsWrong() const {
    double gain = pocketed_energy_, energy = 0;
    for (std::size_t i = 0; i < discs_.size(); ++i) {
      if (!discs_[i].moved || !Moves(static_cast<int>(i))) continue;
      const Motion before = ValueOf(start_[i].p, start_[i].v), after = MotionAt(static_cast<int>(i), in_.h);
      const Vec2<T> a = in_.Acceleration(static_cast<int>(i));
      const Vec2d force = Value(in_.bodies[i].mass) * Vec2d(Value(a[0]), Value(a[1]));
      const double m = 0.5 * Value(in_.bodies[i].mass);
      gain += m * (after.v.squaredNorm() - before.v.squaredNorm()) - Dot(force, Vec2d(after.p - before.p));
      energy += m * std::max(after.v.squaredNorm(), before.v.squaredNorm()) + force.norm();
      if constexpr (kRotation == kSpin) AddSpinTo(static_cast<int>(i), &gain, &energy);
    }
    // Unless it is asked for, or forces have worked before the start.
    bool may_gain = Value(in_.contact.restitution) > 1;
    for (int q = 0; q < num_pairs(); ++q) {
      const Candidate& c = CandidateOf(q);
      const Approach end = ApproachAt(c, in_.h);
      const double gap = StartGap(c);
      may_gain = may_gain || gap < -kContactGap;
      // What meets within the last kNodeMargin is left to the next step.
      const double allowed = kLargestOverlap + 2 * kNodeMargin * in_.h * std::abs(end.speed);
      if (end.gap < std::min(gap, 0.0) - allowed) return "discs would overlap, what happens here is not resolved";
    }
    const bool gains = !may_gain && gain > kLargestGain * energy;
    return gains ? "contacts that last would gain energy, what happens here is not resolved" : std::string_view();
  }

  const StepInput<T>& in_;
  std::span<const State> start_;
  std::pmr::vector<Disc> discs_;
  std::pmr::vector<Pair> pairs_;
  double pocketed_energy_ = 0;  // J, that discs had as they fell into pockets

 private:
  // Lists of so few would cost more than looking at them all.
  static constexpr int kFewPairs = 16;

  // What the spin of a disc has gained in the step beyond the work of its torque, and how much there is of it.
  void AddSpinTo(int i, double* gain, double* energy) const {
    const double inverse_inertia = Value(in_.bodies[i].inverse_inertia);
    if (inverse_inertia == 0) return;
    const T s = in_.h - discs_[i].t;
    const double before = Value(start_[i].rotation[1]), after = Value(discs_[i].turn.SpeedAfter(s));
    const double turned = Value(discs_[i].turn.AngleAfter(s)) - Value(start_[i].rotation[0]);
    const double torque = in_.torque.empty() ? 0.0 : Value(in_.torque[i]);
    *gain += 0.5 * (after * after - before * before) / inverse_inertia - torque * turned;
    *energy += 0.5 * std::max(after * after, before * before) / inverse_inertia + std::abs(torque);
  }

  void ListPairs() {
    first_pair_of_.assign(discs_.size() + 1, 0);
    const auto for_each_side = [&](const auto& visit) {
      for (int q = 0; q < num_pairs(); ++q) {
        const Candidate& c = CandidateOf(q);
        visit(c.a, q);
        if (!c.plane) visit(c.b, q);
      }
    };
    for_each_side([&](int i, int) { ++first_pair_of_[i + 1]; });
    for (std::size_t i = 0; i < discs_.size(); ++i) first_pair_of_[i + 1] += first_pair_of_[i];
    pairs_of_.resize(first_pair_of_.back());
    std::pmr::vector<int> next(first_pair_of_.begin(), first_pair_of_.end(), in_.scratch);
    for_each_side([&](int i, int q) { pairs_of_[next[i]++] = q; });
  }

  std::pmr::vector<int> pairs_of_, first_pair_of_;  // by disc, where there are many
};

}  // namespace saltus::internal
