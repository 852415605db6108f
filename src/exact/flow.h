// The parts of the closed forms: real roots and minima of polynomials, parabolas, the impulse of a collision, and the
// time of a collision with its derivatives. Functions with derivatives are templates on the scalar T (double, or a
// ceres::Jet of any width).
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "exact/closed_forms.h"
#include "saltus/control/contact_sequence.h"
#include "saltus/scene/geometry.h"
#include "saltus/scene/scene.h"

namespace saltus::exact_internal {

// p(t) = sum_i p[i] t^i
using Polynomial = std::vector<double>;

double Evaluate(const Polynomial& p, double t);
Polynomial Derivative(const Polynomial& p);
Polynomial Multiply(const Polynomial& a, const Polynomial& b);
Polynomial Add(const Polynomial& a, const Polynomial& b);

// Returns where p changes sign in [low, high], in increasing order, and `low` and `high` if p is zero there. A root of
// even multiplicity inside the interval is not reported. The roots of p' come first: between them p is monotone.
std::vector<double> RootsBetween(const Polynomial& p, double low, double high);

double MinimumBetween(const Polynomial& p, double low, double high);

// Thresholds in natural units (scene/units.h), in which all closed forms compute.
inline constexpr double kTouching = 1e-12;  // the overlap that a valid scene may start with
inline constexpr double kGrazing = 1e-9;    // speed; slower approaches have no usable derivative

// Returns the message of ValidateStructure(); empty if the scene is valid.
inline std::string ValidateForClosedForm(const Scene& scene) {
  const std::optional<SceneError> error = ValidateStructure(scene);
  if (error) return "the scene is wrong: " + error->ToString();
  if (!scene.materials.empty()) return "the scene has materials: its contacts have several restitutions and frictions";
  const std::string beyond = NonBallisticFeatures(scene);
  return beyond.empty() ? "" : "the scene has " + beyond + "; the closed forms are of discs and planes";
}

// Returns std::nullopt, and sets the reason.
inline std::nullopt_t Refuse(std::string* reason_not_applicable, const std::string& reason) {
  if (reason_not_applicable != nullptr) *reason_not_applicable = reason;
  return std::nullopt;
}

template <typename T>
struct Motion {
  Vec2<T> position;
  Vec2<T> velocity;
};

template <typename T>
Motion<T> Cast(const Motion<double>& motion) {
  return {motion.position.template cast<T>(), motion.velocity.template cast<T>()};
}

// Returns `motion` after `time` under a constant acceleration.
template <typename T>
Motion<T> Fly(const Motion<T>& motion, const Vec2d& acceleration, const T& time) {
  const Vec2<T> gain = Scale(time, acceleration);
  return {motion.position + Scale(time, Vec2<T>(motion.velocity + Scale(T(0.5), gain))), motion.velocity + gain};
}

template <typename T>
struct ContactLaw {
  T restitution;
  T friction;
};

// Returns the impulse on the first of two bodies, N s, with the normal n towards it, the relative velocity w and the
// effective mass m.
template <typename T>
Vec2<T> Impulse(const ContactLaw<T>& law, const Vec2<T>& n, const Vec2<T>& w, double m,
                ExactEvent::Mode* mode = nullptr) {
  const Vec2<T> t = Perpendicular(n);
  const T sliding = Dot(t, w);
  const T normal = -(T(1) + law.restitution) * Dot(n, w) * m;
  const T bound = law.friction * normal;
  const bool frictionless = law.friction == T(0);
  const bool sticks = !frictionless && !(bound < m * SafeAbs(sliding));
  if (mode != nullptr) {
    *mode = frictionless ? ExactEvent::Mode::kFrictionless
            : sticks     ? ExactEvent::Mode::kStick
                         : ExactEvent::Mode::kSlip;
  }
  const T tangential = sticks ? -sliding * m : -bound * SignOf(sliding);
  return Scale(normal, n) + Scale(tangential, t);
}

// Returns when a point at height `gap` >= 0 with vertical velocity `speed` and acceleration `a` comes down to height 0,
// std::nullopt if never. From gap = 0 it must first rise. Neither form of the root subtracts near numbers.
template <typename T>
std::optional<T> FallTime(const T& gap, const T& speed, double a) {
  const T square = speed * speed - T(2 * a) * gap;
  if (!(square > T(0))) return std::nullopt;
  const T landing = SafeSqrt(square);
  if (speed > T(0)) {
    if (a >= 0) return std::nullopt;
    return (landing + speed) / T(-a);
  }
  return T(2) * gap / (landing - speed);
}

// Returns the constant acceleration of body i under the initial forces.
inline Vec2d InitialAcceleration(const Scene& scene, int i) {
  Vec2d acceleration = scene.gravity;
  for (int c = 0; c < scene.num_controlled(); ++c) {
    if (scene.control.bodies[c] == i) acceleration += scene.control.initial[c] / scene.bodies[i].mass;
  }
  return acceleration;
}

inline Motion<double> InitialMotion(const Scene& scene, int i) {
  return {scene.bodies[i].position, scene.bodies[i].velocity};
}

// Returns the mirror image of a disc's centre p behind a plane.
inline Vec2d Mirror(const Plane& plane, double radius, const Vec2d& p) {
  const Vec2d n = plane.normal.normalized();
  return p - 2 * (n.dot(p - plane.point) - radius) * n;
}

// Returns the terminal part of the loss.
template <typename T>
T TerminalLoss(const Objective& objective, const std::vector<Motion<T>>& final) {
  T loss(0);
  for (const TerminalTerm& term : objective.terminal) {
    const Motion<T>& motion = final[term.body];
    const Vec2<T>& q = term.quantity == TerminalTerm::Quantity::kPosition ? motion.position : motion.velocity;
    if (term.component) {
      loss += term.weight * q[*term.component];
    } else {
      const Vec2<T> error = q - term.target.template cast<T>();
      loss += term.weight * Dot(error, error);
    }
  }
  return loss;
}

// --- One disc among planes ---

// A sequence of impacts of the disc: the index of the plane of each.
using PlaneSequence = std::vector<int>;

// Returns the disc at the end of the scene if, from time `start` on, it strikes the planes of `hits` in this order and
// no others. The impacts may be after the end of the scene: the formulas are continued. Returns std::nullopt if it
// cannot reach a plane.
template <typename T>
std::optional<Motion<T>> FlyAlong(const Scene& scene, const ContactLaw<T>& law, const PlaneSequence& hits,
                                  Motion<T> disc, double start) {
  const Vec2d acceleration = InitialAcceleration(scene, 0);
  T time(start);
  for (const int hit : hits) {
    const Vec2d normal = scene.planes[hit].normal.normalized();
    const Vec2<T> n = normal.template cast<T>();
    const T gap =
        Dot(normal, Vec2<T>(disc.position - scene.planes[hit].point.template cast<T>())) - scene.bodies[0].radius;
    const std::optional<T> fall = FallTime(gap, T(Dot(normal, disc.velocity)), Dot(normal, acceleration));
    if (!fall) return std::nullopt;
    disc = Fly(disc, acceleration, *fall);
    disc.velocity += Impulse(law, n, disc.velocity, 1.0);  // per unit mass: a plane does not move
    time += *fall;
  }
  return Fly(disc, acceleration, T(T(scene.duration) - time));
}

// The path of the disc in simulation.
struct DiscPath {
  PlaneSequence hits;
  std::vector<ExactEvent> events;           // one per hit
  std::vector<Motion<double>> phase_start;  // at time 0 and just after each hit
};

// Follows the disc. Fails, with a reason, at corners, grazing or resting contacts, and after `kMostHits` impacts.
inline constexpr int kMostHits = 1000;
std::optional<DiscPath> FollowDisc(const Scene& scene, std::string* reason_not_applicable);

// --- Two discs ---

template <typename T>
struct DiscPair {
  Motion<T> first;
  Motion<T> second;
};

struct PairParameters {
  double contact_distance = 0;  // sum of the radii
  double mass_first = 1;
  double mass_second = 1;
  Vec2d acceleration_first = Vec2d::Zero();
  Vec2d acceleration_second = Vec2d::Zero();
};

template <typename T>
DiscPair<T> FlyBoth(const PairParameters& pair, const DiscPair<T>& discs, const T& time) {
  return {Fly(discs.first, pair.acceleration_first, time), Fly(discs.second, pair.acceleration_second, time)};
}

// Returns the pair `remaining` later, if the discs collide once, `guess` after the given state. That time must be exact
// as a value, so that one Newton step for the time of the collision gives exact derivatives.
template <typename T>
DiscPair<T> CollideOnce(const PairParameters& pair, const ContactLaw<T>& law, DiscPair<T> discs, double guess,
                        double remaining, ExactEvent::Mode* mode = nullptr) {
  discs = FlyBoth(pair, discs, T(guess));
  Vec2<T> d = discs.first.position - discs.second.position;
  Vec2<T> w = discs.first.velocity - discs.second.velocity;
  const T correction = -(Dot(d, d) - T(pair.contact_distance * pair.contact_distance)) / (T(2) * Dot(d, w));
  discs = FlyBoth(pair, discs, correction);
  d = discs.first.position - discs.second.position;
  w = discs.first.velocity - discs.second.velocity;
  const double m = 1 / (1 / pair.mass_first + 1 / pair.mass_second);
  const Vec2<T> impulse = Impulse(law, Quotient(d, Length(d)), w, m, mode);
  discs.first.velocity += Scale(1 / pair.mass_first, impulse);
  discs.second.velocity -= Scale(1 / pair.mass_second, impulse);
  return FlyBoth(pair, discs, T(T(remaining - guess) - correction));
}

}  // namespace saltus::exact_internal
