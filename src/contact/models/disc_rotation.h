// Free flight, and rotation of discs, for the models that step through time. Velocities in the equations of such a
// model are those of the points of contact, and impulses there change the angular velocities too.
//
// A model is written once, for states with spin and without (kTurn is kSpin or 0): where discs cannot spin, nothing is
// added to what it computes, to the last bit. t = Perpendicular(n), n towards disc a.
#pragma once

#include "saltus/contact/contact_model.h"

namespace saltus {

// Velocity and angular velocity of a disc, or changes of these.
template <typename T, int kTurn>
struct Twist {
  Vec2<T> v;  // m/s
  T w;        // rad/s
};
template <typename T>
struct Twist<T, 0> {
  Vec2<T> v;
};

template <typename T, int kTurn>
Twist<T, kTurn>& operator+=(Twist<T, kTurn>& to, const Twist<T, kTurn>& change) {
  to.v += change.v;
  if constexpr (kTurn == kSpin) to.w += change.w;
  return to;
}

// Returns velocity and angular velocity of a state.
template <typename T, int kTurn>
Twist<T, kTurn> TwistOf(const BodyState<T, kTurn>& x) {
  if constexpr (kTurn == kSpin) {
    return {x.v, x.rotation[1]};
  } else {
    return {x.v};
  }
}

// Returns the accelerations of disc i by force, torque and gravity.
template <int kTurn, typename T, typename H>
Twist<T, kTurn> AccelerationOf(const StepInput<T, H>& in, int i) {
  if constexpr (kTurn == kSpin) {
    return {in.Acceleration(i), in.AngularAcceleration(i)};
  } else {
    return {in.Acceleration(i)};
  }
}

// Adds `change` times the time `h`, s, to the velocities.
template <typename T, int kTurn, typename H>
void Accelerate(const H& h, const Twist<T, kTurn>& change, BodyState<T, kTurn>* x) {
  x->v += Scale(h, change.v);
  if constexpr (kTurn == kSpin) x->rotation[1] += h * change.w;
}

// Moves a disc with its velocities for the time `h`, s.
template <typename T, int kTurn, typename H>
void Drift(const H& h, BodyState<T, kTurn>* x) {
  x->p += Scale(h, x->v);
  if constexpr (kTurn == kSpin) x->rotation[0] += h * x->rotation[1];
}

// Adds `change` to the velocities.
template <typename T, int kTurn>
void Kick(const Twist<T, kTurn>& change, BodyState<T, kTurn>* x) {
  x->v += change.v;
  if constexpr (kTurn == kSpin) x->rotation[1] += change.w;
}
// Adds `change` to the velocities and, times `lever`, s, to position and angle.
template <typename T, int kTurn, typename H>
void Kick(const Twist<T, kTurn>& change, const H& lever, BodyState<T, kTurn>* x) {
  x->v += change.v;
  x->p += Scale(lever, change.v);
  if constexpr (kTurn == kSpin) {
    x->rotation[1] += change.w;
    x->rotation[0] += lever * change.w;
  }
}

// A semi-implicit Euler step, as in integrators.h.
template <typename T, int kTurn, typename H>
BodyState<T, kTurn> SemiImplicitEuler(const H& h, const Twist<T, kTurn>& acceleration, const BodyState<T, kTurn>& x) {
  if constexpr (kTurn == kSpin) {
    BodyState<T, kSpin> next = x;
    Accelerate(h, acceleration, &next);
    Drift(h, &next);
    return next;
  } else {
    return SemiImplicitEuler<T>(h, acceleration.v, x);
  }
}
template <typename T, typename H>
BodyState<T, kSpin> SemiImplicitEuler(const StepInput<T, H>& in, int i, const BodyState<T, kSpin>& x) {
  return SemiImplicitEuler(in.h, AccelerationOf<kSpin>(in, i), x);
}

// The base of a model whose discs fly by a semi-implicit Euler step.
template <int kTurn>
struct SemiImplicitFlight {
  static constexpr int kRotation = kTurn;
  static constexpr bool kLinearRotation = kTurn == kSpin;

  template <typename T, typename H>
  BodyState<T, kTurn> Free(const StepInput<T, H>& in, int i, const BodyState<T, kTurn>& x) const {
    return SemiImplicitEuler(in, i, x);
  }
};

// The base of a model whose discs fly by several such steps.
template <int kTurn, int kDefaultSubsteps>
struct SubstepFlight {
  static constexpr int kRotation = kTurn;
  static constexpr bool kLinearRotation = kTurn == kSpin;

  int substeps = kDefaultSubsteps;

  template <typename T, typename H>
  H SubstepLength(const StepInput<T, H>& in) const {
    return in.h / Base<T>(substeps);
  }

  template <typename T, typename H>
  BodyState<T, kTurn> Free(const StepInput<T, H>& in, int i, const BodyState<T, kTurn>& x) const {
    BodyState<T, kTurn> next = x;
    for (int substep = 0; substep < substeps; ++substep) {
      next = SemiImplicitEuler(SubstepLength(in), AccelerationOf<kTurn>(in, i), next);
    }
    return next;
  }
};

// The base of a model whose discs fly by an explicit step: the position with the velocity before.
template <int kTurn>
struct ExplicitFlight {
  static constexpr int kRotation = kTurn;
  static constexpr bool kLinearRotation = kTurn == kSpin;

  template <typename T, typename H>
  BodyState<T, kTurn> Free(const StepInput<T, H>& in, int i, const BodyState<T, kTurn>& x) const {
    BodyState<T, kTurn> next;
    next.v = x.v + Scale(in.h, in.Acceleration(i));
    next.p = x.p + Scale(in.h, x.v);
    if constexpr (kTurn == kSpin) {
      next.rotation[1] = x.rotation[1] + in.h * in.AngularAcceleration(i);
      next.rotation[0] = x.rotation[0] + in.h * x.rotation[1];
    }
    return next;
  }
};

// The mode of a contact that pushes.
inline ContactMode ModeOf(bool has_friction, bool sticks) {
  return !has_friction ? ContactMode::kFrictionless : sticks ? ContactMode::kStick : ContactMode::kSlip;
}

// Returns the velocity (or displacement) along t of a's point of contact relative to b's by the rotation turn(i).
template <typename T, typename TurnOf>
T AlongByTurning(const StepInput<T>& in, const Candidate& c, const TurnOf& turn) {
  T along = -in.bodies[c.a].radius * turn(c.a);
  if (!c.plane) along -= in.bodies[c.b].radius * turn(c.b);
  return along;
}

// Returns the velocity of a's point of contact relative to b's when disc i has the twist twist(i).
template <int kTurn, typename T, typename TwistOfDisc>
Vec2<T> ContactVelocity(const StepInput<T>& in, const Candidate& c, const Vec2<T>& n, const TwistOfDisc& twist) {
  Vec2<T> w = RelativeVelocity<T>(c, [&](int i) -> Vec2<T> { return twist(i).v; });
  if constexpr (kTurn == kSpin) {
    w += Scale(AlongByTurning(in, c, [&](int i) -> T { return twist(i).w; }), Perpendicular(n));
  }
  return w;
}

// Returns the effective mass along t, kg.
template <int kTurn, typename T>
T SlidingMass(const StepInput<T>& in, const Candidate& c) {
  if constexpr (kTurn == kSpin) {
    return in.TangentialMass(c);
  } else {
    return in.EffectiveMass(c);
  }
}

// Calls apply(i, change of its twist) for both discs of an impulse on disc a at the point of contact.
template <int kTurn, typename T, typename Apply>
void PushContact(const StepInput<T>& in, const Candidate& c, const Vec2<T>& n, const Vec2<T>& impulse,
                 const Apply& apply) {
  if constexpr (kTurn == kSpin) {
    const T tangential = Dot(Perpendicular(n), impulse);
    ApplyImpulse(in, c, impulse, [&](int i, const Vec2<T>& dv) {
      apply(i, Twist<T, kSpin>{dv, T(-tangential * in.bodies[i].radius * in.bodies[i].inverse_inertia)});
    });
  } else {
    ApplyImpulse(in, c, impulse, [&](int i, const Vec2<T>& dv) { apply(i, Twist<T, 0>{dv}); });
  }
}

// A model without friction in scenes with discs that spin: only torques change the spin, and the spin changes nothing
// else.
template <typename M>
struct SpinsFreely : M {
  static constexpr int kRotation = kSpin;
  static constexpr bool kLinearRotation = true;
  template <typename T>
  using State = BodyState<T, kSpin>;

  template <typename T, typename H>
  State<T> Free(const StepInput<T, H>& in, int i, const State<T>& x) const {
    return Join(in, i, x, M::Free(in, i, BodyState<T, 0>{x.p, x.v}));
  }

  template <typename T>
  void Step(const StepInput<T>& in, std::span<const State<T>> x, std::span<State<T>> next) const {
    const std::span<BodyState<T, 0>> from = in.template Array<BodyState<T, 0>>(x.size()),
                                     to = in.template Array<BodyState<T, 0>>(x.size());
    for (std::size_t i = 0; i < x.size(); ++i) from[i] = {x[i].p, x[i].v};
    M::Step(in, std::span<const BodyState<T, 0>>(from), to);
    for (std::size_t i = 0; i < x.size(); ++i) next[i] = Join(in, static_cast<int>(i), x[i], to[i]);
  }

 private:
  template <typename T, typename H>
  static State<T> Join(const StepInput<T, H>& in, int i, const State<T>& x, const BodyState<T, 0>& moved) {
    const T spin = x.rotation[1] + in.h * in.AngularAcceleration(i);
    return {moved.p, moved.v, {x.rotation[0] + in.h * spin, spin}};
  }
};

}  // namespace saltus
