// The contacts of a group of discs that press against each other and against planes, at one instant of the event-driven
// model (event.h): which of them press, stick or slip, decided on values (event_forces.h).
#pragma once

#include <algorithm>
#include <cmath>
#include <memory_resource>
#include <span>
#include <vector>

#include "contact/event/event_disc.h"
#include "contact/event/event_forces.h"

namespace saltus::internal {

template <typename T, int kRotation>
class PressedContacts {
 public:
  using Disc = EventDisc<T, kRotation>;
  struct Contact {
    int pair = 0;  // index of its candidate
    PressingContact force = {};
    ContactMode mode = ContactMode::kFrictionless;
    bool closed = false;
    bool stopped = false;  // not closed, but it closed slowly: that speed is taken away
    bool rests = false;    // it is not the last bounces that are cut off here
    bool drifts = false;   // its discs have moved around each other since it was last closed exactly
    bool rolled = false;   // they rolled: what they slide is drift, too
    bool bends = false;    // its normal turns as its discs move along each other
    // What sticks does not move along each other, unless it rolls.
    bool MayTurn() const { return mode != ContactMode::kStick || kRotation == kSpin; }
    bool Curved() const { return bends && MayTurn(); }
  };

  explicit PressedContacts(const StepInput<T>& in)
      : in_(in),
        contacts_(in.scratch),
        forces_(in.scratch),
        acceleration_(in.scratch),
        turning_(in.scratch),
        has_disc_(in.scratch),
        has_pair_(in.scratch) {}

  // The discs of the step, which the functions below read and change. They must stay where they are.
  void SetDiscs(std::span<Disc> discs) { discs_ = discs; }
  // Whether a step that fails is taken at once instead: forces of many contacts are then not looked for long.
  void SetInCrowd(bool in_crowd) { in_crowd_ = in_crowd; }
  // To be called before anything else.
  void Clear() {
    for (const Contact& contact : contacts_) Mark(contact.pair, 0);
    contacts_.clear();
    wedged_ = false;
    acceleration_.resize(discs_.size());
    if (kRotation == kSpin) turning_.resize(discs_.size());
    has_disc_.resize(discs_.size());
    has_pair_.resize(in_.candidates.size());
  }

  std::span<const Contact> contacts() const { return contacts_; }
  bool Contains(int pair) const { return has_pair_[pair]; }
  bool HasDisc(int i) const { return has_disc_[i]; }
  // Precondition: its discs have been moved to the instant of the group.
  void Add(int pair, bool drifts = false, bool rolled = false) {
    const Candidate& c = in_.candidates[pair];
    if (!HasDisc(c.a)) Reset(c.a);
    if (!c.plane && !HasDisc(c.b)) Reset(c.b);
    contacts_.push_back({.pair = pair, .drifts = drifts, .rolled = rolled});
    Mark(pair, 1);
  }
  void AddClosed(int pair, ContactMode mode, bool drifts) {
    contacts_.push_back({.pair = pair, .mode = mode, .closed = true, .drifts = drifts});
    Mark(pair, 1);
  }

  // The forces on values, and which contacts they close. False if they were not found. inverse_mass: per disc, 1/kg.
  bool SolveForces(std::span<const double> inverse_mass) {
    for (Contact& contact : contacts_) Measure(&contact);
    const std::span<const double> found = in_.Solved([&] { return FindForces(inverse_mass); });
    if (found.empty()) return false;
    wedged_ = found[0] != 0;
    double largest = 0;
    for (std::size_t k = 0; k < contacts_.size(); ++k) {
      PressingContact& force = contacts_[k].force;
      if (wedged_) EndSliding(&force);
      force.normal_force = found[1 + 3 * k];
      force.tangential_force = found[2 + 3 * k];
      largest = std::max(largest, force.normal_force);
    }
    for (std::size_t k = 0; k < contacts_.size(); ++k) {
      Classify(Value(in_.contact.friction), 1e-12 * largest, found[3 + 3 * k], &contacts_[k]);
    }
    return true;
  }

  // Whether discs roll around each other, or on what bends.
  bool RollsAround() const {
    return std::ranges::any_of(contacts_, [](const Contact& contact) {
      return contact.closed && contact.Curved() && contact.mode == ContactMode::kStick;
    });
  }

  // At which speed and acceleration the centres move along each other, as values: that turns the normal.
  double PassingSpeed(const Contact& contact) const {
    return AlongTangent(contact, [&](int i) { return ValueOf(discs_[i].v); });
  }
  double PassingAcceleration(const Contact& contact) const {
    return AlongTangent(contact, [&](int i) { return ValueOf(discs_[i].a); });
  }
  // The same of the points of contact: sliding speed of a contact and its rate of change.
  double SlidingSpeed(const Contact& contact) const {
    return AlongSurface<kRotation>(
        in_, in_.candidates[contact.pair], PassingSpeed(contact), [&](auto i) { return Value(discs_[i].turn.speed); });
  }
  double SlidingAcceleration(const Contact& contact) const {
    return AlongSurface<kRotation>(in_, in_.candidates[contact.pair], PassingAcceleration(contact), [&](auto i) {
      return Value(discs_[i].turn.acceleration);
    });
  }

 protected:
  static Vec2d ValueOf(const Vec2<T>& a) { return Vec2d(Value(a[0]), Value(a[1])); }

  const StepInput<T>& in_;
  std::span<Disc> discs_;
  bool wedged_ = false;  // sliding ends at once
  bool in_crowd_ = false;
  std::pmr::vector<Contact> contacts_;

 private:
  // Of the centres, given what each disc does.
  template <typename Of>
  double AlongTangent(const Contact& contact, const Of& of) const {
    const PressingContact& f = contact.force;
    return Dot(Perpendicular(f.normal), Vec2d(of(f.a) - (f.b >= 0 ? of(f.b) : Vec2d(0, 0))));
  }
  // What spins may go on rolling.
  static void EndSliding(PressingContact* force) {
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

  // Whether the discs wedge, and of each contact the normal and the tangential force and the acceleration along its
  // tangent; nothing if there is no solution.
  std::pmr::vector<double> FindForces(std::span<const double> inverse_mass) {
    std::pmr::vector<double> found(in_.scratch);
    Pressing pressing = TryForces(inverse_mass);
    const bool wedged = pressing == Pressing::kWedged;
    if (wedged) {
      for (Contact& contact : contacts_) EndSliding(&contact.force);
      pressing = TryForces(inverse_mass);
    }
    if (pressing != Pressing::kSolved) return found;
    found.push_back(wedged);
    for (const PressingContact& force : forces_) {
      found.push_back(force.normal_force);
      found.push_back(force.tangential_force);
      const Vec2d a = acceleration_[force.a] - (force.b >= 0 ? acceleration_[force.b] : Vec2d(0, 0));
      found.push_back(Dot(Perpendicular(force.normal), a) - RimAcceleration(force, turning_));
    }
    return found;
  }

  Pressing TryForces(std::span<const double> inverse_mass) {
    forces_.clear();
    for (const Contact& contact : contacts_) {
      const Candidate& c = in_.candidates[contact.pair];
      Reset(c.a);
      if (!c.plane) Reset(c.b);
      forces_.push_back(contact.force);
    }
    return SolvePressingForces(Value(in_.contact.friction),
                               inverse_mass,
                               acceleration_,
                               forces_,
                               turning_,
                               in_crowd_ && forces_.size() >= kCrowd);
  }

  void Measure(Contact* contact) const {
    const Candidate& c = in_.candidates[contact->pair];
    PressingContact& f = contact->force;
    const auto position = [&](int i) { return ValueOf(discs_[i].p); };
    const Separation<double> at =
        c.plane ? Separate<double>(position(c.a), in_.planes[c.b]) : Separate<double>(position(c.a), position(c.b));
    f.a = c.a;
    f.b = c.plane ? -1 : c.b;
    f.normal = at.normal;
    f.mass = Value(in_.EffectiveMass(c));
    if constexpr (kRotation == kSpin) {
      const auto turns = [&](int i) {
        return PressingContact::Turns{in_.bodies[i].radius, Value(in_.bodies[i].inverse_inertia)};
      };
      f.tangential_mass = Value(in_.TangentialMass(c));
      f.turns_a = turns(c.a);
      if (!c.plane) f.turns_b = turns(c.b);
    }
    const double sliding = SlidingSpeed(*contact);
    const bool at_rest = contact->rolled || std::abs(sliding) <= kStickSpeed;
    const bool may_stick = at_rest && Value(in_.contact.friction) > 0;
    f.sliding = at_rest ? 0 : (sliding > 0) - (sliding < 0);
    const double turning = Value(TurningDistance(in_, c, T(at.distance)));
    contact->bends = !c.plane || turning != 0;
    const double passing = PassingSpeed(*contact);
    const bool turns = turning != 0 && (!may_stick || kRotation == kSpin);
    f.turning = turns ? passing * passing / turning : 0.0;
  }

  // `along`: the acceleration along the tangent.
  static void Classify(double friction, double open, double along, Contact* contact) {
    PressingContact& f = contact->force;
    contact->closed = f.normal_force > open;
    if (!(friction > 0)) {
      contact->mode = ContactMode::kFrictionless;
      // By friction there is a derivative where it slides, or begins to.
      if (f.sliding == 0) f.sliding = (along > kPushing) - (along < -kPushing);
      return;
    }
    const double bound = friction * f.normal_force;
    const bool sticks = f.sliding == 0 && std::abs(f.tangential_force) < bound * (1 - 1e-12);
    contact->mode = sticks ? ContactMode::kStick : ContactMode::kSlip;
    if (f.sliding == 0 && !sticks) f.sliding = f.tangential_force > 0 ? -1 : 1;
  }

  std::pmr::vector<PressingContact> forces_;
  std::pmr::vector<Vec2d> acceleration_;        // per disc, values
  std::pmr::vector<double> turning_;            // angular acceleration, likewise; empty where discs do not spin
  std::pmr::vector<char> has_disc_, has_pair_;  // per disc that moves, per candidate: it is in the group
};

}  // namespace saltus::internal
