// The input of one step of a contact model: the discs, the candidates for contacts, and the report of contacts.
#pragma once

#include <algorithm>
#include <memory_resource>
#include <source_location>
#include <span>
#include <string_view>
#include <vector>

#include "saltus/contact/solve_record.h"
#include "saltus/scene/geometry.h"
#include "saltus/scene/materials.h"
#include "saltus/scene/walls.h"

namespace saltus {

// The rotation of a disc in models of scenes with discs that spin: angle, rad, and angular velocity, rad/s. For
// discs that cannot spin both are zero.
inline constexpr int kSpin = 2;

// State of one disc. A model that rotates discs has kRotation more numbers: angle and angular velocity if kRotation is
// kSpin, and otherwise numbers whose meaning the model defines.
template <typename T, int kRotation>
struct BodyState {
  static constexpr int kSize = 4 + kRotation;
  Vec2<T> p;  // position of the centre, m
  Vec2<T> v;  // velocity of the centre, m/s
  T rotation[kRotation];
};
template <typename T>
struct BodyState<T, 0> {
  static constexpr int kSize = 4;
  Vec2<T> p;
  Vec2<T> v;
};

template <typename T>
struct BodyConstants {
  T mass;          // kg; not used if fixed
  T inverse_mass;  // 1/kg; 0 if fixed
  Base<T> radius;  // m
  bool fixed = false;
  int material = 0;                   // 0: none; else 1 + the index into Scene::materials
  T inverse_inertia = T(Base<T>(0));  // 1/(kg m^2); 0 if it has no inertia in the scene
};

// Restitution and friction where two things touch.
template <typename T>
struct PairConstants {
  T restitution, friction;
};

// The numbers of ContactParameters, of which T may have derivatives.
template <typename T>
struct ContactConstants : PairConstants<T> {
  T stiffness, damping;
};

// A pair that may touch in this step: disc `a` and either disc `b` or, if `plane` is set, wall `b` of WallPartsOf()
// (walls.h). Normals point towards `a`, and impulses and relative velocities are those of `a`; a < b for two discs. At
// least one of the two is not fixed. Parts of edges are candidates if they count at the
// start of the step or, for event-driven models, if a disc may reach them within it.
struct Candidate {
  int a = 0;
  int b = 0;
  bool plane = false;
  friend bool operator==(const Candidate&, const Candidate&) = default;
};

// The mode of a contact. kPocketed: a disc has reached a pocket, and is out of play.
enum class ContactMode { kFrictionless, kSlip, kStick, kPocketed };
inline const char* ContactModeToString(ContactMode mode) {
  constexpr const char* kNames[] = {"frictionless", "slip", "stick", "pocketed"};
  return kNames[static_cast<int>(mode)];
}

// The kind of a contact. An impact changes velocities instantaneously; a sustained contact has a force over time; a
// grazing contact has a speed near zero, so that derivatives are one-sided.
enum class ContactKind { kImpact, kSustained, kGrazing };

// A contact that took effect in a step, as a model reports it.
struct Touch {
  Candidate candidate;
  ContactMode mode = ContactMode::kFrictionless;
  double time = -1;  // s, since the start of the step; -1 for models that resolve no times
  ContactKind kind = ContactKind::kImpact;
};

// A contact in a tie: simultaneous impacts that are connected through discs that move, and whose order changes the
// motion.
struct TiedContact {
  Candidate candidate;
  double time = 0;  // s, since the start of the step; of the first impact
  int tie = 0;      // number of the tie within the step
};

// One step of some discs. Index i is the same disc in `bodies`, `force` and the states. The length of the step is a
// number or, with H = T, a variable of differentiation.
template <typename T, typename H = Base<T>>
struct StepInput {
  using S = Base<T>;
  H h;                          // s, length of the step
  Vec2<S> gravity;              // m/s^2
  ContactConstants<T> contact;  // restitution and friction of pairs without a material; see ContactOf()
  std::span<const BodyConstants<T>> bodies;
  std::span<const Wall<S>> planes;           // the walls that Candidate::b indexes (walls.h)
  std::span<const Vec2<T>> force;            // N, on each disc, without gravity
  std::span<const Candidate> candidates;     // every pair that can touch: (a, b) of discs in rising order, then walls
  std::pmr::memory_resource* scratch;        // for temporaries; released after the step
  std::vector<Touch>* touches = nullptr;     // if set, the step appends the contacts that took effect
  SolveRecord* solved = nullptr;             // if set, the step recalls results of iterations from it
  std::string_view* failure = nullptr;       // if set, the step writes the reason why it has no result
  std::vector<TiedContact>* ties = nullptr;  // if set, event-driven models append ties
  int tie_order = 0;                         // the order in which they take tied impacts (event_ties.h); 0: their own
  // Extents of the walls, for event-driven models only.
  std::span<const WallExtent> extents = {};  // the region in which each wall counts, if given
  int table = -1;                            // index of the table that discs slide on; -1: none
  int first_pocket = 0, num_pockets = 0;     // the walls that are pockets
  S slowing = S(0);                          // deceleration on the table, m/s^2
  std::span<const T> torque = {};            // N m, on the discs; none if empty
  // Restitution and friction by MaterialPairIndex() (materials.h), if the scene has materials.
  std::span<const PairConstants<T>> pairs = {};

  // Returns the numbers that solve() returns (a container with data() and size()) or, in a repeated step, those that it
  // returned at this place before; valid until the end of the step. The numbers must not depend on derivatives.
  template <typename Solve>
  std::span<const double> Solved(const Solve& solve,
                                 const std::source_location& place = std::source_location::current()) const {
    const auto keep = [&](std::span<const double> numbers) {
      const std::span<double> kept = Array<double>(numbers.size());
      std::copy(numbers.begin(), numbers.end(), kept.begin());
      return kept;
    };
    if (solved != nullptr && solved->Has(place)) return keep(solved->Next());
    const auto& found = CallWithoutInlining(solve);
    const std::span<const double> numbers(found.data(), static_cast<std::size_t>(found.size()));
    if (solved != nullptr) solved->Append(place, numbers);
    return keep(numbers);
  }

  // Calls solve() without inlining it, because iterations are not differentiated.
  template <typename Solve>
  [[gnu::noinline]] static auto CallWithoutInlining(const Solve& solve) {
    return solve();
  }

  // Copies the scene from the same step in another scalar. Not copied are variables of differentiation (`contact`,
  // `pairs`, `bodies`, `force`, `torque`), reports (`touches`, `failure`, `ties`) and `tie_order`.
  template <typename U>
  void ShareScene(const StepInput<U>& in) {
    h = in.h;
    gravity = in.gravity;
    planes = in.planes;
    candidates = in.candidates;
    scratch = in.scratch;
    solved = in.solved;
    extents = in.extents;
    table = in.table;
    first_pocket = in.first_pocket;
    num_pockets = in.num_pockets;
    slowing = in.slowing;
  }

  // Returns uninitialized memory for n numbers, valid until the end of the step.
  template <typename U>
  std::span<U> Array(std::size_t n) const {
    return {static_cast<U*>(scratch->allocate(n * sizeof(U), alignof(U))), n};
  }

  // Reports a contact that took effect, if touches are collected; `time` in s since the start of the step.
  void Report(const Candidate& candidate, ContactMode mode = ContactMode::kFrictionless, double time = -1,
              ContactKind kind = ContactKind::kImpact) const {
    if (touches != nullptr) touches->push_back({candidate, mode, time, kind});
  }

  // Reports that the iterations of the step do not converge. The rollout then fails with this reason, which must be a
  // string literal. The step should leave NaN as its result, so that derivatives fail too.
  void Fail(std::string_view why) const {
    if (failure != nullptr && failure->empty()) *failure = why;
  }

  // Returns restitution and friction of a candidate. Stiffness and damping are the same for all.
  const PairConstants<T>& ContactOf(const Candidate& c) const { return ContactOfPair(PairOf(c)); }
  // Returns the index of a candidate's pair of materials among num_pairs().
  int PairOf(const Candidate& c) const {
    if (pairs.empty()) return 0;
    return MaterialPairIndex(bodies[c.a].material, c.plane ? planes[c.b].material : bodies[c.b].material);
  }
  // Returns restitution and friction of a pair of materials, and the number of pairs (1 without materials).
  const PairConstants<T>& ContactOfPair(int pair) const { return pairs.empty() ? contact : pairs[pair]; }
  int num_pairs() const { return pairs.empty() ? 1 : static_cast<int>(pairs.size()); }
  // Returns whether any candidate has friction.
  bool HasFriction() const {
    if (pairs.empty()) return Value(contact.friction) > S(0);
    return std::any_of(candidates.begin(), candidates.end(), [this](const Candidate& c) {
      return Value(ContactOf(c).friction) > S(0);
    });
  }

  // Returns the acceleration of disc i by force and gravity, m/s^2; zero if it is fixed.
  Vec2<T> Acceleration(int i) const {
    const BodyConstants<T>& body = bodies[i];
    if (body.fixed) return Vec2<T>(T(S(0)), T(S(0)));
    return {force[i][0] * body.inverse_mass + gravity[0], force[i][1] * body.inverse_mass + gravity[1]};
  }
  // Returns the angular acceleration of disc i by its torque, rad/s^2; zero if it does not spin.
  T AngularAcceleration(int i) const { return torque.empty() ? T(S(0)) : T(torque[i] * bodies[i].inverse_inertia); }
  bool IsPocket(const Candidate& c) const { return c.plane && c.b >= first_pocket && c.b < first_pocket + num_pockets; }
  // Returns the distance of the centres (or of centre and wall) at which the two touch, m; 0 for a pocket.
  S ContactDistance(const Candidate& c) const {
    if (num_pockets > 0 && IsPocket(c)) return S(0);
    return bodies[c.a].radius + (c.plane ? S(0) : bodies[c.b].radius);
  }
  T InverseMassA(const Candidate& c) const { return bodies[c.a].inverse_mass; }
  T InverseMassB(const Candidate& c) const { return c.plane ? T(S(0)) : bodies[c.b].inverse_mass; }
  // Returns the effective mass along the normal, kg: 1 / (1/m_a + 1/m_b), with 0 for 1/m of fixed discs and walls.
  T EffectiveMass(const Candidate& c) const { return Divide(S(1), T(InverseMassA(c) + InverseMassB(c))); }
  // Returns the effective mass along the tangent, kg: 1 / (1/m_a + 1/m_b + r_a^2/I_a + r_b^2/I_b).
  T TangentialMass(const Candidate& c) const {
    const auto turning = [&](int i) { return T(bodies[i].radius * bodies[i].radius * bodies[i].inverse_inertia); };
    T mobility = InverseMassA(c) + InverseMassB(c) + turning(c.a);
    if (!c.plane) mobility += turning(c.b);
    return Divide(S(1), mobility);
  }
};

// Returns distance and normal of a candidate, of discs whose centres are at `position(i)`. The gap is the distance less
// ContactDistance().
template <typename T, typename PositionOf>
Separation<T> SeparationAt(const StepInput<T>& in, const Candidate& c, const PositionOf& position) {
  if (c.plane) return Separate<T>(position(c.a), in.planes[c.b]);
  return Separate<T>(position(c.a), position(c.b));
}

// Returns the tangential distance over which the normal of a candidate rotates by one radian, m: positive around a
// convex wall or a disc, negative within an arc, and 0 along a line, whose normal is constant.
template <typename T>
T CurvatureRadius(const StepInput<T>& in, const Candidate& c, const T& distance) {
  using S = Base<T>;
  if (!c.plane) return distance;
  const Wall<S>& wall = in.planes[c.b];
  return wall.curved() ? T(distance + S(wall.side) * wall.radius) : T(S(0));
}

// Returns the velocity of the centre of a relative to that of b, or to a wall at rest; rotation is not included.
template <typename T, typename VelocityOf>
Vec2<T> RelativeVelocity(const Candidate& c, const VelocityOf& velocity) {
  if (c.plane) return velocity(c.a);
  return velocity(c.a) - velocity(c.b);
}

// Calls apply(i, change) with the change of the angular velocities of a and b by an impulse on a along the tangent t =
// Perpendicular(n): -tangential * r / I for both, because the arms and the impulses are opposite.
template <typename T, typename Apply>
void ApplyAngularImpulse(const StepInput<T>& in, const Candidate& c, const T& tangential, const Apply& apply) {
  const auto turn = [&](int i) { apply(i, T(-tangential * in.bodies[i].radius * in.bodies[i].inverse_inertia)); };
  turn(c.a);
  if (!c.plane) turn(c.b);
}

// Calls apply(i, change) with impulse / m_a for disc a and -impulse / m_b for disc b: the changes of their velocities
// by an impulse on a, or of their accelerations by a force on a.
template <typename T, typename Apply>
void ApplyImpulse(const StepInput<T>& in, const Candidate& c, const Vec2<T>& impulse, const Apply& apply) {
  apply(c.a, Scale(in.InverseMassA(c), impulse));
  if (!c.plane) apply(c.b, Scale(T(-in.InverseMassB(c)), impulse));
}

}  // namespace saltus
