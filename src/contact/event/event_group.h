// A contact group of the event-driven model (event.h): contacts connected by discs, at one instant, of which some stay
// closed under contact forces.
//
// Which contacts are closed, stick or slide is decided on values (solvers/resting_forces.h). Then three linear systems,
// for the gaps, the velocities and the accelerations across the closed contacts, keep these at zero. They are solved on
// values, and one correction in T carries the derivatives.
#pragma once

#include <algorithm>
#include <cmath>
#include <memory_resource>
#include <span>
#include <vector>

#include "contact/event/event_rows.h"
#include "contact/solvers/resting_forces.h"
#include "saltus/internal/runge_kutta_step.h"

namespace saltus::internal {

// The distance that a disc that rests and sticks is carried along its tangent until it rests again, as a multiple of
// the height from which it is dropped on its contact. `pressing` (> 0) and `tangential` are its accelerations in
// flight, m/s^2; |tangential| < friction * pressing. Infinite for restitution 1: it does not come to rest.
//
// In units of `pressing` and of the speed of the first impact the height is 1/2. Flight k >= 1 lasts 2 e^k; before and
// after the first impact the disc is at rest along the tangent, and each later one leaves it with the speed
// q (e + ... + e^k), q = 2 r - mu (1 + e), or at rest if q < 0. It slides with what is left when it bounces no more.
inline double DriftOfBounces(double tangential, double pressing, double friction, double restitution) {
  const double r = std::abs(tangential) / pressing, e = restitution;
  const double q = std::max(0.0, 2 * r - friction * (1 + e)), speed = q * e / (1 - e);
  double drift = 0.5 * r + 2 * (r + speed) * e * e / (1 - e * e);
  if (speed > 0) drift += 0.5 * speed * speed / (friction - r);
  return std::copysign(2 * drift, tangential);
}

template <typename T, int kRotation = 0>
class EventGroup {
 public:
  using Disc = EventDisc<T, kRotation>;
  struct Contact {
    int pair = 0;  // index of its candidate
    RestingContact force = {};
    ContactMode mode = ContactMode::kFrictionless;
    bool closed = false;        // its force keeps its gap at zero
    bool stopped = false;       // not closed, but closing slowly: that speed is taken away
    bool rests = false;         // its normal velocity is rounding, not that of bounces that are cut off here
    bool drifts = false;        // its discs have moved around each other since it was last closed exactly
    bool bends = false;         // its normal turns as its discs move along each other
    double force_at_start = 0;  // N, its normal force at the instant
    // Discs that stick do not move along each other, unless they roll.
    bool MayTurn() const { return mode != ContactMode::kStick || kRotation == kSpin; }
    bool Curved() const { return bends && MayTurn(); }
  };

  explicit EventGroup(const StepInput<T>& in)
      : in_(in),
        contacts_(in.scratch),
        forces_(in.scratch),
        acceleration_(in.scratch),
        turning_(in.scratch),
        has_disc_(in.scratch),
        has_pair_(in.scratch),
        rows_(in),
        before_(in.scratch),
        moving_(in.scratch),
        stages_(in.scratch) {}

  // The discs of the step, which the functions below read and change. They must stay where they are.
  void SetDiscs(std::span<Disc> discs) { discs_ = discs; }
  // Whether a step that fails is taken by time-stepping instead: forces of many contacts are then found within few
  // iterations or not at all.
  void SetIterationLimited(bool limited) { iteration_limited_ = limited; }
  // Makes the group empty. To be called before anything else.
  void Clear() {
    for (const Contact& contact : contacts_) Mark(contact.pair, 0);
    contacts_.clear();
    jammed_ = false;
    acceleration_.resize(discs_.size());
    if (kRotation == kSpin) turning_.resize(discs_.size());
    has_disc_.resize(discs_.size());
    has_pair_.resize(in_.candidates.size());
    rows_.Clear();
  }

  std::span<const Contact> contacts() const { return contacts_; }
  bool Contains(int pair) const { return has_pair_[pair]; }
  bool HasDisc(int i) const { return has_disc_[i]; }
  // Adds a pair to the group. Precondition: its discs have been moved to the instant of the group.
  void Add(int pair, bool drifts = false) {
    const Candidate& c = in_.candidates[pair];
    if (!HasDisc(c.a)) Reset(c.a);
    if (!c.plane && !HasDisc(c.b)) Reset(c.b);
    contacts_.push_back({.pair = pair, .drifts = drifts});
    Mark(pair, 1);
  }
  void AddClosed(int pair, ContactMode mode, bool drifts) {
    contacts_.push_back({.pair = pair, .mode = mode, .closed = true, .drifts = drifts});
    Mark(pair, 1);
  }

  // Finds the forces on values, and which contacts they close. Returns false if they are not found.
  bool SolveForces() {
    for (Contact& contact : contacts_) Measure(&contact);
    const std::span<const double> found = in_.Solved([&] { return FindForces(); });
    if (found.empty()) return false;
    jammed_ = found[0] != 0;
    double largest = 0;
    for (std::size_t k = 0; k < contacts_.size(); ++k) {
      RestingContact& force = contacts_[k].force;
      if (jammed_) EndSliding(&force);
      force.normal_force = found[1 + 3 * k];
      force.tangential_force = found[2 + 3 * k];
      largest = std::max(largest, force.normal_force);
    }
    for (std::size_t k = 0; k < contacts_.size(); ++k) {
      contacts_[k].force_at_start = contacts_[k].force.normal_force;
      Classify(kOpenForce * largest, found[3 + 3 * k], &contacts_[k]);
    }
    return true;
  }

  // Closes the contacts with a force. Friction was found against the sliding before the closing speeds were taken away:
  // where this reverses slow sliding, the two stop, and the forces are found again from there. Returns false if they
  // are not.
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
  // comes from drift. Values, which are rounding, change along the normals. Derivatives change as a small disturbance
  // decays: it opens contacts for a moment, in which they bounce or fall, and the impulse that they lack in that time,
  // normal and friction alike, undoes the disturbance. An impulse thus acts along the whole force of the contact. A gap
  // takes longer to close than a velocity to decay, but likewise it is undone by the integral P of that lack of impulse
  // over time, along the force; as the force turns, the velocity changes by -P times its rate.
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
    // The second pass is for what rounding leaves of the first; stopping one contact may close others.
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

  // Sets the accelerations under which closed contacts stay closed: at the instant, with sub_step = 0, or for discs
  // that slide around each other without friction over the next `sub_step` s. A constant acceleration keeps them
  // exactly in contact at the end if their mean relative velocity is normal to the sum of the distances at both ends;
  // then contact forces do no work either. The ends are predicted by the present accelerations.
  void SetAccelerations(const T& sub_step) {
    AddRowsOfClosed([&](const Contact& contact) { AddAccelerationRows(contact, sub_step); });
    for (const Contact& contact : contacts_) {
      const Candidate& c = in_.candidates[contact.pair];
      discs_[c.a].a = in_.Acceleration(c.a);
      if (!c.plane) discs_[c.b].a = in_.Acceleration(c.b);
      if constexpr (kRotation == kSpin) {
        discs_[c.a].turn.acceleration = in_.AngularAcceleration(c.a);
        if (!c.plane) discs_[c.b].turn.acceleration = in_.AngularAcceleration(c.b);
      }
    }
    // The first pass sets the forces found on values, the second one the corrections, which carry derivatives.
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

  // Lets all discs of the group move for `length` s from the instant under their contact forces, which rotate with the
  // normals: by one Runge-Kutta step of order 8 (saltus/internal/runge_kutta_step.h). In between, the position is the
  // polynomial of degree 5 with the positions, velocities and accelerations of both ends. Positions and velocities are
  // computed as differences from a motion of constant acceleration, so that short sub-steps lose no digits.
  void SetCurves(double length) {
    using cooper_verner::kStages;
    FindAccelerations();
    moving_.clear();
    for (std::size_t i = 0; i < discs_.size(); ++i) {
      if (HasDisc(i)) moving_.push_back(i);
    }
    const std::size_t n = moving_.size();
    before_.clear();
    for (int i : moving_) before_.push_back(discs_[i]);
    stages_.assign((kStages + 1) * n, Bent());
    for (int stage = 1; stage <= kStages; ++stage) {
      const double s = stage < kStages ? cooper_verner::kC[stage] * length : length;
      for (std::size_t k = 0; k < n; ++k) MoveToStage(stage, s, length, k);
      FindAccelerations();
      for (std::size_t k = 0; k < n; ++k) {
        const Disc &disc = discs_[moving_[k]], &start = before_[k];
        Bent& bent = stages_[stage * n + k];
        bent.a = disc.a - start.a;
        if constexpr (kRotation == kSpin) bent.turn.a = disc.turn.acceleration - start.turn.acceleration;
      }
    }
    for (std::size_t k = 0; k < n; ++k) {
      Disc& disc = discs_[moving_[k]];
      disc = before_[k];
      const Bent& end = stages_[kStages * n + k];
      disc.curve = KeepCurve<Vec2<T>>(end, length, [](double s, const Vec2<T>& x) { return Scale(s, x); });
      if constexpr (kRotation == kSpin) {
        disc.turn.curve = KeepCurve<T>(end.turn, length, [](double s, const T& x) { return T(s * x); });
      }
    }
  }

  // Opens the closed contacts that would have to pull under these accelerations: they separate within the sub-step.
  // Returns whether there are any.
  bool OpenPulling() {
    bool any = false;
    std::size_t row = 0;
    for (Contact& contact : contacts_) {
      if (!contact.closed) continue;
      const double force = contact.force.normal_force + Value(rows_[row++].force);
      if (force >= 0) continue;
      contact.closed = false;
      any = true;
    }
    return any;
  }

  // Returns how far the forces at the end of the curves are from where a contact with friction opens or begins to
  // slide: the least distance over all contacts, divided by the normal force at the start; negative beyond that place.
  double ModeMargin() const {
    double left = kNever;
    for (const Contact& contact : contacts_) {
      if (!contact.closed) continue;
      const RestingContact& f = contact.force;
      const bool sticks = contact.mode == ContactMode::kStick;
      const double force = sticks ? f.friction * f.normal_force - std::abs(f.tangential_force) : f.normal_force;
      left = std::min(left, force / contact.force_at_start);
    }
    return left;
  }

  // Returns the tangential force of a sliding contact divided by its normal force.
  T TangentialShare(const Contact& contact) const {
    if (contact.mode == ContactMode::kStick || jammed_) return T(0.0);
    return FrictionOf(contact) * double(-contact.force.sliding);
  }

  // Speed and acceleration of the two centres along each other, which turn the normal, as values.
  double PassingSpeed(const Contact& contact) const {
    return AlongTangent(contact, [&](int i) { return ValueOf(discs_[i].v); });
  }
  double PassingAcceleration(const Contact& contact) const {
    return AlongTangent(contact, [&](int i) { return ValueOf(discs_[i].a); });
  }
  // Speed and acceleration of the points of contact along each other: the sliding speed and its rate of change.
  double SlidingSpeed(const Contact& contact) const {
    return AlongSurface<kRotation>(
        in_, in_.candidates[contact.pair], PassingSpeed(contact), [&](auto i) { return Value(discs_[i].turn.speed); });
  }
  double SlidingAcceleration(const Contact& contact) const {
    return AlongSurface<kRotation>(in_, in_.candidates[contact.pair], PassingAcceleration(contact), [&](auto i) {
      return Value(discs_[i].turn.acceleration);
    });
  }

 private:
  using Row = typename ForceRows<T, kRotation>::Row;
  static constexpr bool kDerivatives = !std::is_same_v<T, double>;

  const T& FrictionOf(const Contact& contact) const { return in_.ContactOf(in_.candidates[contact.pair]).friction; }

  // Returns the difference of a vector of the two discs along the tangent; a wall's vector is zero.
  template <typename Of>
  double AlongTangent(const Contact& contact, const Of& of) const {
    const RestingContact& f = contact.force;
    return Dot(Perpendicular(f.normal), Vec2d(of(f.a) - (f.b >= 0 ? of(f.b) : Vec2d(0, 0))));
  }
  // Ends sliding. Discs that spin may go on rolling around each other, so only without spin the normal stops turning.
  static void EndSliding(RestingContact* force) {
    force->sliding = 0;
    if (kRotation != kSpin) force->turning = 0;
  }
  void Mark(int pair, char in_group) {
    const Candidate& c = in_.candidates[pair];
    has_pair_[pair] = in_group;
    if (!in_.bodies[c.a].fixed) has_disc_[c.a] = in_group;
    if (!c.plane && !in_.bodies[c.b].fixed) has_disc_[c.b] = in_group;
  }
  void Reset(int i) {
    acceleration_[i] = ValueOf(in_.Acceleration(i));
    if constexpr (kRotation == kSpin) turning_[i] = Value(in_.AngularAcceleration(i));
  }

  // Returns whether the discs jam, then for each contact the normal force, the tangential force and the acceleration
  // along its tangent; empty if there is no solution.
  std::pmr::vector<double> FindForces() {
    std::pmr::vector<double> found(in_.scratch);
    RestingForces result = TryForces();
    const bool jammed = result == RestingForces::kJammed;
    if (jammed) {
      for (Contact& contact : contacts_) EndSliding(&contact.force);
      result = TryForces();
    }
    if (result != RestingForces::kFound) return found;
    found.push_back(jammed);
    for (const RestingContact& force : forces_) {
      found.push_back(force.normal_force);
      found.push_back(force.tangential_force);
      const Vec2d a = acceleration_[force.a] - (force.b >= 0 ? acceleration_[force.b] : Vec2d(0, 0));
      found.push_back(Dot(Perpendicular(force.normal), a) - RimAcceleration(force, turning_));
    }
    return found;
  }

  RestingForces TryForces() {
    forces_.clear();
    for (const Contact& contact : contacts_) {
      const Candidate& c = in_.candidates[contact.pair];
      Reset(c.a);
      if (!c.plane) Reset(c.b);
      forces_.push_back(contact.force);
    }
    const bool many = forces_.size() > std::size_t{kMostDenseRows};
    return SolveRestingForces(rows_.inverse_mass(),
                              acceleration_,
                              forces_,
                              turning_,
                              iteration_limited_ && forces_.size() >= std::size_t{kManyDiscs},
                              many ? KeptFactors(in_.scratch) : nullptr);
  }

  void Measure(Contact* contact) const {
    const Candidate& c = in_.candidates[contact->pair];
    RestingContact& f = contact->force;
    const auto position = [&](int i) { return ValueOf(discs_[i].p); };
    const Separation<double> at =
        c.plane ? Separate<double>(position(c.a), in_.planes[c.b]) : Separate<double>(position(c.a), position(c.b));
    f.a = c.a;
    f.b = c.plane ? -1 : c.b;
    f.normal = at.normal;
    f.friction = Value(in_.ContactOf(c).friction);
    f.mass = Value(in_.EffectiveMass(c));
    if constexpr (kRotation == kSpin) {
      const auto turns = [&](int i) {
        return RestingContact::Turns{in_.bodies[i].radius, Value(in_.bodies[i].inverse_inertia)};
      };
      f.tangential_mass = Value(in_.TangentialMass(c));
      f.turns_a = turns(c.a);
      if (!c.plane) f.turns_b = turns(c.b);
    }
    const double sliding = SlidingSpeed(*contact);
    const bool at_rest = std::abs(sliding) <= kStickSpeed;
    const bool may_stick = at_rest && f.friction > 0;
    f.sliding = at_rest ? 0 : (sliding > 0) - (sliding < 0);
    const double turning = Value(CurvatureRadius(in_, c, T(at.distance)));
    contact->bends = !c.plane || turning != 0;
    const double passing = PassingSpeed(*contact);
    const bool turns = turning != 0 && (!may_stick || kRotation == kSpin);
    f.turning = turns ? passing * passing / turning : 0.0;
  }

  // Sets the state and mode of a contact from its forces. `along`: the acceleration along the tangent, m/s^2.
  static void Classify(double open, double along, Contact* contact) {
    RestingContact& f = contact->force;
    contact->closed = f.normal_force > open;
    if (!(f.friction > 0)) {
      contact->mode = ContactMode::kFrictionless;
      // The derivative with respect to friction exists only where the contact slides or begins to slide.
      if (f.sliding == 0) f.sliding = (along > kPushing) - (along < -kPushing);
      return;
    }
    const double bound = f.friction * f.normal_force;
    const bool sticks = f.sliding == 0 && std::abs(f.tangential_force) < bound * (1 - kAtBound);
    contact->mode = sticks ? ContactMode::kStick : ContactMode::kSlip;
    if (f.sliding == 0 && !sticks) f.sliding = f.tangential_force > 0 ? -1 : 1;
  }

  // Whether there is friction against sliding so slow that taking closing speeds away might reverse it.
  bool SlidesSlowly() const {
    return std::ranges::any_of(contacts_, [&](const Contact& contact) {
      return contact.closed && contact.mode == ContactMode::kSlip && contact.force.sliding != 0 &&
             std::abs(this->SlidingSpeed(contact)) <= kLargestSlowSpeed;
    });
  }
  // Makes the closed contacts stick that slide in the direction of their friction. Returns whether there are any.
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
  // Drops the derivatives of the violations, and undoes their values along normals and tangents, as they are rounding.
  void KeepValues() {
    for (Row& row : rows_) {
      row.violation = T(Value(row.violation));
      row.push = row.direction;
    }
  }
  void KeepDerivatives() {
    for (Row& row : rows_) row.violation -= Value(row.violation);
  }

  // Returns the tangential acceleration of the points of contact of a row by the angular accelerations of its discs.
  T TurningOf(const Row& row) const {
    T sum = in_.bodies[row.a].radius * discs_[row.a].turn.acceleration;
    if (row.b >= 0) sum += in_.bodies[row.b].radius * discs_[row.b].turn.acceleration;
    return sum;
  }
  // Changes the angular velocities by the impulses.
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
    if (const T turning = CurvatureRadius(in_, c, at.distance); contact.MayTurn() && Value(turning) != 0) {
      const T rate = Divide(Dot(tangent, RelativeVelocity<T>(c, [&](int i) { return discs_[i].v; })), turning);
      row.turning = Scale(rate, Vec2<T>(tangent - Scale(row.push_along, at.normal)));
    }
    rows_.Add(row);
  }
  // The distance that a sticking contact moves along its tangent when its gap is opened, as a multiple of the gap:
  // while it falls and bounces, no friction holds it. For a contact by itself; of several that stick there is no such
  // number, as it depends on which of them meets first.
  double DriftOf(const Contact& contact) const {
    const RestingContact& f = contact.force;
    const double restitution = Value(in_.ContactOf(in_.candidates[contact.pair]).restitution);
    if (contacts_.size() > 1 || f.mass == 0 || restitution >= 1) return 0;
    const auto given = [&](int i) { return ValueOf(in_.Acceleration(i)); };
    const Vec2d a = given(f.a) - (f.b >= 0 ? given(f.b) : Vec2d(0, 0));
    double tangential = Dot(Perpendicular(f.normal), a);
    if constexpr (kRotation == kSpin) {
      // The part that it yields by turning is no drift, which is measured beside the motion in which it rolls.
      const auto given_turn = [&](int i) { return Value(in_.AngularAcceleration(i)); };
      tangential = AlongSurface<kRotation>(in_, in_.candidates[contact.pair], tangential, given_turn);
      tangential *= f.tangential_mass / f.mass;
    }
    return DriftOfBounces(tangential, -Dot(f.normal, a) - f.turning, f.friction, restitution);
  }
  // Adds a row for an overlap, on values; for open contacts too: closing others must not make them overlap bit by bit.
  void AddOverlap(const Contact& contact) {
    const Candidate& c = in_.candidates[contact.pair];
    const Separation<T> at = SeparationOf(c);
    const double gap = Value(at.distance) - in_.ContactDistance(c);
    if (!MayMove(gap, contact) || std::abs(gap) <= kRoundingGap ||
        (!contact.closed && gap > -kOverlapOfOpen * kContactGap))
      return;
    rows_.Add({c.a, c.plane ? -1 : c.b, at.normal, at.normal, T(gap), T(0.0)});
  }

  T NormalVelocity(const Contact& contact) const {
    const Candidate& c = in_.candidates[contact.pair];
    return Dot(SeparationOf(c).normal, RelativeVelocity<T>(c, [&](int i) { return discs_[i].v; }));
  }
  // Marks the contacts that close though they have no force. Returns whether there is a new one.
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
    if (contact.stopped || (contact.mode != ContactMode::kStick && !jammed_)) return;
    const T sliding = AlongSurface<kRotation>(in_, c, T(Dot(tangent, w)), [&](auto i) { return discs_[i].turn.speed; });
    rows_.Add({c.a, b, tangent, tangent, sliding, T(0.0), T(1.0), T(1.0)});
  }

  void AddAccelerationRows(const Contact& contact, const T& sub_step) {
    const Candidate& c = in_.candidates[contact.pair];
    const RestingContact& f = contact.force;
    const T half = 0.5 * sub_step;
    const Separation<T> at = SeparationAt(in_, c, [&](int i) -> Vec2<T> {
      return discs_[i].p + Scale(half, Vec2<T>(discs_[i].v + Scale(half, discs_[i].a)));
    });
    const Vec2<T> tangent = Perpendicular(at.normal);
    const int b = c.plane ? -1 : c.b;
    T turning(0.0);
    const T distance = CurvatureRadius(in_, c, at.distance);
    if (contact.MayTurn() && Value(distance) != 0) {
      const Vec2<T> w = RelativeVelocity<T>(c, [&](int i) { return discs_[i].v; });
      if (Value(sub_step) > 0) {
        turning = Divide(T(2.0 * Dot(at.normal, w)), sub_step);
      } else {
        const T passing = Dot(tangent, w);
        turning = Divide(T(passing * passing), distance);
      }
    }
    if (contact.mode == ContactMode::kStick) {
      rows_.Add({c.a, b, at.normal, at.normal, turning, T(f.normal_force)});
      rows_.Add({c.a, b, tangent, tangent, T(0.0), T(f.tangential_force), T(1.0), T(1.0)});
      return;
    }
    const T share = FrictionOf(contact) * double(-f.sliding);
    const Vec2<T> push = at.normal + Scale(share, tangent);
    rows_.Add({c.a, b, at.normal, push, turning, T(f.normal_force), T(0.0), share});
  }

  // Sets accelerations and forces at the present positions and velocities. The forces are found first, then corrected:
  // the correction carries the derivatives where it is rounding.
  void FindAccelerations() {
    for (int pass = 0; pass < 2; ++pass) {
      SetAccelerations(T(0.0));
      std::size_t row = 0;
      for (Contact& contact : contacts_) {
        if (!contact.closed) continue;
        contact.force.normal_force += Value(rows_[row++].force);
        if (contact.mode == ContactMode::kStick) contact.force.tangential_force += Value(rows_[row++].force);
      }
    }
  }

  // Differences of position, velocity and acceleration from a motion of constant acceleration.
  template <typename V>
  struct Difference {
    V p, v, a;
  };
  struct Bent : Difference<Vec2<T>> {
    Bent() : Difference<Vec2<T>>{Zero(), Zero(), Zero()} {}
    static Vec2<T> Zero() { return {T(0.0), T(0.0)}; }
    Difference<T> turn{T(0.0), T(0.0), T(0.0)};
  };
  // Moves disc k of those that move to a stage, s after the start of a sub-step.
  void MoveToStage(int stage, double s, double length, std::size_t k) {
    const std::size_t n = moving_.size();
    Bent& bent = stages_[stage * n + k];
    const auto& row = cooper_verner::kRows[stage];
    for (int term = 0; term < row.count; ++term) {
      const Bent& before = stages_[row.terms[term].stage * n + k];
      const double factor = row.terms[term].factor * length;
      bent.p += Scale(factor, before.v);
      bent.v += Scale(factor, before.a);
      if constexpr (kRotation == kSpin) {
        bent.turn.p += factor * before.turn.v;
        bent.turn.v += factor * before.turn.a;
      }
    }
    const Disc& start = before_[k];
    Disc& disc = discs_[moving_[k]];
    disc.p = start.p + Scale(s, Vec2<T>(start.v + Scale(0.5 * s, start.a))) + bent.p;
    disc.v = start.v + Scale(s, start.a) + bent.v;
  }
  // Returns the terms of degree 3 to 5 with which a curve has these differences at the end of a sub-step.
  template <typename V, typename Scaled>
  const Curve<V>* KeepCurve(const Difference<V>& end, double h, const Scaled& times) const {
    Curve<V>* const curve = in_.template Array<Curve<V>>(1).data();
    const V p = end.p, v = times(h, end.v), a = times(h * h, end.a);
    (*curve)[0] = times(1 / (h * h * h), V(times(10.0, p) - times(4.0, v) + times(0.5, a)));
    (*curve)[1] = times(1 / (h * h * h * h), V(times(7.0, v) - times(15.0, p) - a));
    (*curve)[2] = times(1 / (h * h * h * h * h), V(times(6.0, p) - times(3.0, v) + times(0.5, a)));
    return curve;
  }

  const StepInput<T>& in_;
  std::span<Disc> discs_;
  bool jammed_ = false;  // sliding ends at once
  bool iteration_limited_ = false;
  std::pmr::vector<Contact> contacts_;
  std::pmr::vector<RestingContact> forces_;
  std::pmr::vector<Vec2d> acceleration_;        // per disc, values
  std::pmr::vector<double> turning_;            // angular accelerations, likewise; empty where discs do not spin
  std::pmr::vector<char> has_disc_, has_pair_;  // per disc that moves, per candidate: it is in the group
  ForceRows<T, kRotation> rows_;
  std::pmr::vector<Disc> before_;  // the discs before the contacts were closed, or at the start of a sub-step
  std::pmr::vector<int> moving_;   // discs of the group
  std::pmr::vector<Bent> stages_;  // of a Runge-Kutta step, by stage and disc
};

}  // namespace saltus::internal
