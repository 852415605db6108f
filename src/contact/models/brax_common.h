// Functions that the two Brax models share (Brax 0.0.13: physics/colliders.py, bodies.py, math.py).
//
// A step of a model covers two integrator steps of h = in.h / 2. Every disc has moment of inertia 1 kg m^2, whatever
// its mass and radius; in scenes with discs that spin, that of the scene, and the others do not turn. Restitution and
// friction of two surfaces multiply: both are the squares of the scene's values. The spin w, rad/s, is positive
// clockwise: a point at r from the centre moves with (w r_y, -w r_x).
//
// Contact of a disc and a half-plane: p_c = p - r n, depth = (q - p_c) . n for a point q of its boundary. So too for
// ends of edges and arcs, which the source does not have.
// Contact of two discs: n = (p_a - p_b) / (D + eps), p_c = (p_a + p_b) / 2, depth = r_a + r_b - D, eps = 1e-6.
// They touch iff depth > 0. The eps terms are part of the published derivatives; none may be dropped.
#pragma once

#include <memory_resource>
#include <vector>

#include "saltus/contact/contact_model.h"

namespace saltus::brax {

// Regulariser of every normalisation, and of the quotients of the position-based model.
inline constexpr double kEpsilon = 1e-6;

// Returns |x|, or 0 without derivative if no entry exceeds 1e-8.
template <typename T>
T Norm(const Vec2<T>& x) {
  using S = Base<T>;
  if (SafeAbs(x[0]) <= S(1e-8) && SafeAbs(x[1]) <= S(1e-8)) return T(S(0));
  return Length(x);
}

// Returns x / (|x| + eps), given `norm` = Norm(x).
template <typename T>
Vec2<T> Direction(const Vec2<T>& x, const T& norm) {
  return Quotient(x, T(norm + Base<T>(kEpsilon)));
}

// Returns the smaller of two; at a tie with half of each derivative, as in the source's automatic differentiation.
template <typename T>
T HalfTieMin(const T& a, const T& b) {
  if (a < b) return a;
  if (b < a) return b;
  return Base<T>(0.5) * a + Base<T>(0.5) * b;
}

// Velocity of a point at `arm` from the centre due to spin.
template <typename T>
Vec2<T> SpinVelocity(const T& spin, const Vec2<T>& arm) {
  return {spin * arm[1], -(spin * arm[0])};
}

// Torque about the centre of a force at `arm`, in the sense of the spin.
template <typename T>
T Torque(const Vec2<T>& arm, const Vec2<T>& force) {
  return arm[1] * force[0] - arm[0] * force[1];
}

// Returns the inverse moment of inertia: the scene's with `of_scene`, else that of the source, 1 / (kg m^2).
template <bool spins, typename T>
auto InverseInertia(const BodyConstants<T>& body) {
  if constexpr (spins) {
    return body.inverse_inertia;
  } else {
    return Base<T>(body.fixed ? 0 : 1);
  }
}

// Returns the normal of a half-plane as Brax computes it: the upward direction turned by a quaternion, normalised in
// the arithmetic of the simulation. It differs from the given normal by rounding (in single precision a wall's is
// 1 + 2^-23 long), which is visible in published digits.
template <typename S>
Vec2<S> PlaneNormal(const Vec2<S>& normal) {
  S c, s;
  if (normal[1] >= S(0)) {
    c = std::sqrt((S(1) + normal[1]) / S(2));
    s = normal[0] / (S(2) * c);
  } else {
    s = std::copysign(std::sqrt((S(1) - normal[1]) / S(2)), normal[0]);
    c = normal[0] / (S(2) * s);
  }
  const S norm = std::sqrt(c * c + s * s);
  c /= norm;
  s /= norm;
  return {S(2) * (c * s), c * c - s * s};
}

template <typename T>
struct Contact {
  Candidate candidate;
  Vec2<T> normal;  // towards disc a; between discs a little shorter than 1
  Vec2<T> point;
  T depth;
};

// Returns the contact of a candidate for discs at `position(i)`. It touches iff depth > 0.
template <typename T, typename PositionOf>
Contact<T> ContactAt(const StepInput<T>& in, const Candidate& c, const PositionOf& position) {
  using S = Base<T>;
  const Vec2<T> a = position(c.a);
  if (c.plane && in.planes[c.b].curved()) {
    const Separation<T> at = Separate<T>(a, in.planes[c.b]);
    return {c, at.normal, a - Scale(in.bodies[c.a].radius, at.normal), in.bodies[c.a].radius - at.distance};
  }
  if (c.plane) {
    const Wall<S>& plane = in.planes[c.b];
    const Vec2<T> normal = PlaneNormal(plane.normal).template cast<T>();
    const Vec2<T> boundary = Scale(plane.offset, plane.normal).template cast<T>();
    const Vec2<T> point = a - Scale(in.bodies[c.a].radius, normal);
    return {c, normal, point, Dot(Vec2<T>(boundary - point), normal)};
  }
  const Vec2<T> b = position(c.b);
  const Vec2<T> d = a - b;
  const T distance = Norm(d);
  return {c, Direction(d, distance), Scale(S(0.5), Vec2<T>(a + b)), in.ContactDistance(c) - distance};
}

// Linear and angular contributions of the contacts of each disc. They are averaged, not added: divided by their number,
// plus a regulariser. A contribution that is exactly zero is not counted.
template <typename T>
class Averages {
 public:
  Averages(int num_discs, std::pmr::memory_resource* scratch) : sums_(num_discs, Sum{}, scratch) {}

  void Add(int disc, const Vec2<T>& linear, const T& angular) {
    if (linear[0] == T(0) && linear[1] == T(0)) return;
    Sum& sum = sums_[disc];
    sum.linear += linear;
    sum.angular += angular;
    ++sum.count;
  }

  // Calls apply(disc, linear, angular) for every disc that was contributed to; the others stay as they are.
  template <typename Apply>
  void ForEach(Base<T> regulariser, const Apply& apply) const {
    for (int i = 0; i < static_cast<int>(sums_.size()); ++i) {
      if (sums_[i].count == 0) continue;
      const Base<T> divisor = Base<T>(sums_[i].count) + regulariser;
      const Vec2<T>& linear = sums_[i].linear;
      apply(i, Vec2<T>(Divide(linear[0], divisor), Divide(linear[1], divisor)), T(Divide(sums_[i].angular, divisor)));
    }
  }

 private:
  struct Sum {
    Vec2<T> linear = Vec2<T>::Zero();
    T angular = T(Base<T>(0));
    int count = 0;
  };
  std::pmr::vector<Sum> sums_;
};

// Adds the contributions of a contact between discs in the states x: `push` moves disc a, `grip` turns it; disc b gets
// the opposite of both.
template <bool spins, typename T, typename States>
void AddPush(const StepInput<T>& in, const Contact<T>& contact, const States& x, const Vec2<T>& push,
             const Vec2<T>& grip, Averages<T>* sums) {
  const auto add = [&](int disc, const Vec2<T>& moved, const Vec2<T>& gripped) {
    const Vec2<T> arm = contact.point - x[disc].p;
    sums->Add(disc,
              Scale(in.bodies[disc].inverse_mass, moved),
              InverseInertia<spins>(in.bodies[disc]) * Torque(arm, gripped));
  };
  add(contact.candidate.a, push, grip);
  if (!contact.candidate.plane) add(contact.candidate.b, -push, -grip);
}

}  // namespace saltus::brax
