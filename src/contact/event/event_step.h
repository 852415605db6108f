// One step of the event-driven model (event.h), as an object: the discs and pairs of the step and their next events.
//
// Every disc carries the time since which its acceleration is constant, and is moved on only when something happens to
// it; discs that never meet therefore do not influence each other's bits. All decisions are taken on values.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <memory_resource>
#include <type_traits>
#include <vector>

#include "contact/event/event_changes.h"
#include "contact/event/event_press.h"
#include "contact/event/event_ties.h"

namespace saltus::internal {

// `Law` says which restitution and friction an impact has; contacts that last have those of `in`.
template <typename T, int kRotation, typename Law>
class EventStep : private EventChanges<T, kRotation, Law> {
 public:
  using typename EventChanges<T, kRotation, Law>::State;
  using typename EventChanges<T, kRotation, Law>::Disc;

  EventStep(const StepInput<T>& in, const Law& law, std::span<const State> x)
      : Discs(in, law, x), tied_(in.scratch), trial_(in.scratch), group_(in) {
    group_.SetDiscs(discs_);
    group_.SetInCrowd(MayCrowd());
  }

  // True if some pair may touch within the step.
  bool AnythingMayHappen() const {
    for (const Candidate& c : in_.candidates) {
      if (IsTable(c) || LiesIn(c)) return true;
      if (!StaysApart(ApproachAt(c, 0).polynomial, in_.h)) return true;
    }
    return false;
  }

  // Whether the step is to be taken at once instead (event_crowd.h). Nothing is reported of it then.
  using EventChanges<T, kRotation, Law>::kMayCrowd;
  bool Crowded() const {
    if (!this->crowded_) return false;
    if (in_.touches != nullptr) in_.touches->clear();
    if (in_.ties != nullptr) in_.ties->clear();
    if (in_.solved != nullptr) in_.solved->Clear();
    return true;
  }

  // GCC 12 cannot flatten it as a whole.
  [[gnu::noinline]] void Run() {
    for (int q = 0; in_.num_pockets > 0 && q < num_pairs(); ++q) {
      const Candidate& c = CandidateOf(q);
      if (LiesIn(c) && !IsOut(c)) TakeOut(q, PocketTime(c, 0));
    }
    for (int i = 0; in_.table >= 0 && i < static_cast<int>(discs_.size()); ++i) Slide(i);
    for (int q = 0; q < num_pairs(); ++q) Predict(q);
    for (int count = 0; count < 2 * kMaxEvents; ++count) {
      inelastic_ = count >= kMaxEvents;
      int q = NextPair();
      if (q < 0) return Finish();
      q = FirstAtOnce(q);
      if (!CutArc(q)) {
        ++order_;
        Resolve(q);
      }
      if (failed_) return;
      for (int other = 0; other < num_pairs(); ++other) {
        if (IsDirty(other)) Predict(other);
      }
      for (Disc& disc : discs_) disc.dirty = false;
    }
    Fail("there is no end of events");
  }

  // Whether an event changed disc i, and if so its state at the end of the step; not a number where there were too many
  // events, or forces were not found. One that was looked at only, beside others, flies as if there had been nothing.
  bool Moved(int i) const { return discs_[i].moved && (discs_[i].reported || failed_); }
  State End(int i) const {
    const T end(failed_ ? std::numeric_limits<double>::quiet_NaN() : in_.h);
    const Vec2<T> p = discs_[i].PositionAt(end), v = discs_[i].VelocityAt(end);
    if constexpr (kRotation == kSpin) {
      const T s = end - discs_[i].t;
      return {p, v, {discs_[i].turn.AngleAfter(s), discs_[i].turn.SpeedAfter(s)}};
    } else {
      return {p, v};
    }
  }

 private:
  using Group = PressedGroup<T, kRotation>;
  using Discs = EventChanges<T, kRotation, Law>;
  using Discs::in_, Discs::discs_, Discs::pairs_, Discs::num_pairs, Discs::IsDirty, Discs::ForEachPairOf,
      Discs::ForEachPairBeside, Discs::TouchesAlone, Discs::Moves, Discs::CandidateOf, Discs::LastRelativeVelocity,
      Discs::LastSeparation, Discs::MotionAt, Discs::ApproachAt, Discs::LastTime, Discs::LastDisc, Discs::TimeInStep,
      Discs::Report, Discs::ImpactTime, Discs::SlowTime, Discs::StopClosing, Discs::FirstClosingOf, Discs::TimeOnEdge,
      Discs::IsTable, Discs::IsPocket, Discs::IsOut, Discs::LiesIn, Discs::PocketTime, Discs::TakeOut, Discs::Slide,
      Discs::SlideOn, Discs::NextPair, Discs::LeftAfter, Discs::Predict, Discs::EventTime, Discs::SlowSpeed,
      Discs::impacts_, Discs::Fail, Discs::MoveTo, Discs::Release, Discs::Stop, Discs::Impact, Discs::order_,
      Discs::inelastic_, Discs::failed_, Discs::MayCrowd;
  using typename Discs::Pair;

  // What there was before an order of tied impacts was tried, and what the first of the orders led to.
  struct TieTrial {
    explicit TieTrial(std::pmr::memory_resource* scratch)
        : tied(scratch), discs(scratch), outcome(scratch), pairs(scratch) {}
    std::pmr::vector<int> tied;
    std::pmr::vector<Disc> discs, outcome;
    std::pmr::vector<Pair> pairs;
  };

  void Resolve(int q) {
    const Candidate& c = CandidateOf(q);
    const double time = pairs_[q].next;
    if (IsTable(c)) return Stop(c.a);
    if (IsPocket(c)) return TakeOut(q, EventTime(q));
    if (pairs_[q].held && pairs_[q].leaving) return Release(c.a, EventTime(q));
    if (pairs_[q].held) return Settle(q, EventTime(q));
    const Approach approach = ApproachAt(c, time);
    if (approach.speed < -SlowSpeed(q, time)) {
      const bool pressed = approach.Pushing() && TouchesAlone(q, time);
      if (num_pairs() < 2 || !ResolveTie(q, time)) Impact(q, ImpactTime(c, time), pressed);
      return;
    }
    const T slow_time = SlowTime(c, time, approach);
    // Within a pile all at once: what stops one pair makes the next close, with no end.
    if (approach.Pushing() || (!approach.Grazing() && !TouchesAlone(q, time))) {
      Settle(q, slow_time);
      return;
    }
    Report(c, ContactMode::kFrictionless, slow_time, ContactKind::kGrazing);
    if (approach.Grazing()) {
      // Nothing changes for the two, so nothing else is to be considered again.
      pairs_[q].passed = LastDisc(c).order;
      pairs_[q].next = time + FirstClosingOf(c, time, approach.polynomial, LeftAfter(time), true);
      return;
    }
    Release(c.a, slow_time);
    if (!c.plane) Release(c.b, slow_time);
    StopClosing(c);
    SlideOn(c);
    pairs_[q].passed = order_;
  }

  // The accelerations of discs that move around each other, unless they slide with friction, are right at the end of
  // their arc only. Where pair q meets, or stops, before that, begins the arc again, to end there. True if so: that
  // moves the event a little.
  bool CutArc(int q) {
    const Candidate& c = CandidateOf(q);
    const double end = pairs_[q].next;
    // Closer than rounding tells it would be met later again, and again.
    if (!pairs_[q].held && std::abs(ApproachAt(c, Value(LastTime(c))).gap) <= kRoundingGap) return false;
    for (int i : {c.a, c.b}) {
      if ((i == c.b && c.plane) || !Moves(i)) continue;
      const Disc& disc = discs_[i];
      const double start = Value(disc.t), arc = disc.arc_end - start;
      if (arc == kNever || disc.arc_end - end <= kArcEnd * arc || end - start <= kNodeMargin * in_.h) continue;
      for (int held = 0; held < num_pairs(); ++held) {
        const Candidate& d = CandidateOf(held);
        if (!pairs_[held].held || (d.a != i && (d.plane || d.b != i))) continue;
        if (!EndsExactly() && !pairs_[held].rolls) continue;
        const int order = order_;
        order_ = disc.order;
        Settle(held, T(disc.t), EventTime(q));
        order_ = order;
        return true;
      }
    }
    return false;
  }

  // Of the impacts at the time of pair q's event that are connected with it through discs that move, the first
  // candidate's. Rounding finds one of them earlier, and what else happens at that time in between: the derivatives
  // would be those of an order that depends on where steps begin, and that may be no order of any disturbed motion.
  int FirstAtOnce(int q) {
    const double time = pairs_[q].next;
    if (!MayPrecede(q, time)) return q;
    tied_.assign(1, q);
    for (std::size_t k = 0; k < tied_.size(); ++k) {
      ForEachPairBeside(CandidateOf(tied_[k]), [&](int r) {
        if (std::find(tied_.begin(), tied_.end(), r) == tied_.end() && MayPrecede(r, time)) tied_.push_back(r);
      });
    }
    const int first = *std::min_element(tied_.begin(), tied_.end());
    pairs_[first].next = time;
    return first;
  }
  // Whether the next event of pair r is an impact, or that its disc comes to a pocket, at `time` but for rounding.
  bool MayPrecede(int r, double time) const {
    const Candidate& c = CandidateOf(r);
    const double wait = pairs_[r].next - time;
    if (pairs_[r].held || IsTable(c) || !(wait <= kTieTime * in_.h)) return false;
    const double size = in_.ContactDistance(c) + MotionAt(c.a, time).p.template lpNorm<1>();
    const double speed = ApproachAt(c, time).speed;
    return speed < -SlowSpeed(r, time) && -speed * wait <= kRoundingGap * (1 + size) && Value(LastTime(c)) <= time;
  }

  // Looks for other contacts that meet at the time of pair q's impact, and tells if their order matters. True if the
  // impacts have been taken, in the order that was asked for.
  bool ResolveTie(int q, double time) {
    if (in_.ties == nullptr && in_.tie_order == 0) return false;
    if (time - pairs_[q].tied <= kTieTime * in_.h) return false;
    FindTied(q, time);
    if (tied_.size() < 2) return false;
    for (int r : tied_) pairs_[r].tied = time;
    if constexpr (std::is_same_v<T, double>) {
      if (in_.ties != nullptr && OrderMatters(time)) ReportTie(time);
    }
    if (in_.tie_order == 0) return false;
    ArrangeTie(in_.tie_order, tied_);
    TakeTied(time);
    return true;
  }

  // Pair q and all that meet at `time` and are connected with it through discs that move, in the order of the pairs.
  void FindTied(int q, double time) {
    tied_.assign(1, q);
    for (std::size_t k = 0; k < tied_.size(); ++k) {
      const Candidate c = CandidateOf(tied_[k]);
      ForEachPairBeside(c, [&](int r) {
        const Candidate& d = CandidateOf(r);
        if (std::find(tied_.begin(), tied_.end(), r) != tied_.end()) return;
        const double distance = in_.ContactDistance(d), size = distance + MotionAt(d.a, time).p.template lpNorm<1>();
        if (MeetsNow(ApproachAt(d, time), distance, size, in_.h)) tied_.push_back(r);
      });
    }
    std::sort(tied_.begin(), tied_.end());
  }

  // The impacts among tied_, which lists them in order of preference. True if there was ever a choice.
  bool TakeTied(double time) {
    const bool inelastic = inelastic_;
    bool choice = false;
    for (int count = 0; count < 2 * kMostTiedImpacts; ++count) {
      int next = -1;
      for (int r : tied_) {
        if (ApproachAt(CandidateOf(r), time).speed >= -kSlowSpeed) continue;
        choice = choice || next >= 0;
        if (next < 0) next = r;
        if (choice) break;
      }
      if (next < 0) break;
      inelastic_ = inelastic || count >= kMostTiedImpacts;
      ++order_;
      Impact(next, ImpactTime(CandidateOf(next), time), /*pressed=*/false);
    }
    inelastic_ = inelastic;
    return choice;
  }

  // Tries the orders, and takes everything back.
  bool OrderMatters(double time) {
    double fastest = 0;
    for (int r : tied_) fastest = std::max(fastest, -ApproachAt(CandidateOf(r), time).speed);
    if (fastest <= kTieSlowSpeed) return false;
    const double same = kTieSpeed * fastest + kTieSlowSpeed;
    trial_.tied = tied_;
    trial_.discs = discs_;
    trial_.pairs = pairs_;
    const int order = order_, impacts = impacts_;
    const std::size_t touches = in_.touches != nullptr ? in_.touches->size() : 0;
    bool matters = false, choice = true;
    for (int k = 1; k <= NumTieOrders(static_cast<int>(tied_.size())) && choice && !matters; ++k) {
      tied_ = trial_.tied;
      ArrangeTie(k, tied_);
      choice = TakeTied(time) || k > 1;
      if (k == 1) trial_.outcome = discs_;
      for (std::size_t i = 0; i < discs_.size(); ++i) {
        matters = matters || Difference(static_cast<int>(i), time) > same;
      }
      discs_ = trial_.discs;
      pairs_ = trial_.pairs;
      order_ = order;
      impacts_ = impacts;
      if (in_.touches != nullptr) in_.touches->resize(touches);
    }
    tied_ = trial_.tied;
    return matters;
  }

  // Between the velocities of disc i as the first of the orders left it and as it is, its rim's by its spin included.
  double Difference(int i, double time) const {
    const Disc &first = trial_.outcome[i], &now = discs_[i];
    double difference = (first.VelocityAt(time) - now.VelocityAt(time)).norm();
    if constexpr (kRotation == kSpin && std::is_same_v<T, double>) {
      const double turning = first.turn.SpeedAfter(time - first.t) - now.turn.SpeedAfter(time - now.t);
      difference += in_.bodies[i].radius * std::abs(turning);
    }
    return difference;
  }

  void ReportTie(double time) const {
    const int tie = in_.ties->empty() ? 0 : in_.ties->back().tie + 1;
    for (int r : tied_) in_.ties->push_back({CandidateOf(r), TimeInStep(T(time)), tie});
  }

  // Finds what closes among all pairs that touch and are connected with pair q through discs, from `time` on. Discs
  // that move around each other do so in arcs, the first until `arc_end` at most.
  void Settle(int q, const T& time, const T& arc_end = T(kNever)) {
    if (in_.table >= 0) return Fail("discs press against each other while they slide on a table");
    group_.Clear();
    Join(q, time);
    while (Grow(time)) continue;
    if (MayCrowd() && group_.contacts().size() >= kCrowd && ++settled_ > kMostSettled) return Fail("a crowd");
    if (!group_.SolveForces() || !group_.Close()) return Fail("the forces of contacts at rest are not found");
    group_.SetAccelerations(T(0.0));
    T arc = Arc(time, arc_end);
    // The second time with the end that the first has found. With friction the arc is cut once, where a mode ends;
    // where forces that are not unique stay at the end of one, not again and again.
    const int passes = EndsExactly() || group_.RollsAround() ? 2 : 1;
    bool cut = EndsExactly() || cuts_ >= kMostCuts;
    for (int pass = 0; pass < passes && Value(arc) > 0; ++pass) {
      group_.SetAccelerations(arc);
      const bool meets = MeetsOnArc(Value(time), Value(arc));
      if (meets) arc *= 0.5;
      const double share = meets || cut || pass + 1 < passes ? 1.0 : group_.ShareInMode();
      const bool ends = share < 1;
      if (ends) arc *= share;
      cut = cut || ends;
      if (meets || ends || (pass == 1 && group_.OpenPulling())) pass = -1;
    }
    cuts_ = cut && cuts_ < kMostCuts ? cuts_ + 1 : 0;
    for (const auto& contact : group_.contacts()) Hold(contact, time, Value(arc));
  }

  void Join(int q, const T& time) {
    const Candidate& c = CandidateOf(q);
    if (!group_.HasDisc(c.a)) Release(c.a, time);
    if (!c.plane && !group_.HasDisc(c.b)) Release(c.b, time);
    group_.Add(q, pairs_[q].curved, pairs_[q].rolls && pairs_[q].released == order_);
  }

  // Adds the pairs that touch a disc of the group. True if there are any.
  bool Grow(const T& time) {
    bool grows = false;
    for (int q = 0; q < num_pairs(); ++q) {
      const Candidate& c = CandidateOf(q);
      if (group_.Contains(q) || (!group_.HasDisc(c.a) && (c.plane || !group_.HasDisc(c.b)))) continue;
      if (Value(LastTime(c)) > Value(time)) continue;  // it has come later, where an arc begins again
      const bool drifted = pairs_[q].curved && pairs_[q].released == order_;
      if (!drifted && !ApproachAt(c, Value(time)).Touching(SlowSpeed(q, Value(time)))) continue;
      Join(q, time);
      grows = true;
    }
    return grows;
  }

  // Whether discs that slide around each other touch exactly at the end of each arc, as those that roll do. With
  // friction it is their mean force that is right (event_press.h), wherever an arc ends; its work to second order in
  // the arc, which is shorter.
  bool EndsExactly() const { return !(Value(in_.contact.friction) > 0); }

  // For how long a group may keep its accelerations because its discs move around each other, s; 0 if they do not.
  T Arc(const T& time, const T& arc_end) const {
    double step = kNever;
    bool curved = false;
    for (const auto& contact : group_.contacts()) {
      if (!contact.closed || !contact.Curved()) continue;
      curved = true;  // if it does not turn, its derivative does
      const Candidate& c = CandidateOf(contact.pair);
      const double distance = std::abs(Value(TurningDistance(in_, c, T(in_.ContactDistance(c)))));
      step = std::min(step, LongestArc(distance, group_.PassingSpeed(contact), group_.PassingAcceleration(contact)));
    }
    const double now = Value(time), left = in_.h - now;
    if (!curved || left <= 0) return T(0.0);
    if (!EndsExactly()) {
      step *= 0.1;
      if (!group_.RollsAround()) return T(step == kNever ? 0.0 : left / std::ceil(left / step));
    }
    if (Value(arc_end) - now < step) return arc_end - time;
    return (now + left / std::max(1.0, std::ceil(left / step))) - time;
  }

  // Whether discs that move around each other meet on their arc what they only touched, and was not pressed, before.
  bool MeetsOnArc(double time, double arc) const {
    if (arc <= kNodeMargin * in_.h) return false;
    return std::ranges::any_of(group_.contacts(), [&](const auto& contact) {
      if (contact.closed) return false;
      const Candidate& c = CandidateOf(contact.pair);
      return ApproachAt(c, time + arc).gap < std::min(ApproachAt(c, time).gap, 0.0) - kLargestDrift;
    });
  }

  void Hold(const typename Group::Contact& contact, const T& time, double arc) {
    const Candidate& c = CandidateOf(contact.pair);
    Pair& pair = pairs_[contact.pair];
    pair.held = contact.closed;
    pair.curved = contact.closed && contact.Curved() && arc > 0;
    pair.rolls = pair.curved && contact.mode == ContactMode::kStick;
    pair.stopping = pair.leaving = false;
    pair.passed = order_;
    if (contact.closed || contact.stopped) ReportSustained(contact, time);
    if (!contact.closed) return;
    const double arc_end = arc > 0 ? Value(time) + arc : kNever;
    discs_[c.a].arc_end = arc_end;
    if (!c.plane) discs_[c.b].arc_end = arc_end;
    pair.next = pair.curved ? arc_end : kNever;
    const double leaves = Value(time) + TimeOnEdge(c, Value(time));
    if (leaves < kNever && leaves - pair.next <= kArcEnd * arc) {
      pair.next = std::min(leaves, pair.next);
      pair.leaving = true;
    }
    if (contact.mode != ContactMode::kSlip) return;
    const double sliding = group_.SlidingSpeed(contact), change = group_.SlidingAcceleration(contact);
    if (std::abs(sliding) <= kStickSpeed || sliding * change >= 0) return;
    const double stop = Value(time) - sliding / change;
    if (stop - pair.next > kArcEnd * arc) return;  // it is the end of an arc that was cut there
    pair.next = std::min(stop, pair.next);
    pair.stopping = true;
    pair.leaving = false;
  }

  // Once for each mode.
  void ReportSustained(const typename Group::Contact& contact, const T& time) {
    int& reported = pairs_[contact.pair].reported_mode;
    if (reported == static_cast<int>(contact.mode)) return;
    reported = static_cast<int>(contact.mode);
    Report(CandidateOf(contact.pair), contact.mode, time, ContactKind::kSustained);
  }

  void Finish() {
    CloseCurvedContacts();
    if constexpr (!std::is_same_v<T, double>) return;
    if (const std::string_view wrong = this->WhatIsWrong(); !wrong.empty()) Fail(wrong);
  }

  // Discs that moved around each other end the step exactly in contact.
  void CloseCurvedContacts() {
    const T end(in_.h);
    for (int q = 0; q < num_pairs(); ++q) {
      if (!pairs_[q].held || !pairs_[q].curved) continue;
      group_.Clear();
      Gather(q, end);
      for (const auto& contact : group_.contacts()) pairs_[contact.pair].curved = false;
      group_.ProjectPositions();
      group_.ProjectVelocities();
    }
  }
  // Moves all discs that press against each other with those of pair q to `time`.
  void Gather(int q, const T& time) {
    if (!pairs_[q].held || group_.Contains(q)) return;
    const Candidate& c = CandidateOf(q);
    MoveTo(c.a, time);
    if (!c.plane) MoveTo(c.b, time);
    group_.AddClosed(q, static_cast<ContactMode>(pairs_[q].reported_mode), pairs_[q].curved);
    ForEachPairBeside(c, [&](int other) { Gather(other, time); });
  }

  int settled_ = 0;             // how often many contacts were
  int cuts_ = 0;                // of the last arcs on end
  std::pmr::vector<int> tied_;  // pairs, as FindTied found them
  TieTrial trial_;
  Group group_;
};

}  // namespace saltus::internal
