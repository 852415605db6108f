// Contact as a nonlinear complementarity problem with the exact friction cone, on the central path of an interior point
// method (Dojo: Howell et al. 2022); and an extension with restitution.
//
// With q' = q + h v' and normals n, tangents t and gaps at q', find v' and, per contact, the impulses p_n, p_t with
//
//   M (v' - v) - h (M g + u) - sum of p_n n + p_t t = 0
//   gap(q') = s,  p_n s = kappa,  p_n, s > 0
//   (mu p_n + p_t) (b + w_t) = kappa,  (mu p_n - p_t) (b - w_t) = kappa,  all factors > 0         w = relative velocity
//
// The second line requires that nothing overlaps at the end of the step; the third is the planar friction cone with
// maximal dissipation. kappa, N s m and N s m/s, relaxes both: the force acts at a distance, p_n = kappa / gap, and the
// contact rebounds with about 3.55 sqrt(kappa / h). Restitution is not read: impacts are plastic.
//
// With kRestitution, contacts whose gap would be closed after a free step obey Newton's law instead of the second line,
//   s = n . w(v') + e n . w(v), n at q, and open ones carry no impulse: impacts have the scene's restitution.
//
// Of discs that spin w_t is that of the points of contact, and the equations have a row each for what p_t makes of the
// angular velocities.
//
// Values by Newton's method along the path; derivatives by the implicit function theorem at kappa, or at a larger
// kappa_grad, which is another point's derivative and therefore biased. Everything is differentiated. As the
// force acts at any distance, all discs are coupled in every step; with kRestitution, those whose gaps close. A step
// that does not converge is not a number.
#pragma once

#include <limits>
#include <vector>

#include "contact/models/contact_rows.h"
#include "contact/solvers/implicit.h"
#include "saltus/contact/contact_model.h"

namespace saltus {

namespace internal {

// The equations of one group. Unknowns: v' of its moving discs (with kTurn, each followed by the speed of its rim, r
// w), then per contact p_n, s and, with friction, p_t, b, w_t.
template <typename T, bool kRestitution, int kTurn>
struct NcpEquations {
  using Scalar = T;
  struct Disc {
    Vec2<T> p, v, flying;  // flying: v' without contact
    T inverse_mass;
    int unknown;                                   // index of v'_x; -1 if fixed
    T flying_rim = T(0.0), rim_mobility = T(0.0);  // r w without contact, m/s; r^2 / I, 1/kg
  };
  struct Side {
    int a, b;  // discs; b < 0 at a plane
    Wall<double> plane;
    double touching;  // m, distance of centres or of centre and plane
    Vec2<T> normal;   // at q
    T restitution, friction;
    bool IsRough() const { return Value(friction) > 0; }
  };

  double h = 0;
  bool has_friction = false;  // a contact has
  double kappa = 1;
  std::vector<Disc> discs;
  std::vector<Side> contacts;
  int num_velocities = 0;

  int per_contact() const { return has_friction ? 5 : 2; }
  int size() const { return num_velocities + per_contact() * static_cast<int>(contacts.size()); }

  Vec2<T> Velocity(std::span<const T> z, int disc) const {
    if (disc < 0) return Vec2<T>(T(0.0), T(0.0));
    if (discs[disc].unknown < 0) return discs[disc].v;
    return {z[discs[disc].unknown], z[discs[disc].unknown + 1]};
  }
  // Returns the sliding speed of the points of contact by spin, m/s.
  T SlidingBySpin(std::span<const T> z, const Side& side) const {
    T sliding = T(0.0);
    for (const int disc : {side.a, side.b}) {
      if (disc >= 0 && discs[disc].unknown >= 0) sliding -= z[discs[disc].unknown + 2];
    }
    return sliding;
  }
  Separation<T> SeparationAfter(std::span<const T> z, const Side& side) const {
    const auto position = [&](int i) -> Vec2<T> { return discs[i].p + Scale(h, Velocity(z, i)); };
    if (side.b < 0) return Separate<T>(position(side.a), side.plane);
    return Separate<T>(position(side.a), position(side.b));
  }

  void Residual(std::span<const T> z, std::span<T> F) const {
    for (const Disc& disc : discs) {
      if (disc.unknown < 0) continue;
      for (int j = 0; j < 2; ++j) F[disc.unknown + j] = z[disc.unknown + j] - disc.flying[j];
      if constexpr (kTurn == kSpin) F[disc.unknown + 2] = z[disc.unknown + 2] - disc.flying_rim;
    }
    for (std::size_t i = 0; i < contacts.size(); ++i) {
      const Side& side = contacts[i];
      const int at = num_velocities + per_contact() * static_cast<int>(i);
      const T &p_n = z[at], &s = z[at + 1];
      const Vec2<T> w = Velocity(z, side.a) - Velocity(z, side.b);
      Vec2<T> normal = side.normal;
      if constexpr (kRestitution) {
        const Vec2<T> before = side.b < 0 ? discs[side.a].v : Vec2<T>(discs[side.a].v - discs[side.b].v);
        F[at] = Dot(normal, w) + side.restitution * Dot(normal, before) - s;
      } else {
        const Separation<T> after = SeparationAfter(z, side);
        normal = after.normal;
        F[at] = after.distance - side.touching - s;
      }
      F[at + 1] = p_n * s - kappa;
      Vec2<T> impulse = Scale(p_n, normal);
      if (has_friction) {
        const T &p_t = z[at + 2], &b = z[at + 3], &w_t = z[at + 4];
        const Vec2<T> tangent = Perpendicular(normal);
        F[at + 2] = side.IsRough() ? T((side.friction * p_n + p_t) * (b + w_t) - kappa) : p_t;
        F[at + 3] = side.IsRough() ? T((side.friction * p_n - p_t) * (b - w_t) - kappa) : b;
        F[at + 4] = Dot(tangent, w) - w_t;
        if constexpr (kTurn == kSpin) F[at + 4] += SlidingBySpin(z, side);
        impulse += Scale(p_t, tangent);
      }
      for (const int disc : {side.a, side.b}) {
        if (disc < 0 || discs[disc].unknown < 0) continue;
        const T factor = disc == side.a ? T(-discs[disc].inverse_mass) : discs[disc].inverse_mass;
        for (int j = 0; j < 2; ++j) F[discs[disc].unknown + j] += factor * impulse[j];
        if constexpr (kTurn == kSpin) {
          if (has_friction) F[discs[disc].unknown + 2] += discs[disc].rim_mobility * z[at + 2];
        }
      }
    }
  }

  template <typename Visit>
  void VisitPositive(const Eigen::VectorXd& z, const Eigen::VectorXd& dz, const Visit& visit) const {
    for (std::size_t i = 0; i < contacts.size(); ++i) {
      const int at = num_velocities + per_contact() * static_cast<int>(i);
      visit(z[at], dz[at]);
      visit(z[at + 1], dz[at + 1]);
      const double mu = Value(contacts[i].friction);
      if (!has_friction || !(mu > 0)) continue;
      visit(mu * z[at] + z[at + 2], mu * dz[at] + dz[at + 2]);
      visit(mu * z[at] - z[at + 2], mu * dz[at] - dz[at + 2]);
      visit(z[at + 3] + z[at + 4], dz[at + 3] + dz[at + 4]);
      visit(z[at + 3] - z[at + 4], dz[at + 3] - dz[at + 4]);
    }
  }

  template <typename U>
  NcpEquations<U, kRestitution, kTurn> Cast() const {
    const auto number = [](const T& x) { return U(Value(x)); };
    const auto vector = [&](const Vec2<T>& x) { return Vec2<U>(number(x[0]), number(x[1])); };
    NcpEquations<U, kRestitution, kTurn> out;
    out.h = h;
    out.has_friction = has_friction;
    out.kappa = kappa;
    for (const Disc& d : discs) {
      out.discs.push_back({vector(d.p),
                           vector(d.v),
                           vector(d.flying),
                           number(d.inverse_mass),
                           d.unknown,
                           number(d.flying_rim),
                           number(d.rim_mobility)});
    }
    for (const Side& s : contacts) {
      out.contacts.push_back(
          {s.a, s.b, s.plane, s.touching, vector(s.normal), number(s.restitution), number(s.friction)});
    }
    out.num_velocities = num_velocities;
    return out;
  }
};

}  // namespace internal

template <bool kRestitution, int kTurn>
struct NcpOf : SemiImplicitFlight<kTurn> {
  static constexpr ModelTraits kTraits = {
      .name = kRestitution ? "ncp_restitution" : "ncp",
      .summary = kRestitution ? "interior point with Newton's restitution at velocity level"
                              : "nonlinear complementarity by an interior point method, plastic",
      .source = kRestitution ? "extension of Dojo (Howell et al. 2022); Moreau 1988" : "Dojo (Howell et al. 2022)",
      .double_engine = true,
      .rebound = kRestitution ? Rebound::kRestitution : Rebound::kPlastic,
      .push_gap = kRestitution ? 0.0 : std::numeric_limits<double>::infinity(),
      .allocates = true,
      .accuracy = 1e-12,
      .relative = true,
      .by_pair = true};
  template <typename T>
  using State = BodyState<T, kTurn>;
  template <typename T>
  using Group = ContactGroup<T, kTurn>;

  double kappa = 1e-8;
  double kappa_grad = 0;  // no less than kappa; 0: kappa
  template <typename Visit>
  void VisitOptions(const Visit& visit) {
    visit(ModelOption{"kappa", "central-path parameter at which the iterations end, N s m", 1e-12, 1}, kappa);
    visit(
        ModelOption{
            "kappa_grad", "central-path parameter at which derivatives are taken; kappa if it is smaller", 0, 1, true},
        kappa_grad);
  }

  template <typename T>
  void Step(const StepInput<T>& in, std::span<const State<T>> x, std::span<State<T>> next) const {
    FreeFlight(*this, in, x, next);
    // Restitution is for contacts that a free step would close; otherwise everything within the push gap takes part.
    const std::span<const State<T>> at = kRestitution ? std::span<const State<T>>(next) : x;
    const auto active = [&](const T& gap) {
      if constexpr (kRestitution) return gap <= 0.0;
      return gap < kTraits.push_gap;
    };
    const auto groups = FindContactGroups(in, at, active);
    for (const Group<T>& group : groups) Solve<T>(in, group, x, next);
  }

 private:
  template <typename T>
  using Equations = internal::NcpEquations<T, kRestitution, kTurn>;

  template <typename T>
  void Solve(const StepInput<T>& in, const Group<T>& group, std::span<const State<T>> x,
             std::span<State<T>> next) const {
    const GroupDiscs members(group, x.size(), in.scratch);
    const Equations<T> equations = Pose<T>(in, group, members, x, next);
    Equations<double> values = equations.template Cast<double>();
    const auto solve_at = [&](double end) {
      Eigen::VectorXd z = Start(&values);
      PathOptions path;
      path.kappa = end;
      if (!InteriorPoint(path, &values, &z)) {
        in.Fail("the interior point method does not converge");
        z.setConstant(std::numeric_limits<double>::quiet_NaN());
      }
      return z;
    };
    const std::span<const double> found = in.Solved([&] { return solve_at(kappa); });
    Eigen::VectorXd z = Eigen::Map<const Eigen::VectorXd>(found.data(), found.size());
    ReportContacts(in, group, values, z);
    std::vector<T> solution(z.begin(), z.end());
    if constexpr (!std::is_same_v<T, double>) {
      if (kappa_grad > kappa) z = solve_at(kappa_grad);
      values.kappa = std::max(kappa, kappa_grad);
      const std::vector<T> corrected = DifferentiableCorrection(equations, z, LinearizeByUnknowns(values, z).jacobian);
      for (int i = 0; i < z.size(); ++i) solution[i].v = corrected[i].v;
    }
    for (std::size_t i = 0; i < members.discs.size(); ++i) {
      const int disc = members.discs[i], unknown = equations.discs[i].unknown;
      if (unknown < 0) continue;
      State<T>& after = next[disc];
      after.v = {solution[unknown], solution[unknown + 1]};
      after.p = x[disc].p + Scale(in.h, after.v);
      if constexpr (kTurn == kSpin) {
        after.rotation[1] = Divide(solution[unknown + 2], in.bodies[disc].radius);
        after.rotation[0] = x[disc].rotation[0] + in.h * after.rotation[1];
      }
    }
  }

  template <typename T>
  Equations<T> Pose(const StepInput<T>& in, const Group<T>& group, const GroupDiscs& members,
                    std::span<const State<T>> x, std::span<const State<T>> flying) const {
    Equations<T> equations;
    equations.h = in.h;
    equations.has_friction = group.friction();
    for (const int disc : members.discs) {
      const bool fixed = in.bodies[disc].fixed;
      equations.discs.push_back(
          {x[disc].p, x[disc].v, flying[disc].v, in.bodies[disc].inverse_mass, fixed ? -1 : equations.num_velocities});
      if constexpr (kTurn == kSpin) {
        const auto& body = in.bodies[disc];
        equations.discs.back().flying_rim = body.radius * flying[disc].rotation[1];
        equations.discs.back().rim_mobility = body.radius * body.radius * body.inverse_inertia;
      }
      if (!fixed) equations.num_velocities += kTurn == kSpin ? 3 : 2;
    }
    for (int i = 0; i < group.num_contacts(); ++i) {
      const Candidate& c = group.contact(i).candidate;
      const auto now = [&](int disc) -> const Vec2<T>& { return x[disc].p; };
      equations.contacts.push_back({members.place[c.a],
                                    c.plane ? -1 : members.place[c.b],
                                    c.plane ? in.planes[c.b] : Wall<double>{},
                                    in.ContactDistance(c),
                                    SeparationAt(in, c, now).normal,
                                    in.ContactOf(c).restitution,
                                    in.ContactOf(c).friction});
    }
    return equations;
  }

  // Returns free flight and a strictly interior point: on the path for `kappa` if all stay well apart, else for 1.
  Eigen::VectorXd Start(Equations<double>* equations) const {
    Eigen::VectorXd z(equations->size());
    for (const auto& disc : equations->discs) {
      if (disc.unknown < 0) continue;
      z.segment<2>(disc.unknown) = disc.flying;
      if constexpr (kTurn == kSpin) z[disc.unknown + 2] = disc.flying_rim;
    }
    const std::span<const double> velocities(z.data(), z.size());
    const auto gap = [&](int i) {
      return equations->SeparationAfter(velocities, equations->contacts[i]).distance - equations->contacts[i].touching;
    };
    const int n = static_cast<int>(equations->contacts.size());
    bool apart = !kRestitution;
    for (int i = 0; i < n; ++i) apart = apart && gap(i) > 1e-3;
    equations->kappa = apart ? kappa : 1.0;
    for (int i = 0; i < n; ++i) {
      const auto& side = equations->contacts[i];
      const int at = equations->num_velocities + i * equations->per_contact();
      const double s = apart ? gap(i) : 1.0;
      z[at] = equations->kappa / s;
      z[at + 1] = s;
      if (!equations->has_friction) continue;
      const Separation<double> after = equations->SeparationAfter(velocities, side);
      const Vec2d w = equations->Velocity(velocities, side.a) - equations->Velocity(velocities, side.b);
      double w_t = Dot(Perpendicular(after.normal), w);
      if constexpr (kTurn == kSpin) w_t += equations->SlidingBySpin(velocities, side);
      z[at + 2] = 0;
      z[at + 3] = side.IsRough() ? std::hypot(w_t, equations->kappa / (side.friction * z[at])) : 0.0;
      z[at + 4] = w_t;
    }
    return z;
  }

  // Reports all contacts that are coupled, at whatever distance, because all of them have forces.
  template <typename T>
  static void ReportContacts(const StepInput<T>& in, const Group<T>& group, const Equations<double>& equations,
                             const Eigen::VectorXd& z) {
    for (int i = 0; i < group.num_contacts(); ++i) {
      const int at = equations.num_velocities + i * equations.per_contact();
      const bool rough = equations.contacts[i].IsRough();
      const bool slips = rough && std::abs(z[at + 2]) > 0.99 * equations.contacts[i].friction * z[at];
      in.Report(group.contact(i).candidate,
                ModeOf(rough, !slips),
                -1,
                kRestitution ? ContactKind::kImpact : ContactKind::kSustained);
    }
  }
};

template <bool kRestitution>
struct Ncp : NcpOf<kRestitution, 0> {
  using Spinning = NcpOf<kRestitution, kSpin>;
};

}  // namespace saltus
