// The motion of all discs of a step of the event-driven model (event.h) between events: positions, gaps and relative
// velocities at any time, and the times of events with their derivatives.
//
// A predicted time s is a zero of a function g(s; x), found on values. One Newton step in T, s - (g - value(g)) / g',
// keeps the value and gives the derivative -dg/dx / g' (implicit function theorem):
//
//   impact                                g = gap                      g' = n.w
//   begin of a contact without impact     g = n.w                      g' = acceleration of the gap
//   end of sliding                        g = t.w at the contact       g' = its rate of change
//   end of an edge                        g = distance along the edge  g' = its rate of change
//   rim of a pocket                       g = distance from the rim    g' = n.v
#pragma once

#include <algorithm>
#include <cmath>
#include <memory_resource>
#include <span>
#include <string_view>
#include <type_traits>
#include <vector>

#include "contact/event/event_disc.h"

namespace saltus::internal {

template <typename T, int kRotation>
class EventMotion {
 public:
  using State = BodyState<T, kRotation>;
  using Disc = EventDisc<T, kRotation>;
  static_assert(std::is_same_v<Base<T>, double>, "the event-driven model computes in double");

  EventMotion(const StepInput<T>& in, std::span<const State> x)
      : in_(in), start_(x), discs_(in.scratch), pairs_of_(in.scratch), first_pair_of_(in.scratch) {
    discs_.reserve(x.size());
    for (int i = 0; i < static_cast<int>(x.size()); ++i) {
      discs_.push_back({T(0.0), x[i].p, x[i].v, in.Acceleration(i)});
      if constexpr (kRotation == kSpin) {
        discs_.back().turn = {x[i].rotation[0], x[i].rotation[1], in.AngularAcceleration(i)};
      }
    }
    if (num_pairs() > kFewPairs) ListPairs();
  }

  std::pmr::vector<Disc>& discs() { return discs_; }
  const std::pmr::vector<Disc>& discs() const { return discs_; }
  Disc& disc(int i) { return discs_[i]; }
  const Disc& disc(int i) const { return discs_[i]; }
  int num_discs() const { return static_cast<int>(discs_.size()); }
  int num_pairs() const { return static_cast<int>(in_.candidates.size()); }
  const Candidate& CandidateOf(int q) const { return in_.candidates[q]; }

  bool IsMovable(int i) const { return !in_.bodies[i].fixed; }
  bool IsTable(const Candidate& c) const { return c.plane && c.b == in_.table; }
  bool IsPocket(const Candidate& c) const { return in_.num_pockets > 0 && in_.IsPocket(c); }
  bool IsEdge(const Candidate& c) const { return c.plane && !in_.extents.empty() && !in_.extents[c.b].endless; }
  // Whether a disc of the pair lies in a pocket.
  bool IsPocketed(const Candidate& c) const {
    return in_.num_pockets > 0 && (discs_[c.a].out || (!c.plane && discs_[c.b].out));
  }
  // Whether the disc of a pair with a pocket is in it at the start of the step.
  bool IsInPocket(const Candidate& c) const {
    return IsPocket(c) && Separate<double>(ValueOf(start_[c.a].p), in_.planes[c.b]).distance <= kSeam;
  }
  // Whether some pair may touch within the step.
  bool MayHaveContact() const {
    return std::ranges::any_of(in_.candidates, [&](const Candidate& c) {
      return IsTable(c) || IsInPocket(c) || !StaysApart(ApproachAt(c, 0).polynomial, in_.h);
    });
  }
  bool IsDirty(int q) const {
    const Candidate& c = CandidateOf(q);
    return discs_[c.a].dirty || (!c.plane && discs_[c.b].dirty);
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
  // Calls visit(q) for the pairs that share a moving disc with c, in ascending order.
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
      if (!IsMovable(i)) return;
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
  // Returns the relative velocity at the last events of both discs. Precondition: same instant, or one disc is fixed.
  Vec2<T> LastRelativeVelocity(const Candidate& c) const {
    return RelativeVelocity<T>(c, [&](int i) -> const Vec2<T>& { return discs_[i].v; });
  }
  Separation<T> LastSeparation(const Candidate& c) const {
    return SeparationAt(in_, c, [&](int i) -> const Vec2<T>& { return discs_[i].p; });
  }
  Motion MotionAt(int i, double time) const {
    const Disc& disc = discs_[i];
    Motion motion{ValueOf(disc.p), ValueOf(disc.v), ValueOf(disc.a)};
    if (disc.curve != nullptr) {
      motion.curved = true;
      for (int k = 0; k < 3; ++k) motion.curve[k] = ValueOf((*disc.curve)[k]);
    }
    return motion.MotionAfter(time - Value(disc.t));
  }
  SALTUS_FLATTEN Approach ApproachAt(const Candidate& c, double time) const {
    return Measure(c, [&](int i) { return MotionAt(i, time); });
  }
  // Returns the magnitude of the coordinates of a pair, m, to which rounding errors are proportional.
  double SizeAt(const Candidate& c, double time) const {
    return in_.ContactDistance(c) + MotionAt(c.a, time).p.template lpNorm<1>();
  }

  // Returns how long after `now` the gap of a pair reaches zero, s, given its gap polynomial from then on. The line of
  // an edge continues beyond its ends, where a disc may cross it freely.
  double FirstClosingOf(const Candidate& c, double now, GapPolynomial g, double horizon, bool ignore_start) const {
    double after = FirstClosing(g, horizon, ignore_start);
    if (!IsEdge(c)) return after;
    for (int closing = 0; closing < kMostClosings; ++closing) {
      if (after > horizon || CountsAt(c, MotionAt(c.a, now + after).p)) return after;
      GapPolynomial rest = ShiftedTo(g, after);
      rest.c[0] = std::min(rest.c[0], 0.0);  // the gap has just reached zero
      after += FirstClosing(rest, horizon - after, /*ignore_start=*/true);
    }
    return kNever;
  }

  // Returns how long a closed pair stays on its part of an edge if its disc keeps the motion it has at `now`, s.
  double TimeOnEdge(const Candidate& c, double now) const {
    double first = kNever;
    if (!IsEdge(c)) return first;
    const Motion motion = MotionAt(c.a, now);
    for (const WallExtent::Bound& bound : in_.extents[c.b].bounds) {
      const double speed = Dot(bound.normal, motion.v), change = Dot(bound.normal, motion.a);
      GapPolynomial left{{bound.Inside(motion.p) + 2 * kSeam, speed, 0.5 * change, 0, 0}};
      if (motion.curved) {
        for (int k = 0; k < 3; ++k) left.c[3 + k] = Dot(bound.normal, motion.curve[k]);
        left.degree = 5;
      }
      const double after = FirstClosing(left, in_.h - now);
      if (after < first && !in_.extents[c.b].Covers(motion.MotionAfter(after).p, kSeam)) first = after;
    }
    return first;
  }

  // The time of the last event of a pair's discs, and the disc that had it.
  const T& LastTime(const Candidate& c) const { return LastDisc(c).t; }
  const Disc& LastDisc(const Candidate& c) const {
    return c.plane || discs_[c.a].event >= discs_[c.b].event ? discs_[c.a] : discs_[c.b];
  }

  // Returns the time of an impact. A pair that overlapped at the start of the step meets at its last event.
  SALTUS_FLATTEN T ImpactTime(const Candidate& c, double predicted) const {
    if (predicted <= Value(LastTime(c)) && OverlapsAtStart(c)) return LastTime(c);
    const T time(predicted);
    const Separation<T> at = SeparationAtTime(c, time);
    const T gap = at.distance - in_.ContactDistance(c);
    const double speed = Value(Dot(at.normal, RelativeVelocityAt(c, time)));
    return time - Divide(T(gap - Value(gap)), speed);
  }
  // The time at which a pair touches too slowly for an impact.
  T SlowTime(const Candidate& c, double predicted, const Approach& approach) const {
    const T time(predicted);
    if (predicted <= Value(LastTime(c))) return LastTime(c);
    if (approach.speed < -kSharpSpeed) return ImpactTime(c, predicted);
    if (!approach.HasClosingForce()) return time;
    // The gap has never been more than rounding: this is when it begins to close.
    const T speed = Dot(SeparationAtTime(c, time).normal, RelativeVelocityAt(c, time));
    return time - Divide(T(speed - Value(speed)), approach.acceleration);
  }
  // The speed at which the points of contact slide along the tangent.
  T SlidingAlong(const Vec2<T>& tangent, const Candidate& c, const T& time) const {
    return AlongSurface<kRotation>(in_, c, T(Dot(tangent, RelativeVelocityAt(c, time))), [&](auto i) {
      return discs_[i].turn.SpeedAfter(T(time - discs_[i].t));
    });
  }
  // Returns when sliding ends between two times, or kNever if it does not.
  double FirstStop(const Candidate& c, double begin, double end) const {
    const auto sliding = [&](double time) {
      return Value(SlidingAlong(Perpendicular(SeparationAtTime(c, T(time)).normal), c, T(time)));
    };
    const double at_begin = sliding(begin), at_end = sliding(end);
    if (at_begin * at_end > 0) return kNever;
    return FindZero(begin, at_begin, end, at_end, 0, sliding);
  }
  // The time at which sliding ends.
  T StopTime(const Candidate& c, double predicted) const {
    const T time(predicted);
    const Vec2<T> tangent = Perpendicular(SeparationAtTime(c, time).normal);
    const Vec2<T> a = RelativeVelocity<T>(c, [&](int i) { return discs_[i].AccelerationAt(time); });
    const T sliding = SlidingAlong(tangent, c, time);
    const T change = AlongSurface<kRotation>(
        in_, c, T(Dot(tangent, a)), [&](auto i) { return discs_[i].turn.AccelerationAfter(T(time - discs_[i].t)); });
    return time - Divide(T(sliding - Value(sliding)), Value(change));
  }
  // The time at which a disc reaches the rim of a pocket.
  T PocketTime(const Candidate& c, double predicted) const {
    const T time(predicted);
    const Separation<T> at = SeparationAtTime(c, time);
    const double speed = Value(Dot(at.normal, RelativeVelocityAt(c, time)));
    if (speed >= -kSharpSpeed) return time;
    return time - Divide(T(at.distance - Value(at.distance)), speed);
  }
  // The time at which a disc reaches the end of an edge.
  T LeavingTime(const Candidate& c, double predicted) const {
    const T time(predicted);
    const Vec2<T> p = discs_[c.a].PositionAt(time), v = discs_[c.a].VelocityAt(time);
    const WallExtent::Bound* passed = nullptr;
    for (const WallExtent::Bound& bound : in_.extents[c.b].bounds) {
      const double off = std::abs(bound.Inside(ValueOf(p)) + 2 * kSeam);
      if (passed == nullptr || off < std::abs(passed->Inside(ValueOf(p)) + 2 * kSeam)) passed = &bound;
    }
    const T inside = Dot(passed->normal, p);
    return time - Divide(T(inside - Value(inside)), Value(Dot(passed->normal, v)));
  }

  // Returns the reason why the motion of the step is not that of rigid discs (overlaps, or energy gained beyond the
  // work of the forces); empty if it is. `removed` is the energy that discs had when they fell into pockets, J.
  std::string_view ReasonInconsistent(double removed) const {
    double gain = removed, energy = 0;
    for (std::size_t i = 0; i < discs_.size(); ++i) {
      if (!discs_[i].moved || !IsMovable(static_cast<int>(i))) continue;
      const Motion before = MotionAtStart(static_cast<int>(i)), after = MotionAt(static_cast<int>(i), in_.h);
      const Vec2d force = Value(in_.bodies[i].mass) * ValueOf(in_.Acceleration(static_cast<int>(i)));
      const double m = 0.5 * Value(in_.bodies[i].mass);
      gain += m * (after.v.squaredNorm() - before.v.squaredNorm()) - Dot(force, Vec2d(after.p - before.p));
      energy += m * std::max(after.v.squaredNorm(), before.v.squaredNorm()) + force.norm();
      if constexpr (kRotation == kSpin) AddSpinTo(static_cast<int>(i), &gain, &energy);
    }
    // A gain is allowed where the scene asks for it, and where discs overlap at the start.
    bool may_gain = false;
    for (int q = 0; q < num_pairs(); ++q) {
      const Candidate& c = CandidateOf(q);
      const Approach end = ApproachAt(c, in_.h);
      const double gap = StartGap(c);
      may_gain = may_gain || gap < -kContactGap || Value(in_.ContactOf(c).restitution) > 1;
      // Impacts within the last kNodeMargin are left to the next step.
      const double allowed = kLargestOverlap + 2 * kNodeMargin * in_.h * std::abs(end.speed);
      if (end.gap < std::min(gap, 0.0) - allowed) return "discs would overlap: contacts of this step are not resolved";
    }
    const bool gains = !may_gain && gain > kLargestGain * energy;
    return gains ? "sustained contacts would gain energy: they are not resolved" : std::string_view();
  }

 private:
  // With at most this many pairs it is cheaper to visit all than to keep lists.
  static constexpr int kFewPairs = 16;

  // Whether two pairs have a disc that moves in common.
  bool ShareDisc(const Candidate& c, const Candidate& d) const {
    const auto has = [&](int i) { return IsMovable(i) && (d.a == i || (!d.plane && d.b == i)); };
    return has(c.a) || (!c.plane && has(c.b));
  }
  // Measures the approach of a pair. The gap is infinite where the part of an edge does not count, for pockets, which
  // nothing touches, and for discs that lie in one. The polynomial is always that of the whole line or circle.
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
    if (IsPocket(c) || IsPocketed(c)) approach.gap = kNever;
    return approach;
  }
  // Whether a part of an edge counts (walls.h) for a disc at p. Precondition: IsEdge(c).
  bool CountsAt(const Candidate& c, const Vec2d& p) const {
    return Separate<double>(p, in_.planes[c.b]).distance > 0 && in_.extents[c.b].Covers(p, kSeam);
  }

  Motion MotionAtStart(int i) const { return {ValueOf(start_[i].p), ValueOf(start_[i].v), Vec2d(0, 0)}; }
  Approach ApproachAtStart(const Candidate& c) const {
    return Measure(c, [&](int i) { return MotionAtStart(i); });
  }
  // Whether the overlap at the start exceeds what impacts in the last kNodeMargin of the step before can leave.
  bool OverlapsAtStart(const Candidate& c) const {
    const Approach start = ApproachAtStart(c);
    return start.gap < -(kContactGap + 2 * kNodeMargin * in_.h * std::abs(start.speed));
  }
  // Returns the gap at the start of the step; for an edge, the smallest gap of all edges that the disc may meet.
  double StartGap(const Candidate& c) const {
    double gap = ApproachAtStart(c).gap;
    if (!IsEdge(c)) return gap;
    for (const Candidate& d : in_.candidates) {
      if (IsEdge(d) && d.a == c.a) gap = std::min(gap, ApproachAtStart(d).gap);
    }
    return gap;
  }

  // Adds the gain of energy of a disc's spin in the step beyond the work of its torque, and the energy of the spin.
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

  const StepInput<T>& in_;
  std::span<const State> start_;
  std::pmr::vector<Disc> discs_;
  std::pmr::vector<int> pairs_of_, first_pair_of_;  // by disc, where there are many
};

}  // namespace saltus::internal
