// Incremental potential contact: every substep minimises an energy with a barrier that keeps gaps positive (Li et al.
// 2020, "Incremental Potential Contact").
//
// With h_s = h / substeps, q and v at the start of a substep, a = u/m + g, and gaps g_c and displacements d_c = t . (x
// - q)_rel along the tangents at q, the new positions x minimise
//
//   E(x) = 1/2 |x - x^|^2_M + w [kappa sum of b(g_c(x))] + w_f [mu sum of l_c f(|d_c|)]
//   b(g) = -(g - range)^2 ln(g / range) for g < range, else 0            twice differentiable
//   f'(y) = y/e (2 - y/e) for y < e = slip_speed h_s, else 1             smoothed Coulomb friction
//   l_c  = -kappa b'(g_c(q))                                             normal force at the start: lagged
//
//   implicit Euler:   x^ = q + h_s v + h_s^2 a,                          w = w_f = h_s^2,        v' = (x - q) / h_s
//   trapezoidal:      x^ = q + h_s v + h_s^2/2 a + w M^-1 (barrier force at q),
//                     w = h_s^2/4, w_f = h_s^2/2,                        v' = 2 (x - q) / h_s - v
//
// Newton's method from q with a positive definite Hessian and a line search that stops short of any contact along the
// step, so no gap ever closes. Derivatives: one Newton correction with the exact Hessian, lagged terms included.
//
// Of discs that spin d_c is the way of the points of contact along each other, and E has the ways r dtheta of their
// rims too, with masses I/r^2.
//
// There is no restitution parameter: what comes out depends on the integrator and the substeps; implicit Euler damps,
// to a plastic impact in the stiff limit, and as the step goes to zero it becomes elastic. Bodies rebound up to `range`
// before they touch. A scene in which bodies touch from the start has no finite energy. A substep that does not
// converge is not a number. Momentum is conserved.
#pragma once

#include <Eigen/Core>
#include <cmath>
#include <limits>
#include <memory_resource>
#include <string>
#include <vector>

#include "contact/models/contact_rows.h"
#include "contact/solvers/implicit.h"
#include "saltus/contact/contact_model.h"

namespace saltus {

namespace internal {

// E of one group of discs, and its gradient. Unknowns: the positions of its moving discs, and the ways of the rims of
// those that spin, from q on.
template <typename T>
struct BarrierEnergy {
  using Scalar = T;
  struct Disc {
    Vec2<T> q, target;  // x^
    T mass;
    int unknown;                               // index of x_x; -1 if fixed
    int rim = -1;                              // index of the way of its rim, r times the angle; -1 if it does not spin
    T rim_target = T(0.0), rim_mass = T(0.0);  // m, without contact; I / r^2, kg
  };
  struct Side {
    int a, b;  // discs; b < 0 at a plane
    Wall<double> plane;
    double touching;  // m, distance at which the gap is zero
    Vec2<T> tangent;  // at q
    T friction;       // mu l_c, N
  };

  double kappa, range, slip;               // N/m, m, m
  double barrier_weight, friction_weight;  // s^2
  std::vector<Disc> discs;
  std::vector<Side> contacts;
  int num_unknowns = 0;

  int size() const { return num_unknowns; }

  Vec2<T> Position(std::span<const T> x, int disc) const {
    const int unknown = discs[disc].unknown;
    return unknown < 0 ? discs[disc].q : Vec2<T>(x[unknown], x[unknown + 1]);
  }
  Separation<T> SeparationAt(std::span<const T> x, const Side& side) const {
    if (side.b < 0) return Separate<T>(Position(x, side.a), side.plane);
    return Separate<T>(Position(x, side.a), Position(x, side.b));
  }
  // Returns the tangential displacement of a relative to b, m.
  T Slid(std::span<const T> x, const Side& side) const {
    Vec2<T> moved = Position(x, side.a) - discs[side.a].q;
    if (side.b >= 0) moved -= Position(x, side.b) - discs[side.b].q;
    T slid = Dot(side.tangent, moved);
    for (const int disc : {side.a, side.b}) {
      if (disc >= 0 && discs[disc].rim >= 0) slid -= x[discs[disc].rim];
    }
    return slid;
  }

  // The gradient of E.
  void Residual(std::span<const T> x, std::span<T> F) const {
    for (const Disc& disc : discs) {
      if (disc.unknown < 0) continue;
      for (int j = 0; j < 2; ++j) F[disc.unknown + j] = disc.mass * (x[disc.unknown + j] - disc.target[j]);
      if (disc.rim >= 0) F[disc.rim] = disc.rim_mass * (x[disc.rim] - disc.rim_target);
    }
    for (const Side& side : contacts) {
      const Separation<T> at = SeparationAt(x, side);
      Vec2<T> pull = Scale(T(barrier_weight * kappa * BarrierSlope(T(at.distance - side.touching), range)), at.normal);
      if (Value(side.friction) > 0) {
        const T slid = Slid(x, side);
        const T y = MinOf(Divide(SafeAbs(slid), slip), T(1.0));
        const T rub = friction_weight * SignOf(slid) * side.friction * y * (2.0 - y);
        pull += Scale(rub, side.tangent);
        for (const int disc : {side.a, side.b}) {
          if (disc >= 0 && discs[disc].rim >= 0) F[discs[disc].rim] -= rub;
        }
      }
      for (const int disc : {side.a, side.b}) {
        if (disc < 0 || discs[disc].unknown < 0) continue;
        for (int j = 0; j < 2; ++j) F[discs[disc].unknown + j] += disc == side.a ? pull[j] : T(-pull[j]);
      }
    }
  }

  // Returns the energy E, J; infinite where a gap is closed.
  double Energy(std::span<const double> x) const {
    double energy = 0;
    for (const Disc& disc : discs) {
      if (disc.unknown < 0) continue;
      for (int j = 0; j < 2; ++j) energy += 0.5 * disc.mass * std::pow(x[disc.unknown + j] - disc.target[j], 2);
      if (disc.rim >= 0) energy += 0.5 * disc.rim_mass * std::pow(x[disc.rim] - disc.rim_target, 2);
    }
    for (const Side& side : contacts) {
      const double gap = SeparationAt(x, side).distance - side.touching;
      if (!(gap > 0)) return HUGE_VAL;
      if (gap < range) energy -= barrier_weight * kappa * (gap - range) * (gap - range) * std::log(gap / range);
      const double y = std::abs(Slid(x, side));
      const double mollified = y < slip ? y * y * (1 - y / (3 * slip)) / slip + slip / 3 : y;
      energy += friction_weight * side.friction * mollified;
    }
    return energy;
  }

  // Returns the derivative of the barrier, b'.
  static T BarrierSlope(const T& gap, double range) {
    using std::log;
    if (!(gap < range)) return T(0.0);
    const T ratio = Divide(gap, range);
    return (range - gap) * (2.0 * log(ratio) - Divide(1.0, ratio) + 1.0);
  }

  template <typename U>
  BarrierEnergy<U> Cast() const {
    const auto number = [](const T& x) { return U(Value(x)); };
    const auto vector = [&](const Vec2<T>& x) { return Vec2<U>(number(x[0]), number(x[1])); };
    BarrierEnergy<U> out{kappa, range, slip, barrier_weight, friction_weight, {}, {}, num_unknowns};
    for (const Disc& d : discs) {
      out.discs.push_back(
          {vector(d.q), vector(d.target), number(d.mass), d.unknown, d.rim, number(d.rim_target), number(d.rim_mass)});
    }
    for (const Side& s : contacts) {
      out.contacts.push_back({s.a, s.b, s.plane, s.touching, vector(s.tangent), number(s.friction)});
    }
    return out;
  }
};

// Finds the minimiser of E, starting from x. Returns false if it is not reached.
bool MinimizeBarrierEnergy(const BarrierEnergy<double>& energy, Eigen::VectorXd* x);

// Returns the reason why a barrier cannot be used in a scene (bodies touch at the start); empty if it can.
std::string UnsupportedByBarrier(const Scene& scene);

// Whether no pair comes within `range` of contact on the straight line from q to the targets.
bool StaysBeyondRange(const BarrierEnergy<double>& energy);

}  // namespace internal

template <int kTurn>
struct IpcBarrierOf {
  static constexpr double kRange = 0.01;  // m
  static constexpr ModelTraits kTraits = {.name = "ipc_barrier",
                                          .summary = "logarithmic barrier, implicit substeps, lagged friction",
                                          .source = "IPC (Li et al. 2020)",
                                          .compliant = true,
                                          .double_engine = true,
                                          .chains = true,
                                          .rebound = Rebound::kEmergent,
                                          .push_gap = kRange,
                                          .allocates = true,
                                          .relative = true,
                                          .by_pair = true};
  static constexpr int kRotation = kTurn;
  static constexpr bool kLinearRotation = kTurn == kSpin;
  template <typename T>
  using State = BodyState<T, kRotation>;
  template <typename T>
  using Group = ContactGroup<T, kTurn>;

  double range = kRange;     // m, at most kRange
  double kappa = 1e5;        // N/m
  double slip_speed = 1e-3;  // m/s
  int substeps = 10;
  bool trapezoidal = false;
  template <typename Visit>
  void VisitOptions(const Visit& visit) {
    visit(ModelOption{"range", "gap below which the barrier acts, m", 1e-6, kRange}, range);
    visit(ModelOption{"kappa", "stiffness of the barrier, N/m", 1e-3, 1e12}, kappa);
    visit(
        ModelOption{
            "slip_speed", "sliding speed below which friction is less than mu times the normal force, m/s", 1e-6, 1},
        slip_speed);
    visit(ModelOption{"substeps", "substeps of a step", 1, 1e4}, substeps);
    visit(ModelOption{"trapezoidal", "1: the trapezoidal rule instead of implicit Euler", 0, 1}, trapezoidal);
  }

  // Bodies that touch from the start have no gap to keep.
  static std::string ReasonNotApplicable(const Scene& scene) { return internal::UnsupportedByBarrier(scene); }

  template <typename T, typename H>
  State<T> Free(const StepInput<T, H>& in, int i, const State<T>& x) const {
    State<T> next = x;
    for (int substep = 0; substep < substeps; ++substep) Fly(in, i, &next);
    return next;
  }

  template <typename T>
  void Step(const StepInput<T>& in, std::span<const State<T>> x, std::span<State<T>> next) const {
    FreeFlight(*this, in, x, next);
    const auto groups = FindContactGroups(in, x, [](const T&) { return true; });
    for (const Group<T>& group : groups) {
      const GroupDiscs members(group, x.size(), in.scratch);
      for (const int disc : members.discs) next[disc] = x[disc];
      std::pmr::vector<char> reported(group.num_contacts(), 0, in.scratch);
      for (int substep = 0; substep < substeps; ++substep) Advance<T>(in, group, members, next, reported);
      FlyUnlessReported<IpcBarrierOf, T>(*this, in, group, reported, x, next);
    }
  }

 private:
  template <typename T, typename H>
  H SubstepLength(const StepInput<T, H>& in) const {
    return in.h / double(substeps);
  }

  template <typename T, typename H>
  void Fly(const StepInput<T, H>& in, int i, State<T>* x) const {
    const H h = SubstepLength(in);
    const Vec2<T> before = x->v;
    x->v += Scale(h, in.Acceleration(i));
    x->p += trapezoidal ? Scale(H(0.5 * h), Vec2<T>(before + x->v)) : Scale(h, x->v);
    if constexpr (kTurn == kSpin) {
      const T spin = x->rotation[1];
      x->rotation[1] += h * in.AngularAcceleration(i);
      const T mean = trapezoidal ? T(0.5 * (spin + x->rotation[1])) : x->rotation[1];
      x->rotation[0] += h * mean;
    }
  }

  template <typename T>
  void Advance(const StepInput<T>& in, const Group<T>& group, const GroupDiscs& members, std::span<State<T>> state,
               std::span<char> reported) const {
    const internal::BarrierEnergy<T> energy = Pose<T>(in, group, members, state);
    const internal::BarrierEnergy<double> values = energy.template Cast<double>();
    const std::span<const double> found = in.Solved([&] { return Minimize(in, values); });
    if (found.empty()) {
      for (const int disc : members.discs) Fly(in, disc, &state[disc]);
      return;
    }
    const Eigen::VectorXd x = Eigen::Map<const Eigen::VectorXd>(found.data(), found.size());
    Report(in, group, values, x, reported);
    Eigen::MatrixXd hessian;
    if constexpr (!std::is_same_v<T, double>) hessian = LinearizeByUnknowns(values, x).jacobian;
    const std::vector<T> solution = DifferentiableCorrection(energy, x, hessian);
    const double h = SubstepLength(in);
    for (std::size_t i = 0; i < members.discs.size(); ++i) {
      const int disc = members.discs[i], unknown = energy.discs[i].unknown;
      if (unknown < 0) continue;
      State<T>& s = state[disc];
      const Vec2<T> p(solution[unknown], solution[unknown + 1]);
      const Vec2<T> mean(Divide(T(p[0] - s.p[0]), h), Divide(T(p[1] - s.p[1]), h));
      s.v = trapezoidal ? Vec2<T>(Scale(2.0, mean) - s.v) : mean;
      s.p = p;
      if constexpr (kTurn == kSpin) TurnBy<T>(in, disc, solution, energy.discs[i].rim, &s);
    }
  }

  // Sets angle and angular velocity of a disc from the displacement of its rim in a substep; if `rim` < 0 it flies on.
  template <typename T>
  void TurnBy(const StepInput<T>& in, int disc, std::span<const T> solution, int rim, State<T>* s) const {
    const double h = SubstepLength(in);
    const T turn = rim < 0 ? T(h * s->rotation[1]) : Divide(solution[rim], in.bodies[disc].radius);
    const T mean = Divide(turn, h);
    s->rotation[0] += turn;
    s->rotation[1] = trapezoidal ? T(2.0 * mean - s->rotation[1]) : mean;
  }

  template <typename T>
  internal::BarrierEnergy<T> Pose(const StepInput<T>& in, const Group<T>& group, const GroupDiscs& members,
                                  std::span<const State<T>> state) const {
    using Energy = internal::BarrierEnergy<T>;
    const double h = SubstepLength(in);
    Energy energy{
        kappa, range, slip_speed * h, (trapezoidal ? 0.25 : 1.0) * h * h, (trapezoidal ? 0.5 : 1.0) * h * h, {}, {}, 0};
    for (const int disc : members.discs) {
      State<T> flying = state[disc];
      Fly(in, disc, &flying);
      const bool fixed = in.bodies[disc].fixed;
      energy.discs.push_back({state[disc].p, flying.p, in.bodies[disc].mass, fixed ? -1 : energy.num_unknowns});
      if (!fixed) energy.num_unknowns += 2;
      if constexpr (kTurn == kSpin) {
        const auto& body = in.bodies[disc];
        if (!(Value(body.inverse_inertia) > 0)) continue;
        auto& last = energy.discs.back();
        last.rim = energy.num_unknowns++;
        last.rim_target = body.radius * (flying.rotation[0] - state[disc].rotation[0]);
        last.rim_mass = Divide(1.0, T(body.radius * body.radius * body.inverse_inertia));
      }
    }
    for (int i = 0; i < group.num_contacts(); ++i) {
      const Candidate& c = group.contact(i).candidate;
      const Separation<T> at = SeparationAt(in, c, [&](int disc) -> const Vec2<T>& { return state[disc].p; });
      const T force = -kappa * Energy::BarrierSlope(T(at.distance - in.ContactDistance(c)), range);
      energy.contacts.push_back({members.place[c.a],
                                 c.plane ? -1 : members.place[c.b],
                                 c.plane ? in.planes[c.b] : Wall<double>{},
                                 in.ContactDistance(c),
                                 Perpendicular(at.normal),
                                 T(in.ContactOf(c).friction * force)});
      if (!trapezoidal) continue;
      ApplyImpulse(in, c, Scale(T(energy.barrier_weight * force), at.normal), [&](int disc, const Vec2<T>& change) {
        energy.discs[members.place[disc]].target += change;
      });
    }
    return energy;
  }

  // Returns the positions at the end of a substep: empty without contacts, not a number if the minimum is not found.
  template <typename T>
  static Eigen::VectorXd Minimize(const StepInput<T>& in, const internal::BarrierEnergy<double>& energy) {
    if (internal::StaysBeyondRange(energy)) return Eigen::VectorXd(0);
    Eigen::VectorXd x = Start(energy);
    if (!internal::MinimizeBarrierEnergy(energy, &x)) {
      in.Fail("the minimum of the barrier energy is not found");
      x.setConstant(std::numeric_limits<double>::quiet_NaN());
    }
    return x;
  }
  static Eigen::VectorXd Start(const internal::BarrierEnergy<double>& energy) {
    Eigen::VectorXd x(energy.size());
    for (const auto& disc : energy.discs) {
      if (disc.unknown >= 0) x.segment<2>(disc.unknown) = disc.q;
      if (disc.rim >= 0) x[disc.rim] = 0;
    }
    return x;
  }

  template <typename T>
  void Report(const StepInput<T>& in, const Group<T>& group, const internal::BarrierEnergy<double>& energy,
              const Eigen::VectorXd& x, std::span<char> reported) const {
    const Eigen::VectorXd start = Start(energy);
    const std::span<const double> from(start.data(), start.size()), at(x.data(), x.size());
    for (int i = 0; i < group.num_contacts(); ++i) {
      const auto& side = energy.contacts[i];
      const auto in_range = [&](std::span<const double> unknowns) {
        return energy.SeparationAt(unknowns, side).distance - side.touching < range;
      };
      const bool acts = in_range(at) || (trapezoidal && in_range(from));
      if (reported[i] || !(acts || side.friction > 0)) continue;
      reported[i] = 1;
      const bool slips = std::abs(energy.Slid(at, side)) > energy.slip;
      in.Report(group.contact(i).candidate, ModeOf(group.friction(i) > 0.0, !slips));
    }
  }
};

struct IpcBarrier : IpcBarrierOf<0> {
  using Spinning = IpcBarrierOf<kSpin>;
};

}  // namespace saltus
