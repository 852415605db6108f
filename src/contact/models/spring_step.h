// Springs and dampers at the end of a step: what primal_descent and dual_descent solve, each in its own way (Macklin et
// al. 2020, "Primal/dual descent methods for dynamics"). Substeps of h_s = h / substeps; the unknown z of each is the
// new velocity of every disc:
//
//   r(z) = z - v_f - h_s M^-1 sum over contacts of (f_n n - f_t t) = 0,    v_f = v + h_s (u/m + g)
//   f_n  = k (-phi)^(exponent - 1) if phi < 0, else 0                      phi, n, t and the sliding speed w_t at the
//   f_t  = k_f w_t, within +-mu f_n                                        new state (p + h_s z, z)
//   p'   = p + h_s z
//
// Of discs that spin the new angular velocities are unknowns too; friction acts at the points of contact, whose sliding
// speed w_t is, and turns the discs.
//
// k is such that the force of exponent 2, and that of others at the depth reference_depth, is that of the scene's
// stiffness. Damping and restitution are not read: what comes out is what implicit Euler leaves, elastic as the step
// goes to zero and plastic as the stiffness goes to infinity.
//
// The iterations of a model end near the solution. Newton's method takes the rest, so that the value is that of the
// equations, whose derivatives follow from the implicit function theorem. The iterations alone, with derivatives
// through each of them, are the published algorithm: implicit=0.
#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <limits>
#include <type_traits>
#include <vector>

#include "base/power.h"
#include "contact/models/disc_rotation.h"
#include "contact/solvers/implicit.h"
#include "saltus/contact/contact_model.h"

namespace saltus {

// One substep of some discs: a problem as implicit.h has it. Unknowns: [z_x z_y] of each disc, and with kTurn its
// angular velocity.
template <typename T, int kTurn>
struct SpringStep {
  using Scalar = T;
  static constexpr int kUnknowns = kTurn == kSpin ? 3 : 2;  // of a disc
  struct Disc {
    Vec2<T> q, free_velocity;  // before the substep; v_f
    T mass, inverse_mass;
    bool fixed;
    T free_spin = T(0.0), inverse_inertia = T(0.0);  // of discs that spin
    double radius = 0;
  };
  struct Side {
    int a, b;  // discs; b < 0 at a plane
    Wall<double> plane;
    double touching;  // m, distance at which the gap is zero
    T friction;       // mu
  };
  // A contact at some velocities.
  struct ContactPoint {
    bool pressed = false;
    Vec2<T> normal, tangent;
    T depth;              // m
    T sliding;            // m/s, w_t
    T force, friction;    // N, f_n and f_t
    bool sticks = false;  // |f_t| below its bound
  };

  double h;         // s
  T stiffness;      // N / m^(exponent - 1)
  double exponent;  // of the energy of a spring
  double drag;      // k_f, N s/m
  std::vector<Disc> discs;
  std::vector<Side> contacts;

  int size() const { return kUnknowns * static_cast<int>(discs.size()); }

  Vec2<T> VelocityOf(std::span<const T> z, int disc) const { return {z[kUnknowns * disc], z[kUnknowns * disc + 1]}; }
  Vec2<T> PositionOf(std::span<const T> z, int disc) const { return discs[disc].q + Scale(h, VelocityOf(z, disc)); }

  // Returns the geometry of a contact at the velocities z, without forces.
  ContactPoint Locate(std::span<const T> z, const Side& side) const {
    const Separation<T> s = side.b < 0 ? Separate<T>(PositionOf(z, side.a), side.plane)
                                       : Separate<T>(PositionOf(z, side.a), PositionOf(z, side.b));
    ContactPoint at;
    at.normal = s.normal;
    at.tangent = Perpendicular(s.normal);
    at.depth = side.touching - s.distance;
    at.pressed = at.depth > 0.0;
    Vec2<T> w = VelocityOf(z, side.a);
    if (side.b >= 0) w -= VelocityOf(z, side.b);
    at.sliding = Dot(at.tangent, w);
    if constexpr (kTurn == kSpin) {
      for (const int disc : {side.a, side.b}) {
        if (disc >= 0) at.sliding -= discs[disc].radius * z[kUnknowns * disc + 2];
      }
    }
    return at;
  }
  ContactPoint EvaluateContact(std::span<const T> z, const Side& side) const {
    ContactPoint at = Locate(z, side);
    if (!at.pressed) return at;
    at.force = stiffness * Power(at.depth, exponent - 1);
    const T bound = side.friction * at.force;
    at.friction = drag * at.sliding;
    at.sticks = SafeAbs(at.friction) < bound;
    if (!at.sticks) at.friction = SignOf(at.sliding) * bound;
    return at;
  }

  void Residual(std::span<const T> z, std::span<T> F) const {
    for (std::size_t i = 0; i < discs.size(); ++i) {
      const std::size_t at = kUnknowns * i;
      for (int j = 0; j < 2; ++j) F[at + j] = z[at + j] - discs[i].free_velocity[j];
      if constexpr (kTurn == kSpin) F[at + 2] = z[at + 2] - discs[i].free_spin;
    }
    for (const Side& side : contacts) {
      const ContactPoint at = EvaluateContact(z, side);
      if (!at.pressed) continue;
      const Vec2<T> push = Scale(at.force, at.normal) - Scale(at.friction, at.tangent);
      Apply(side, push, [&](int disc, const Vec2<T>& change) {
        for (int j = 0; j < 2; ++j) F[kUnknowns * disc + j] -= change[j];
      });
      if constexpr (kTurn == kSpin) {
        Turn(side, T(-at.friction), [&](int disc, const T& change) { F[kUnknowns * disc + 2] -= change; });
      }
    }
  }
  // Calls apply(disc, change of angular velocity) for a force along the tangent.
  template <typename Change>
  void Turn(const Side& side, const T& tangential, const Change& apply) const {
    for (const int disc : {side.a, side.b}) {
      if (disc >= 0) apply(disc, T(-h * tangential * discs[disc].radius * discs[disc].inverse_inertia));
    }
  }
  // Calls apply(disc, change of velocity) for a force on disc a of a contact, and its opposite on disc b.
  template <typename Change>
  void Apply(const Side& side, const Vec2<T>& force, const Change& apply) const {
    apply(side.a, Scale(T(h * discs[side.a].inverse_mass), force));
    if (side.b >= 0) apply(side.b, Scale(T(-h * discs[side.b].inverse_mass), force));
  }

  template <typename U>
  SpringStep<U, kTurn> Cast() const {
    const auto lift = [](const Vec2<T>& v) { return Vec2<U>(U(Value(v[0])), U(Value(v[1]))); };
    SpringStep<U, kTurn> out{h, U(Value(stiffness)), exponent, drag, {}, {}};
    for (const Disc& disc : discs) {
      out.discs.push_back({lift(disc.q),
                           lift(disc.free_velocity),
                           U(Value(disc.mass)),
                           U(Value(disc.inverse_mass)),
                           disc.fixed,
                           U(Value(disc.free_spin)),
                           U(Value(disc.inverse_inertia)),
                           disc.radius});
    }
    for (const Side& side : contacts) {
      out.contacts.push_back({side.a, side.b, side.plane, side.touching, U(Value(side.friction))});
    }
    return out;
  }
};

// Whether two numbers have the same bits, derivatives included (except for the sign of zeros).
template <typename T>
bool SameNumbers(const T& a, const T& b) {
  if constexpr (std::is_same_v<T, Base<T>>) {
    return a == b;
  } else {
    return a.a == b.a && a.v == b.v;
  }
}
template <typename T>
bool SameNumbers(std::span<const T> a, std::span<const T> b) {
  return std::equal(a.begin(), a.end(), b.begin(), b.end(), [](const T& x, const T& y) { return SameNumbers(x, y); });
}

// Returns the largest |r(z)|, m/s; the rotation of discs that spin counts with the speed of their rims.
template <typename T, int kTurn>
double LargestResidual(const SpringStep<T, kTurn>& problem, std::type_identity_t<std::span<const T>> z) {
  std::vector<T> F(z.size());
  problem.Residual(z, F);
  double largest = 0;
  for (std::size_t i = 0; i < F.size(); ++i) {
    constexpr int kUnknowns = SpringStep<T, kTurn>::kUnknowns;
    const double arm = i % kUnknowns == 2 ? problem.discs[i / kUnknowns].radius : 1;
    const double size = std::abs(Value(F[i])) * arm;
    if (!(size <= largest)) largest = size;  // a NaN stays one
  }
  return largest;
}

// The base of both models: options, and substeps around the solution that each finds in its own way.
template <int kTurn>
class SpringDescent : public SubstepFlight<kTurn, 10> {
  using Flight = SubstepFlight<kTurn, 10>;

 public:
  using Flight::substeps, Flight::SubstepLength;
  template <typename T>
  using State = BodyState<T, kTurn>;
  template <typename T>
  using Problem = SpringStep<T, kTurn>;

  double kf = 1e3;  // N s/m
  int iterations = 20;
  double alpha = 1;
  bool implicit = true;
  double tolerance = 1e-6;  // m/s

 protected:
  static constexpr double kReferenceDepth = 0.01;  // m
  static constexpr int kMostNewtonSteps = 60;
  static constexpr double kRounding = 1e-14;  // relative, of a residual

  template <typename Visit>
  void VisitSharedOptions(const Visit& visit) {
    visit(ModelOption{"kf", "friction coefficient below the bound of Coulomb, N s/m", 1e-3, 1e12}, kf);
    visit(ModelOption{"iterations", "iterations of a substep", 1, 1e6}, iterations);
    visit(ModelOption{"alpha", "step length of an iteration", 1e-3, 1}, alpha);
    visit(ModelOption{"substeps", "substeps of a step", 1, 1e4}, substeps);
    visit(ModelOption{"implicit",
                      "1: Newton's method after the iterations, derivatives of the solution; 0: the last iterate, "
                      "derivatives through the iterations, as published",
                      0,
                      1},
          implicit);
    visit(ModelOption{"tolerance", "largest accepted residual of a substep, m/s", 1e-15, 1e3}, tolerance);
  }

  // descend(problem, z, touched) moves z from v_f towards the solution, with any scalar, and marks in `touched` each
  // contact that has pushed on the way. `through`: it ends there, and derivatives pass through it; else Newton's method
  // follows.
  template <typename T, typename Descend>
  void StepBy(const StepInput<T>& in, double exponent, bool through, std::span<const State<T>> x,
              std::span<State<T>> next, const Descend& descend) const {
    Problem<T> problem = Pose(in, exponent, static_cast<int>(x.size()));
    std::copy(x.begin(), x.end(), next.begin());
    std::vector<char> reported(problem.contacts.size(), 0), touched(reported.size());
    for (int substep = 0; substep < substeps; ++substep) {
      for (std::size_t i = 0; i < x.size(); ++i) {
        problem.discs[i].q = next[i].p;
        problem.discs[i].free_velocity = next[i].v + Scale(problem.h, in.Acceleration(static_cast<int>(i)));
        if constexpr (kTurn == kSpin) {
          problem.discs[i].free_spin = next[i].rotation[1] + problem.h * in.AngularAcceleration(static_cast<int>(i));
        }
      }
      const std::vector<T> z = through ? DifferentiateThroughSteps(in, problem, descend, &touched)
                                       : DifferentiateAtSolution(in, problem, descend, &touched);
      for (std::size_t i = 0; i < x.size(); ++i) {
        next[i].v = problem.VelocityOf(z, static_cast<int>(i));
        next[i].p = problem.PositionOf(z, static_cast<int>(i));
        if constexpr (kTurn == kSpin) {
          next[i].rotation[1] = z[Problem<T>::kUnknowns * i + 2];
          next[i].rotation[0] += problem.h * next[i].rotation[1];
        }
      }
      Report<T>(in, problem, z, touched, &reported);
    }
  }

 private:
  template <typename T>
  Problem<T> Pose(const StepInput<T>& in, double exponent, int num_discs) const {
    const T stiffness = in.contact.stiffness * std::pow(kReferenceDepth, 2 - exponent);
    Problem<T> problem{SubstepLength(in), stiffness, exponent, kf, {}, {}};
    for (int i = 0; i < num_discs; ++i) {
      problem.discs.push_back({{}, {}, in.bodies[i].mass, in.bodies[i].inverse_mass, in.bodies[i].fixed});
      if constexpr (kTurn == kSpin) {
        problem.discs.back().inverse_inertia = in.bodies[i].inverse_inertia;
        problem.discs.back().radius = in.bodies[i].radius;
      }
    }
    for (const Candidate& c : in.candidates) {
      problem.contacts.push_back({c.a,
                                  c.plane ? -1 : c.b,
                                  c.plane ? in.planes[c.b] : Wall<double>{},
                                  in.ContactDistance(c),
                                  in.ContactOf(c).friction});
    }
    return problem;
  }

  template <typename T>
  static std::vector<T> Start(const Problem<T>& problem) {
    std::vector<T> z;
    for (const auto& disc : problem.discs) {
      z.insert(z.end(), {disc.free_velocity[0], disc.free_velocity[1]});
      if constexpr (kTurn == kSpin) z.push_back(disc.free_spin);
    }
    return z;
  }

  // Sets z to not a number unless its residual is at most `tolerance`.
  template <typename T>
  void Check(const StepInput<T>& in, double residual, std::span<T> z) const {
    if (residual <= tolerance) return;
    in.Fail("the iterations for implicit springs do not converge");
    for (T& entry : z) entry = T(std::numeric_limits<double>::quiet_NaN());
  }

  template <typename T, typename Descend>
  std::vector<T> DifferentiateThroughSteps(const StepInput<T>& in, const Problem<T>& problem, const Descend& descend,
                                           std::vector<char>* touched) const {
    std::vector<T> z = Start(problem);
    std::fill(touched->begin(), touched->end(), 0);
    descend(problem, std::span<T>(z), std::span<char>(*touched));
    Check<T>(in, LargestResidual(problem, z), z);
    return z;
  }

  // Solves r(z) = 0 by Newton's method; steps are halved until the residual falls.
  static void SolveByNewton(const Problem<double>& problem, std::span<double> z, std::span<char> touched) {
    Eigen::Map<Eigen::VectorXd> at(z.data(), z.size());
    double error = Mark(problem, z, touched);
    for (int step = 0; step < kMostNewtonSteps && error > kRounding * at.norm(); ++step) {
      const Linearized linear = LinearizeByUnknowns(problem, at);
      const Eigen::VectorXd start = at, change = SolveLu(linear.jacobian, -linear.residual);
      double length = 1, reached = error;
      for (; length > 1e-10; length *= 0.5) {
        at = start + length * change;
        reached = Mark(problem, z, touched);
        if (reached < error) break;
      }
      if (!(reached < error)) {
        at = start;  // to rounding
        return;
      }
      error = reached;
    }
  }

  // Returns |r(z)| and marks the contacts whose springs have a force at z.
  static double Mark(const Problem<double>& problem, std::span<const double> z, std::span<char> touched) {
    for (std::size_t c = 0; c < touched.size(); ++c) {
      if (problem.Locate(z, problem.contacts[c]).pressed) touched[c] = 1;
    }
    std::vector<double> F(z.size());
    problem.Residual(z, F);
    return Eigen::Map<const Eigen::VectorXd>(F.data(), F.size()).norm();
  }

  // Returns the solution, found on values, with its derivative by one Newton correction.
  template <typename T, typename Descend>
  std::vector<T> DifferentiateAtSolution(const StepInput<T>& in, const Problem<T>& problem, const Descend& descend,
                                         std::vector<char>* touched) const {
    const Problem<double> values = problem.template Cast<double>();
    const std::span<const double> found = in.Solved([&] {
      std::vector<double> z = Start(values);
      std::fill(touched->begin(), touched->end(), 0);
      descend(values, std::span<double>(z), std::span<char>(*touched));
      SolveByNewton(values, z, *touched);
      const double residual = LargestResidual(values, z);
      z.insert(z.end(), touched->begin(), touched->end());
      z.push_back(residual);
      return z;
    });
    std::copy_n(found.begin() + problem.size(), touched->size(), touched->begin());
    const Eigen::VectorXd z = Eigen::Map<const Eigen::VectorXd>(found.data(), problem.size());
    Eigen::MatrixXd jacobian;
    if constexpr (!std::is_same_v<T, double>) jacobian = LinearizeByUnknowns(values, z).jacobian;
    std::vector<T> solution = DifferentiableCorrection(problem, z, jacobian);
    Check<T>(in, found.back(), solution);
    return solution;
  }

  template <typename T>
  static void Report(const StepInput<T>& in, const Problem<T>& problem, std::span<const T> z,
                     const std::vector<char>& touched, std::vector<char>* reported) {
    for (std::size_t i = 0; i < touched.size(); ++i) {
      if (!touched[i] || (*reported)[i]) continue;
      (*reported)[i] = 1;
      const auto& side = problem.contacts[i];
      in.Report(in.candidates[i], ModeOf(side.friction > 0.0, problem.EvaluateContact(z, side).sticks));
    }
  }
};

}  // namespace saltus
