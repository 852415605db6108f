// Springs and dampers at the end of a step: what primal_descent and dual_descent solve, each in its own way (Macklin et
// al. 2020, "Primal/dual descent methods for dynamics"). Substeps of h_s = h / substeps; the unknown z of each is the
// new velocity of every disc:
//
//   r(z) = z - v_f - h_s M^-1 sum over contacts of (f_n n - f_t t) = 0,    v_f = v + h_s (u/m + g)
//   f_n  = k (-phi)^(exponent - 1) if phi < 0, else 0                      phi, n, t and the sliding speed w_t at the
//   f_t  = k_f w_t, within +-mu f_n                                        new state (p + h_s z, z)
//   p'   = p + h_s z
//
// k is such that the force of exponent 2, and that of others at the depth reference_depth, is that of the scene's
// stiffness. Damping and restitution are not read: what comes out is what implicit Euler leaves, elastic as the step
// goes to zero and plastic as the stiffness goes to infinity.
#pragma once

#include <Eigen/Dense>
#include <cmath>
#include <limits>
#include <memory_resource>
#include <string_view>
#include <type_traits>
#include <vector>

#include "contact/implicit.h"
#include "physics/power.h"
#include "saltus/contact/contact_model.h"

namespace saltus {

// One substep of some discs: a problem as implicit.h has it. Unknowns: [z_x z_y] of each disc.
template <typename T>
struct SpringStep {
  using Scalar = T;
  struct Disc {
    Vec2<T> q, free_velocity;  // before the substep; v_f
    T mass, inverse_mass;
    bool fixed;
  };
  struct Side {
    int a, b;  // discs; b < 0 at a plane
    Wall<double> plane;
    double touching;  // m, distance at which the gap is zero
  };
  // A contact at some velocities.
  struct At {
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
  T friction;       // mu
  std::vector<Disc> discs;
  std::vector<Side> contacts;

  int size() const { return 2 * static_cast<int>(discs.size()); }

  Vec2<T> VelocityOf(std::span<const T> z, int disc) const { return {z[2 * disc], z[2 * disc + 1]}; }
  Vec2<T> PositionOf(std::span<const T> z, int disc) const { return discs[disc].q + Scale(h, VelocityOf(z, disc)); }

  // Without forces.
  At Locate(std::span<const T> z, const Side& side) const {
    const Separation<T> s = side.b < 0 ? Separate<T>(PositionOf(z, side.a), side.plane)
                                       : Separate<T>(PositionOf(z, side.a), PositionOf(z, side.b));
    At at;
    at.normal = s.normal;
    at.tangent = Perpendicular(s.normal);
    at.depth = side.touching - s.distance;
    at.pressed = at.depth > 0.0;
    Vec2<T> w = VelocityOf(z, side.a);
    if (side.b >= 0) w -= VelocityOf(z, side.b);
    at.sliding = Dot(at.tangent, w);
    return at;
  }
  At Press(std::span<const T> z, const Side& side) const {
    At at = Locate(z, side);
    if (!at.pressed) return at;
    at.force = stiffness * Power(at.depth, exponent - 1);
    const T bound = friction * at.force;
    at.friction = drag * at.sliding;
    at.sticks = SafeAbs(at.friction) < bound;
    if (!at.sticks) at.friction = SignOf(at.sliding) * bound;
    return at;
  }

  void Residual(std::span<const T> z, std::span<T> F) const {
    for (std::size_t i = 0; i < discs.size(); ++i) {
      for (int j = 0; j < 2; ++j) F[2 * i + j] = z[2 * i + j] - discs[i].free_velocity[j];
    }
    for (const Side& side : contacts) {
      const At at = Press(z, side);
      if (!at.pressed) continue;
      const Vec2<T> push = Scale(at.force, at.normal) - Scale(at.friction, at.tangent);
      Apply(side, push, [&](int disc, const Vec2<T>& change) {
        for (int j = 0; j < 2; ++j) F[2 * disc + j] -= change[j];
      });
    }
  }
  // Calls apply(disc, change of velocity) for a force on disc a of a contact, and its opposite on disc b.
  template <typename Change>
  void Apply(const Side& side, const Vec2<T>& force, const Change& apply) const {
    apply(side.a, Scale(T(h * discs[side.a].inverse_mass), force));
    if (side.b >= 0) apply(side.b, Scale(T(-h * discs[side.b].inverse_mass), force));
  }

  template <typename U>
  SpringStep<U> Cast() const {
    const auto lift = [](const Vec2<T>& v) { return Vec2<U>(U(Value(v[0])), U(Value(v[1]))); };
    SpringStep<U> out{h, U(Value(stiffness)), exponent, drag, U(Value(friction)), {}, {}};
    for (const Disc& disc : discs) {
      out.discs.push_back(
          {lift(disc.q), lift(disc.free_velocity), U(Value(disc.mass)), U(Value(disc.inverse_mass)), disc.fixed});
    }
    for (const Side& side : contacts) out.contacts.push_back({side.a, side.b, side.plane, side.touching});
    return out;
  }
};

// Equal, with their derivatives.
inline bool Same(double a, double b) { return a == b; }
template <typename S, int W>
bool Same(const ceres::Jet<S, W>& a, const ceres::Jet<S, W>& b) {
  return a.a == b.a && a.v == b.v;
}
template <typename T>
bool Same(const Vec2<T>& a, const Vec2<T>& b) {
  return Same(a[0], b[0]) && Same(a[1], b[1]);
}

// Largest |r(z)|, m/s.
template <typename T>
double LargestResidual(const SpringStep<T>& problem, std::span<const T> z) {
  std::vector<T> F(z.size());
  problem.Residual(z, F);
  double largest = 0;
  for (const T& f : F) {
    if (!(std::abs(Value(f)) <= largest)) largest = std::abs(Value(f));  // a NaN stays one
  }
  return largest;
}

// What both models share: options, and substeps around the solution that each finds in its own way.
class SpringDescent {
 public:
  static constexpr int kRotation = 0;
  template <typename T>
  using State = BodyState<T, kRotation>;

  double kf = 1e3;  // N s/m
  int iterations = 20;
  double alpha = 1;
  int substeps = 10;
  bool implicit = false;
  double tolerance = 1e-6;  // m/s

  template <typename T, typename H>
  State<T> Free(const StepInput<T, H>& in, int i, const State<T>& x) const {
    State<T> next = x;
    for (int substep = 0; substep < substeps; ++substep) {
      next = SemiImplicitEuler<T>(SubstepLength(in), in.Acceleration(i), next);
    }
    return next;
  }

 protected:
  static constexpr double kReferenceDepth = 0.01;  // m

  template <typename Visit>
  void VisitSharedOptions(const Visit& visit) {
    visit(ModelOption{"kf", "of friction below its bound, N s/m", 1e-3, 1e12}, kf);
    visit(ModelOption{"iterations", "of a substep", 1, 1e6}, iterations);
    visit(ModelOption{"alpha", "length of an iteration", 1e-3, 1}, alpha);
    visit(ModelOption{"substeps", "of a step", 1, 1e4}, substeps);
    visit(ModelOption{"implicit", "1: derivative by the implicit function theorem, else through the iterations", 0, 1},
          implicit);
    visit(ModelOption{"tolerance", "largest residual that the iterations may leave, m/s", 1e-15, 1e3}, tolerance);
  }

  // descend(problem, z, touched) moves z from v_f to the solution, with any scalar, and marks in `touched` each contact
  // that has pushed on the way. `through`: derivatives pass through it.
  template <typename T, typename Descend>
  void StepBy(const StepInput<T>& in, double exponent, bool through, std::span<const State<T>> x,
              std::span<State<T>> next, const Descend& descend) const {
    SpringStep<T> problem = Pose(in, exponent, static_cast<int>(x.size()));
    std::copy(x.begin(), x.end(), next.begin());
    std::vector<char> reported(problem.contacts.size(), 0), touched(reported.size());
    for (int substep = 0; substep < substeps; ++substep) {
      for (std::size_t i = 0; i < x.size(); ++i) {
        problem.discs[i].q = next[i].p;
        problem.discs[i].free_velocity = next[i].v + Scale(problem.h, in.Acceleration(static_cast<int>(i)));
      }
      const std::vector<T> z =
          through ? Through(in, problem, descend, &touched) : AtEnd(in, problem, descend, &touched);
      for (std::size_t i = 0; i < x.size(); ++i) {
        next[i].v = problem.VelocityOf(z, static_cast<int>(i));
        next[i].p = problem.PositionOf(z, static_cast<int>(i));
      }
      Report<T>(in, problem, z, touched, &reported);
    }
  }

 private:
  template <typename T, typename H>
  H SubstepLength(const StepInput<T, H>& in) const {
    return in.h / Base<T>(substeps);
  }

  template <typename T>
  SpringStep<T> Pose(const StepInput<T>& in, double exponent, int num_discs) const {
    const T stiffness = in.contact.stiffness * std::pow(kReferenceDepth, 2 - exponent);
    SpringStep<T> problem{SubstepLength(in), stiffness, exponent, kf, in.contact.friction, {}, {}};
    for (int i = 0; i < num_discs; ++i) {
      problem.discs.push_back({{}, {}, in.bodies[i].mass, in.bodies[i].inverse_mass, in.bodies[i].fixed});
    }
    for (const Candidate& c : in.candidates) {
      problem.contacts.push_back(
          {c.a, c.plane ? -1 : c.b, c.plane ? in.planes[c.b] : Wall<double>{}, in.ContactDistance(c)});
    }
    return problem;
  }

  template <typename T>
  static std::vector<T> Start(const SpringStep<T>& problem) {
    std::vector<T> z;
    for (const auto& disc : problem.discs) z.insert(z.end(), {disc.free_velocity[0], disc.free_velocity[1]});
    return z;
  }

  // z, whose residual is to be small; else not a number.
  template <typename T>
  void Check(const StepInput<T>& in, double residual, std::span<T> z) const {
    if (residual <= tolerance) return;
    in.Fail("the iterations for implicit springs do not converge");
    for (T& entry : z) entry = T(std::numeric_limits<double>::quiet_NaN());
  }

  template <typename T, typename Descend>
  std::vector<T> Through(const StepInput<T>& in, const SpringStep<T>& problem, const Descend& descend,
                         std::vector<char>* touched) const {
    std::vector<T> z = Start(problem);
    std::fill(touched->begin(), touched->end(), 0);
    descend(problem, std::span<T>(z), std::span<char>(*touched));
    Check<T>(in, LargestResidual<T>(problem, z), z);
    return z;
  }

  // The solution of values, and its derivative by one Newton correction.
  template <typename T, typename Descend>
  std::vector<T> AtEnd(const StepInput<T>& in, const SpringStep<T>& problem, const Descend& descend,
                       std::vector<char>* touched) const {
    const SpringStep<double> values = problem.template Cast<double>();
    const std::span<const double> found = in.Solved([&] {
      std::vector<double> z = Start(values);
      std::fill(touched->begin(), touched->end(), 0);
      descend(values, std::span<double>(z), std::span<char>(*touched));
      const double residual = LargestResidual<double>(values, z);
      z.insert(z.end(), touched->begin(), touched->end());
      z.push_back(residual);
      return z;
    });
    std::copy_n(found.begin() + problem.size(), touched->size(), touched->begin());
    const Eigen::VectorXd z = Eigen::Map<const Eigen::VectorXd>(found.data(), problem.size());
    Eigen::MatrixXd jacobian;
    if constexpr (!std::is_same_v<T, double>) jacobian = LinearizeByUnknowns(values, z).jacobian;
    std::vector<T> solution = CorrectInT(problem, z, jacobian);
    Check<T>(in, found.back(), solution);
    return solution;
  }

  template <typename T>
  static void Report(const StepInput<T>& in, const SpringStep<T>& problem, std::span<const T> z,
                     const std::vector<char>& touched, std::vector<char>* reported) {
    for (std::size_t i = 0; i < touched.size(); ++i) {
      if (!touched[i] || (*reported)[i]) continue;
      (*reported)[i] = 1;
      in.Report(in.candidates[i],
                !(in.contact.friction > 0.0)                   ? ContactMode::kFrictionless
                : problem.Press(z, problem.contacts[i]).sticks ? ContactMode::kStick
                                                               : ContactMode::kSlip);
    }
  }
};

}  // namespace saltus
