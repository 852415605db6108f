// Contact models that are a force for each pair of two discs, or of a disc and a wall.
//
//   struct Springs {
//     static constexpr auto kName = "springs";
//     double stiffness = 1e4;  // N/m
//     template <typename T>
//     saltus::Vec2<T> Force(const saltus::Meeting<T>& m) const {  // N, on the first disc
//       return m.gap < 0 ? saltus::Vec2<T>(-stiffness * m.gap * m.normal) : m.Zero();
//     }
//   };
//   saltus::Solve("ceres_lbfgs", {.scene = scene, .contact = saltus::ForceContact(Springs{.stiffness = 1e5})}, {});
//
// The opposite force acts on the second disc. Forces act at the centres: a model has no torque, and supports no scenes
// with discs that spin. Steps are semi-implicit Euler steps. Force is called for pairs that
// the broad phase takes for candidates, which need not include discs that do not overlap: a force at a distance needs
// the interface of contact/contact_model.h. A model that reads `friction` has `static constexpr bool kFriction = true`;
// others do not support scenes with friction.
#pragma once

#include <memory_resource>
#include <span>
#include <type_traits>
#include <utility>
#include <vector>

#include "saltus/simulate/user_contact.h"

namespace saltus {

// The data of a pair of two discs, or of a disc and a wall. T is double or a ceres::Jet.
template <typename T>
struct Meeting {
  T gap;                          // m, below zero where they overlap
  Vec2<T> normal;                 // unit vector, towards the first disc
  Vec2<T> velocity;               // m/s, of the first relative to the second
  T mass;                         // kg, 1 / (1/m_a + 1/m_b), with 0 for 1/m of a fixed disc or a wall
  ContactConstants<T> constants;  // restitution and friction of the two, stiffness and damping of the scene

  // Returns a force of zero.
  Vec2<T> Zero() const { return Vec2<T>(T(0.0), T(0.0)); }
};

// A contact model (contact/contact_model.h) from a struct with Force.
template <typename F>
struct ForceModel : F {
  static constexpr bool kReadsFriction = [] {
    if constexpr (requires { F::kFriction; }) return F::kFriction;
    return false;
  }();
  static constexpr ModelTraits kTraits = {.name = F::kName,
                                          .summary = "a force for each pair",
                                          .source = "a user's program",
                                          .friction = kReadsFriction,
                                          .compliant = true,
                                          .double_engine = true,
                                          .rebound = Rebound::kEmergent,
                                          .relative = true,
                                          .by_pair = true};
  static constexpr int kRotation = 0;
  template <typename T>
  using State = BodyState<T, kRotation>;

  template <typename T>
  State<T> Free(const StepInput<T>& in, int i, const State<T>& x) const {
    return SemiImplicitEuler(in, i, x);
  }
  template <typename T>
  void Step(const StepInput<T>& in, std::span<const State<T>> x, std::span<State<T>> next) const {
    std::pmr::vector<Vec2<T>> acceleration(in.scratch);
    acceleration.reserve(x.size());
    for (int i = 0; i < static_cast<int>(x.size()); ++i) acceleration.push_back(in.Acceleration(i));
    for (const Candidate& c : in.candidates) {
      const Separation<T> at = SeparationAt(in, c, [&](int i) -> const Vec2<T>& { return x[i].p; });
      const Meeting<T> meeting = {.gap = at.distance - in.ContactDistance(c),
                                  .normal = at.normal,
                                  .velocity = RelativeVelocity<T>(c, [&](int i) -> const Vec2<T>& { return x[i].v; }),
                                  .mass = in.EffectiveMass(c),
                                  .constants = {in.ContactOf(c), in.contact.stiffness, in.contact.damping}};
      const Vec2<T> force = F::Force(meeting);
      if (Value(force[0]) == 0 && Value(force[1]) == 0) continue;
      in.Report(c);
      ApplyImpulse(in, c, force, [&](int i, const Vec2<T>& change) { acceleration[i] += change; });
    }
    for (std::size_t i = 0; i < x.size(); ++i) next[i] = SemiImplicitEuler<T>(in.h, acceleration[i], x[i]);
  }
};

// Makes a contact model of a force, with the current values of its members.
template <typename F>
Contact ForceContact(F force) {
  return UserContact(ForceModel<F>{std::move(force)});
}

}  // namespace saltus
