// Contacts that stay closed, in the event-driven model (event.h): a group of discs that press against each other and
// against planes, at one instant.
//
// Which contacts press, stick or slip is decided on values (event_contacts.h). Then three small linear systems, one for
// each of position, velocity and acceleration, keep the closed contacts closed; they are solved on values, and one
// correction in T carries the derivatives.
#pragma once

#include <algorithm>
#include <cmath>
#include <memory_resource>
#include <vector>

#include "contact/event/event_contacts.h"
#include "contact/event/event_rows.h"

namespace saltus::internal {

template <typename T, int kRotation = 0>
class PressedGroup : public PressedContacts<T, kRotation> {
 public:
  using Pressed = PressedContacts<T, kRotation>;
  using typename Pressed::Contact;

  explicit PressedGroup(const StepInput<T>& in) : Pressed(in), rows_(in), before_(in.scratch) {}

  // To be called before anything else.
  void Clear() {
    Pressed::Clear();
    rows_.Clear();
  }
  // As of PressedContacts.
  bool SolveForces() { return Pressed::SolveForces(rows_.inverse_mass()); }

  // Closes the contacts that are found to press. Friction was found against sliding as it was before what closes was
  // stopped: where that turns slow sliding round, the two stop, and the forces are those from there. False if they are
  // not found.
  bool Close() {
    const bool slowly = SlidesSlowly();
    if (slowly) before_.assign(discs_.begin(), discs_.end());
    ProjectPositions();
    ProjectVelocities();
    if (!slowly || !StickReversed()) return true;
    std::ranges::copy(before_, discs_.begin());
    ProjectVelocities();
    if (!SolveForces()) return false;
    ProjectPositions();
    ProjectVelocities();
    return true;
  }

  // Makes the gaps and the velocities across closed contacts zero. An overlap beyond the tolerance stays, unless it
  // comes from drift. Values, which are mere remainders, change along the normals. Derivatives change as a small
  // disturbance dies out: it opens contacts for a moment, in which they bounce or fall, and what they then lack of
  // their impulse, normal and friction alike, is what undoes the disturbance. An impulse thus acts along the contact's
  // whole force. A gap takes longer to close than a velocity to die out, but likewise it is undone by the integral P of
  // that lack of impulse over time, along the force; as that turns, the velocity changes by -P times its rate.
  void ProjectPositions() {
    const auto move = [&](int i, const Vec2<T>& change) { discs_[i].p += change; };
    rows_.Clear();
    for (const Contact& contact : contacts_) AddOverlap(contact);
    rows_.Solve();
    rows_.ForEachPush(move);
    AddRowsOfClosed([&](const Contact& contact) { AddGap(contact); });
    KeepValues();
    rows_.Solve();
    rows_.ForEachPush(move);
    if constexpr (kDerivatives) {
      AddRowsOfClosed([&](const Contact& contact) { AddGap(contact); });
      KeepDerivatives();
      rows_.Solve();
      rows_.ForEachPush(move);
      if constexpr (kRotation == kSpin) {
        rows_.ForEachTurn([&](int i, const T& change) { discs_[i].turn.angle += change; });
      }
      for (Row& row : rows_) row.push = row.turning;
      rows_.ForEachPush([&](int i, const Vec2<T>& change) { discs_[i].v -= change; });
    }
  }
  void ProjectVelocities() {
    const auto push = [&](int i, const Vec2<T>& change) { discs_[i].v += change; };
    for (Contact& contact : contacts_) contact.rests = std::abs(Value(NormalVelocity(contact))) <= kStillSpeed;
    StopClosing();
    // The second pass is for what rounding leaves of the first; what stops one contact may close others.
    for (int pass = 0; pass < 2;) {
      AddVelocityRows();
      KeepValues();
      bool negligible = true;
      for (const Row& row : rows_) negligible = negligible && std::abs(Value(row.violation)) <= kStillSpeed;
      rows_.Solve();
      rows_.ForEachPush(push);
      Turn();
      if (StopClosing()) {
        pass = 0;
      } else if (negligible) {
        break;
      } else {
        ++pass;
      }
    }
    if constexpr (kDerivatives) {
      AddVelocityRows();
      KeepDerivatives();
      rows_.Solve();
      rows_.ForEachPush(push);
      Turn();
    }
  }

  // Sets the accelerations under which closed contacts stay closed: at the instant, with arc = 0, or for discs that
  // move around each other over the next `arc` s. A constant acceleration keeps them in contact at the end, exactly, if
  // their mean relative velocity is normal to the sum of the distances at both ends; then contact forces do no work
  // either. With friction it is the force at half the time that is taken. Ends come from the accelerations as they are.
  void SetAccelerations(const T& arc) {
    AddRowsOfClosed([&](const Contact& contact) { AddAccelerationRows(contact, arc); });
    for (const Contact& contact : contacts_) {
      const Candidate& c = in_.candidates[contact.pair];
      discs_[c.a].a = in_.Acceleration(c.a);
      if (!c.plane) discs_[c.b].a = in_.Acceleration(c.b);
      if constexpr (kRotation == kSpin) {
        discs_[c.a].turn.acceleration = in_.AngularAcceleration(c.a);
        if (!c.plane) discs_[c.b].turn.acceleration = in_.AngularAcceleration(c.b);
      }
    }
    // The forces found on values, then what is missing.
    const auto push = [&](int i, const Vec2<T>& change) { discs_[i].a += change; };
    const auto push_and_turn = [&] {
      rows_.ForEachPush(push);
      if constexpr (kRotation == kSpin) {
        rows_.ForEachTurn([&](int i, const T& change) { discs_[i].turn.acceleration += change; });
      }
    };
    push_and_turn();
    for (Row& row : rows_) {
      row.violation += Dot(row.direction, discs_[row.a].a);
      if (row.b >= 0) row.violation -= Dot(row.direction, discs_[row.b].a);
      if constexpr (kRotation == kSpin) row.violation -= row.along * TurningOf(row);
    }
    rows_.Solve();
    push_and_turn();
  }

  // Opens the closed contacts that would have to pull under these accelerations: they part within the arc. True if
  // there are any.
  bool OpenPulling() {
    bool any = false;
    std::size_t row = 0;
    for (Contact& contact : contacts_) {
      if (!contact.closed) continue;
      const double force = contact.force.normal_force + Value(rows_[row].force);
      row += contact.mode == ContactMode::kStick ? 2 : 1;
      if (force >= 0) continue;
      contact.closed = false;
      any = true;
    }
    return any;
  }

  // The share of the arc of these accelerations until just before a contact with friction opens or begins to slide, in
  // the end until just after it; 1 if none does. Forces do not jump there, so derivatives need no more than an arc that
  // ends there. On the arc the forces of a contact that slides are those of half its time, those of one that rolls,
  // which are told by places, on average those of a third.
  double ShareInMode() const {
    constexpr double kShort = 0.99, kBeyond = 1e-6;
    const double friction = Value(in_.contact.friction);
    double share = 1;
    std::size_t row = 0;
    for (const Contact& contact : contacts_) {
      if (!contact.closed) continue;
      const PressingContact& f = contact.force;
      const bool sticks = contact.mode == ContactMode::kStick;
      const double normal = f.normal_force + Value(rows_[row].force);
      double left = f.normal_force, later = normal;  // at the start, and on the arc
      if (sticks) {
        left = friction * left - std::abs(f.tangential_force);
        later = friction * normal - std::abs(f.tangential_force + Value(rows_[row + 1].force));
      }
      row += sticks ? 2 : 1;
      if (later < left)
        share = std::min(share, kShort * (sticks ? 1.0 / 3 : 0.5) * std::max(left, 0.0) / (left - later) + kBeyond);
    }
    return share;
  }

  // The tangential part of a sliding contact's force for one of 1 N along the normal.
  T TangentialShare(const Contact& contact) const {
    if (contact.mode == ContactMode::kStick || wedged_) return T(0.0);
    return in_.contact.friction * double(-contact.force.sliding);
  }

 private:
  using Row = typename ForceRows<T, kRotation>::Row;
  using Pressed::in_, Pressed::discs_, Pressed::contacts_, Pressed::wedged_, Pressed::ValueOf;
  static constexpr bool kDerivatives = !std::is_same_v<T, double>;

  // Whether there is friction against sliding so slow that stopping what closes might turn it round.
  bool SlidesSlowly() const {
    return std::ranges::any_of(contacts_, [&](const Contact& contact) {
      return contact.closed && contact.mode == ContactMode::kSlip && contact.force.sliding != 0 &&
             std::abs(this->SlidingSpeed(contact)) <= kLargestSlowSpeed;
    });
  }
  // Makes the closed contacts stick that slide to where their friction pushes. True if there are any.
  bool StickReversed() {
    bool any = false;
    for (Contact& contact : contacts_) {
      if (!contact.closed || contact.mode != ContactMode::kSlip) continue;
      const double sliding = this->SlidingSpeed(contact);
      if (std::abs(sliding) <= kStickSpeed || sliding * contact.force.sliding > 0) continue;
      contact.mode = ContactMode::kStick;
      any = true;
    }
    return any;
  }

  template <typename Add>
  void AddRowsOfClosed(const Add& add) {
    rows_.Clear();
    for (const Contact& contact : contacts_) {
      if (contact.closed) add(contact);
    }
  }
  // The violations without derivatives, undone along the normals (and tangents).
  void KeepValues() {
    for (Row& row : rows_) {
      row.violation = T(Value(row.violation));
      row.push = row.direction;
    }
  }
  void KeepDerivatives() {
    for (Row& row : rows_) row.violation -= Value(row.violation);
  }

  // How fast the points of contact of a row are accelerated along the tangent by the turning of the discs.
  T TurningOf(const Row& row) const {
    T sum = in_.bodies[row.a].radius * discs_[row.a].turn.acceleration;
    if (row.b >= 0) sum += in_.bodies[row.b].radius * discs_[row.b].turn.acceleration;
    return sum;
  }
  // What the forces across velocities do to the turning.
  void Turn() {
    if constexpr (kRotation == kSpin) {
      rows_.ForEachTurn([&](int i, const T& change) { discs_[i].turn.speed += change; });
    }
  }
  Separation<T> SeparationOf(const Candidate& c) const {
    return SeparationAt(in_, c, [&](int i) { return discs_[i].p; });
  }
  bool MayMove(double gap, const Contact& contact) const { return gap >= -kContactGap || contact.drifts; }
  void AddGap(const Contact& contact) {
    const Candidate& c = in_.candidates[contact.pair];
    const Separation<T> at = SeparationOf(c);
    T gap = at.distance - in_.ContactDistance(c);
    if (!MayMove(Value(gap), contact)) gap -= Value(gap);
    const Vec2<T> tangent = Perpendicular(at.normal);
    const T along = TangentialShare(contact);
    Row row{c.a, c.plane ? -1 : c.b, at.normal, at.normal + Scale(along, tangent), gap, T(0.0), T(0.0), along};
    if (contact.mode == ContactMode::kStick) {
      const double drift = DriftOf(contact);
      row.push = at.normal - Scale(drift, tangent);
      row.push_along = T(-drift);
    }
    if (const T turning = TurningDistance(in_, c, at.distance); contact.MayTurn() && Value(turning) != 0) {
      const T rate = Divide(Dot(tangent, RelativeVelocity<T>(c, [&](int i) { return discs_[i].v; })), turning);
      row.turning = Scale(rate, Vec2<T>(tangent - Scale(row.push_along, at.normal)));
    }
    rows_.Add(row);
  }
  // How far a contact that sticks moves along its tangent when its gap is opened, as a multiple of that: while it falls
  // and bounces, nothing holds it against what would make it slide. For a contact by itself; of several that stick
  // there is no such number, which of them meets first decides.
  double DriftOf(const Contact& contact) const {
    const PressingContact& f = contact.force;
    const double restitution = Value(in_.contact.restitution);
    if (contacts_.size() > 1 || f.mass == 0 || restitution >= 1) return 0;
    const auto given = [&](int i) { return ValueOf(in_.Acceleration(i)); };
    const Vec2d a = given(f.a) - (f.b >= 0 ? given(f.b) : Vec2d(0, 0));
    const double friction = Value(in_.contact.friction);
    double tangential = Dot(Perpendicular(f.normal), a);
    if constexpr (kRotation == kSpin) {
      // What it gives way by turning is no drift: this is beside the motion in which it rolls.
      const auto given_turn = [&](int i) { return Value(in_.AngularAcceleration(i)); };
      tangential = AlongSurface<kRotation>(in_, in_.candidates[contact.pair], tangential, given_turn);
      tangential *= f.tangential_mass / f.mass;
    }
    return DriftOfBounces(tangential, -Dot(f.normal, a) - f.turning, friction, restitution);
  }
  // On values. Not only of closed contacts: closing these must not push others into each other bit by bit.
  void AddOverlap(const Contact& contact) {
    const Candidate& c = in_.candidates[contact.pair];
    const Separation<T> at = SeparationOf(c);
    const double gap = Value(at.distance) - in_.ContactDistance(c);
    if (!MayMove(gap, contact) || std::abs(gap) <= kRoundingGap || (!contact.closed && gap > -0.1 * kContactGap))
      return;
    rows_.Add({c.a, c.plane ? -1 : c.b, at.normal, at.normal, T(gap), T(0.0)});
  }

  T NormalVelocity(const Contact& contact) const {
    const Candidate& c = in_.candidates[contact.pair];
    return Dot(SeparationOf(c).normal, RelativeVelocity<T>(c, [&](int i) { return discs_[i].v; }));
  }
  // Marks what closes though it is not pressed. True if there is anything new.
  bool StopClosing() {
    bool any = false;
    for (Contact& contact : contacts_) {
      if (contact.closed || contact.stopped || Value(NormalVelocity(contact)) >= -kStillSpeed) continue;
      contact.stopped = any = true;
      contact.rests = false;
    }
    return any;
  }
  void AddVelocityRows() {
    rows_.Clear();
    for (const Contact& contact : contacts_) {
      if (contact.closed || contact.stopped) AddVelocityRows(contact);
    }
  }
  void AddVelocityRows(const Contact& contact) {
    const Candidate& c = in_.candidates[contact.pair];
    const int b = c.plane ? -1 : c.b;
    const Vec2<T> normal = SeparationOf(c).normal, tangent = Perpendicular(normal);
    const Vec2<T> w = RelativeVelocity<T>(c, [&](int i) { return discs_[i].v; });
    Vec2<T> push = normal;
    T push_along(0.0);
    if (contact.rests) {
      push_along = TangentialShare(contact);
      push += Scale(push_along, tangent);
    }
    rows_.Add({c.a, b, normal, push, Dot(normal, w), T(0.0), T(0.0), push_along});
    if (contact.stopped || (contact.mode != ContactMode::kStick && !wedged_ && !contact.rolled)) return;
    const T sliding = AlongSurface<kRotation>(in_, c, T(Dot(tangent, w)), [&](auto i) { return discs_[i].turn.speed; });
    rows_.Add({c.a, b, tangent, tangent, sliding, T(0.0), T(1.0), T(1.0)});
  }

  void AddAccelerationRows(const Contact& contact, const T& arc) {
    const Candidate& c = in_.candidates[contact.pair];
    const PressingContact& f = contact.force;
    // With friction the mean force must be right as well: it is that at half the time.
    const bool half = contact.mode == ContactMode::kSlip;
    const T ahead = (half ? 0.25 : 0.5) * arc;
    const Separation<T> at = SeparationAt(in_, c, [&](int i) -> Vec2<T> {
      return discs_[i].p + Scale(T(0.5 * arc), Vec2<T>(discs_[i].v + Scale(ahead, discs_[i].a)));
    });
    const Vec2<T> tangent = Perpendicular(at.normal);
    const int b = c.plane ? -1 : c.b;
    T turning(0.0), slipping(0.0);
    const T distance = TurningDistance(in_, c, at.distance);
    if (contact.MayTurn() && Value(distance) != 0) {
      const T until = (half ? 0.5 : 0.0) * arc;
      const Vec2<T> w =
          RelativeVelocity<T>(c, [&](int i) -> Vec2<T> { return discs_[i].v + Scale(until, discs_[i].a); });
      const T passing = Dot(tangent, w);
      if (Value(arc) > 0 && !half) {
        turning = Divide(T(2.0 * Dot(at.normal, w)), arc);
        slipping = Divide(
            T(2.0 * AlongSurface<kRotation>(in_, c, passing, [&](auto i) { return discs_[i].turn.speed; })), arc);
      } else {
        turning = Divide(T(passing * passing), distance);
      }
    }
    if (contact.mode == ContactMode::kStick) {
      rows_.Add({c.a, b, at.normal, at.normal, turning, T(f.normal_force)});
      rows_.Add({c.a, b, tangent, tangent, slipping, T(f.tangential_force), T(1.0), T(1.0)});
      return;
    }
    const T share = in_.contact.friction * double(-f.sliding);
    const Vec2<T> push = at.normal + Scale(share, tangent);
    rows_.Add({c.a, b, at.normal, push, turning, T(f.normal_force), T(0.0), share});
  }

  ForceRows<T, kRotation> rows_;
  std::pmr::vector<typename Pressed::Disc> before_;  // until what closes was stopped
};

}  // namespace saltus::internal
