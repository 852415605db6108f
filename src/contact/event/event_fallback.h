// The time-stepping fallback of the event-driven model (event.h): a step with Zeno behaviour, of many discs that touch
// and whose impacts cause each other without end, is taken from one grid node to the next as a whole.
//
// With v the velocities at the start and a the accelerations under given forces, contacts have impulses within the cone
// of friction, f_+ (n + mu t) + f_- (n - mu t), with their directions and gaps g at the start, under which the
// velocities at the end and the step h satisfy (Anitescu 2006)
//
//   v' = v + h a + sum P / m        p' = p + h v'
//   0 <= f_+-  _|_  (n +- mu t).w' + g / h >= 0,
//
// w' the relative velocity: plastic impacts and Coulomb's friction, but a contact that slides keeps a gap of mu times
// the distance that it slides in a step. Solutions always exist, and their velocities are unique. Discs and half-planes
// are convex, so no gap becomes negative. No energy is gained: contacts do the work P.w' <= 0, and forces that of p' -
// p, less half the square of the change of velocity. The derivatives are those of the equations of the active contacts
// (implicit function theorem). A disc without active contacts flies exactly.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <memory_resource>
#include <span>
#include <string_view>
#include <type_traits>
#include <vector>

#include "contact/event/event_rows.h"
#include "contact/solvers/impulse_qp.h"

namespace saltus::internal {

template <typename T>
class TimeSteppingStep {
 public:
  using State = BodyState<T, 0>;

  TimeSteppingStep(const StepInput<T>& in, std::span<const State> x)
      : in_(in),
        start_(x),
        discs_(x.size(), in.scratch),
        contacts_(in.scratch),
        joining_(in.scratch),
        bounds_(in.candidates.size(), 0, in.scratch),
        rows_(in) {
    for (std::size_t i = 0; i < x.size(); ++i) {
      const Vec2<T> a = in.Acceleration(static_cast<int>(i));
      discs_[i].start = {ValueOf(x[i].p), ValueOf(x[i].v), ValueOf(a)};
      discs_[i].velocity = x[i].v + Scale(in.h, a);
      discs_[i].given = discs_[i].after = ValueOf(discs_[i].velocity);
    }
  }

  // Whether derivatives are asked for of a step that a fallback has recorded (its record begins with an empty vector).
  static bool IsRecorded(const StepInput<T>& in) {
    return in.solved != nullptr && !in.solved->AtEnd() && in.solved->numbers()[0] == 0;
  }

  // Takes the step, and reports the active contacts. Returns why there is no result; empty if there is one.
  std::string_view Run() {
    in_.Solved([] { return std::array<double, 0>(); });
    const std::span<const double> found = in_.Solved([&] { return FindImpulses(); });
    if (failed_) return "the impulses of the time-stepping fallback are not found";
    contacts_.clear();
    for (std::size_t pair = 0; pair < in_.candidates.size(); ++pair) {
      Contact contact = MeasureContact(static_cast<int>(pair));
      contact.left = found[3 * pair];
      contact.right = found[3 * pair + 1];
      if (found[3 * pair + 2] != 0) Include(in_.candidates[pair]);
      contacts_.push_back(contact);
      Report(contact);
    }
    ApplyImpulses();
    return std::is_same_v<T, double> ? ReasonInconsistent() : std::string_view();
  }

  // Whether disc i takes part, and if so its state at the end of the step.
  bool HasMoved(int i) const { return discs_[i].takes_part; }
  State End(int i) const { return {start_[i].p + Scale(in_.h, discs_[i].velocity), discs_[i].velocity}; }

 private:
  struct Disc {
    Motion start;
    Vec2<T> velocity;                // at the end of the step
    Vec2d given{0, 0}, after{0, 0};  // the same, as values, without and with impulses
    bool takes_part = false;
    bool meets = false;  // it takes part even without active contacts
  };
  struct Contact {
    int pair = 0;
    Vec2d normal{0, 0};
    double apart = 0;            // m/s, at which the gap would be closed
    double left = 0, right = 0;  // N s, along n - mu t and n + mu t
  };

  bool IsMovable(int i) const { return !in_.bodies[i].fixed; }
  double Friction(const Candidate& c) const { return Value(in_.ContactOf(c).friction); }

  template <typename PositionOf>
  Separation<double> SeparationInStep(const Candidate& c, const PositionOf& position) const {
    Separation<double> at =
        c.plane ? Separate<double>(position(c.a), in_.planes[c.b]) : Separate<double>(position(c.a), position(c.b));
    at.distance -= in_.ContactDistance(c);
    // An edge counts as a contact if it does so at the start of the step.
    const bool edge = c.plane && !in_.extents.empty() && !in_.extents[c.b].endless;
    if (edge && !in_.extents[c.b].Covers(discs_[c.a].start.p, kSeam)) at.distance = kNever;
    return at;
  }
  double GapAtStart(const Candidate& c) const {
    return SeparationInStep(c, [&](int i) { return discs_[i].start.p; }).distance;
  }
  double GapAtEnd(const Candidate& c) const {
    return SeparationInStep(c,
                            [&](int i) {
                              const Disc& disc = discs_[i];
                              return disc.takes_part ? Vec2d(disc.start.p + in_.h * disc.after)
                                                     : disc.start.MotionAfter(in_.h).p;
                            })
        .distance;
  }
  Contact MeasureContact(int pair) const {
    const Separation<double> at = SeparationInStep(in_.candidates[pair], [&](int i) { return discs_[i].start.p; });
    // A small overlap comes from rounding, and is undone.
    return {pair, at.normal, (at.distance > -kLargestOverlap ? at.distance : 0.0) / in_.h};
  }

  // Returns two impulses of each pair, N s, and whether the discs of each take part.
  std::vector<double> FindImpulses() {
    FindPossiblePairs();
    for (int round = 0; round < kMostFallbackRounds; ++round) {
      if (!Solve()) break;
      LeaveOut();
      if (!AddOverlappingPairs()) return FoundImpulses();
    }
    failed_ = true;
    return {};
  }

  // Finds the pairs that may meet, whether or not the discs are stopped or pushed by others.
  void FindPossiblePairs() {
    double pushed = 0;  // m/s
    for (std::size_t i = 0; i < discs_.size(); ++i) {
      if (IsMovable(static_cast<int>(i))) pushed = std::max(pushed, in_.h * discs_[i].start.a.norm());
    }
    for (int pair = 0; pair < static_cast<int>(in_.candidates.size()); ++pair) {
      const Candidate& c = in_.candidates[pair];
      const Contact contact = MeasureContact(pair);
      double closing = std::max(0.0, -Dot(contact.normal, discs_[c.a].given));
      if (!c.plane) closing += std::max(0.0, Dot(contact.normal, discs_[c.b].given));
      if (contact.apart > closing + pushed) continue;
      bounds_[pair] = 1;
      Include(c);
    }
  }
  void Include(const Candidate& c) {
    for (int i : {c.a, c.plane ? c.a : c.b}) discs_[i].takes_part = IsMovable(i);
  }
  bool TakesPart(const Candidate& c) const {
    const auto takes = [&](int i) { return discs_[i].takes_part || !IsMovable(i); };
    return takes(c.a) && (c.plane || takes(c.b));
  }

  bool Bounds(int pair) const { return bounds_[pair] && TakesPart(in_.candidates[pair]); }

  bool Solve() {
    contacts_.clear();
    std::vector<ImpulseRow> rows;
    for (int pair = 0; pair < static_cast<int>(in_.candidates.size()); ++pair) {
      const Candidate& c = in_.candidates[pair];
      if (!Bounds(pair)) continue;
      const Contact contact = MeasureContact(pair);
      contacts_.push_back(contact);
      const Vec2d slope = Friction(c) * Perpendicular(contact.normal);
      rows.push_back({c.a, c.plane ? -1 : c.b, contact.normal - slope, contact.apart});
      if (Friction(c) > 0) rows.push_back({c.a, c.plane ? -1 : c.b, contact.normal + slope, contact.apart});
    }
    std::vector<Vec2d> velocity;
    std::vector<double> inverse_mass;
    for (std::size_t i = 0; i < discs_.size(); ++i) {
      velocity.push_back(discs_[i].given);
      inverse_mass.push_back(Value(in_.bodies[i].inverse_mass));
    }
    if (!SolveImpulseQp(inverse_mass, velocity, rows)) return false;
    largest_ = 0;
    for (const ImpulseRow& row : rows) largest_ = std::max(largest_, row.impulse);
    auto row = rows.begin();
    for (Contact& contact : contacts_) {
      contact.left = (row++)->impulse;
      contact.right = Friction(in_.candidates[contact.pair]) > 0 ? (row++)->impulse : 0;
    }
    for (std::size_t i = 0; i < discs_.size(); ++i) discs_[i].after = velocity[i];
    return true;
  }

  bool IsActive(double impulse) const { return impulse > kActiveImpulse * largest_; }
  bool IsActive(const Contact& contact) const { return IsActive(contact.left) || IsActive(contact.right); }
  // Removes the discs without active contacts, which fly exactly, unless they would meet another disc in the step.
  void LeaveOut() {
    std::pmr::vector<char> has_active(discs_.size(), in_.scratch);
    for (const Contact& contact : contacts_) {
      if (!IsActive(contact)) continue;
      const Candidate& c = in_.candidates[contact.pair];
      has_active[c.a] = 1;
      if (!c.plane) has_active[c.b] = 1;
    }
    for (std::size_t i = 0; i < discs_.size(); ++i) {
      if (!has_active[i] && !discs_[i].meets) discs_[i].takes_part = false;
    }
  }
  // Adds the pairs that were not among the contacts and would overlap. Returns whether there are any.
  bool AddOverlappingPairs() {
    joining_.clear();
    for (int pair = 0; pair < static_cast<int>(in_.candidates.size()); ++pair) {
      const Candidate& c = in_.candidates[pair];
      if (Bounds(pair)) continue;
      if (GapAtEnd(c) < std::min(GapAtStart(c), 0.0) - kRoundingGap) joining_.push_back(pair);
    }
    for (int pair : joining_) {
      const Candidate& c = in_.candidates[pair];
      bounds_[pair] = 1;
      for (int i : {c.a, c.plane ? c.a : c.b}) discs_[i].meets = discs_[i].meets || !discs_[i].takes_part;
      Include(c);
    }
    return !joining_.empty();
  }

  std::vector<double> FoundImpulses() const {
    std::vector<double> found(3 * in_.candidates.size(), 0.0);
    for (std::size_t pair = 0; pair < in_.candidates.size(); ++pair)
      found[3 * pair + 2] = TakesPart(in_.candidates[pair]);
    for (const Contact& contact : contacts_) {
      if (IsActive(contact.left)) found[3 * contact.pair] = contact.left;
      if (IsActive(contact.right)) found[3 * contact.pair + 1] = contact.right;
    }
    return found;
  }

  // Reports a contact without a time, so not as an event; inactive pairs too, as the derivatives are of all discs.
  void Report(const Contact& contact) {
    const Candidate& c = in_.candidates[contact.pair];
    const bool left = contact.left > 0, right = contact.right > 0, rough = Friction(c) > 0 && (left || right);
    const ContactMode mode = !rough          ? ContactMode::kFrictionless
                             : left && right ? ContactMode::kStick
                                             : ContactMode::kSlip;
    in_.Report(c, mode, -1, ContactKind::kSustained);
  }

  // Applies the impulses, then corrections in T, which carry the derivatives and do not change the values, to the last
  // bit that the gaps need.
  void ApplyImpulses() {
    if constexpr (std::is_same_v<T, double>) {
      for (Disc& disc : discs_) disc.velocity = disc.after;
      return;
    }
    rows_.Clear();
    for (const Contact& contact : contacts_) AddRows(contact);
    const auto push = [&](int i, const Vec2<T>& change) { discs_[i].velocity += change; };
    rows_.ForEachPush(push);
    for (auto& row : rows_) {
      row.violation += Dot(row.direction, discs_[row.a].velocity);
      if (row.b >= 0) row.violation -= Dot(row.direction, discs_[row.b].velocity);
      row.violation -= Value(row.violation);
    }
    rows_.Solve();
    rows_.ForEachPush(push);
  }
  void AddRows(const Contact& contact) {
    const Candidate& c = in_.candidates[contact.pair];
    const Separation<T> at = SeparationAt(in_, c, [&](int i) { return start_[i].p; });
    const T gap = at.distance - in_.ContactDistance(c);
    const auto add = [&](const Vec2<T>& direction, double impulse) {
      if (impulse > 0) {
        rows_.Add({c.a, c.plane ? -1 : c.b, direction, direction, Divide(gap, in_.h), T(impulse)});
      }
    };
    const Vec2<T> slope = Scale(in_.ContactOf(c).friction, Perpendicular(at.normal));
    add(at.normal - slope, contact.left);
    add(at.normal + slope, contact.right);
  }

  // Returns the reason why the motion is not that of rigid discs; empty if it is.
  std::string_view ReasonInconsistent() const {
    double gain = 0, energy = 0;
    for (std::size_t i = 0; i < discs_.size(); ++i) {
      if (!discs_[i].takes_part) continue;
      const Motion& start = discs_[i].start;
      const Vec2d after = ValueOf(discs_[i].velocity);
      const double mass = Value(in_.bodies[i].mass);
      gain += 0.5 * mass * (after.squaredNorm() - start.v.squaredNorm()) - mass * in_.h * Dot(start.a, after);
      energy += 0.5 * mass * std::max(after.squaredNorm(), start.v.squaredNorm()) + mass * start.a.norm();
    }
    for (const Candidate& c : in_.candidates) {
      if (GapAtEnd(c) < std::min(GapAtStart(c), 0.0) - kLargestOverlap)
        return "discs would overlap in the time-stepping fallback";
    }
    return gain > kLargestGain * energy ? "the time-stepping fallback would gain energy" : std::string_view();
  }

  const StepInput<T>& in_;
  std::span<const State> start_;
  std::pmr::vector<Disc> discs_;
  std::pmr::vector<Contact> contacts_;
  std::pmr::vector<int> joining_;  // pairs
  std::pmr::vector<char> bounds_;  // of each pair: it may be a contact
  double largest_ = 0;             // impulse
  bool failed_ = false;
  ForceRows<T, 0> rows_;
};

}  // namespace saltus::internal
