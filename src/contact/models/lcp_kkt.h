// Contact as a linear complementarity problem in the form of its optimality conditions, solved by an interior point
// method, with an approach to impacts by halving the step (lcp-physics: de Avila Belbute-Peres et al. 2018).
//
// Contacts are pairs with a gap of at most `eps`. With v at the start of a substep of length r, and all rows at its
// start, find v' and per contact l_n, l_+, l_-, g >= 0 complementary to
//
//   s_n = n . w' + e n . w,   s_+- = +-t . w' + g,   s_g = mu l_n - l_+ - l_-                        all >= 0
//   M v' = M v + r (u + M g_0) + sum of l_n n + (l_+ - l_-) t                                        g_0: gravity
//
// r starts as what is left of the step and is halved until nothing would overlap by more than `tolerance`; then p' = p
// + r v', and the rest of the step follows. As eps > tolerance a disc comes near by bisection and bounces at a gap
// below eps. By default the problem is solved anew for each r; the source solves it once with the whole rest of the
// step (force_once), which applies too much force in steps with an impact.
//
// Of discs that spin w' along t is that of the points of contact, and the second line has a row each for their turning.
//
// Derivatives: implicit function theorem at the solution; r and the contacts are constants, so the impact happens at a
// fixed time: the trajectory is nearly exact and the gradient is not. The source's backward pass uses the transposed
// of the complementarity block (released_backward): right without friction, wrong with. Momentum is conserved.
#pragma once

#include <limits>
#include <memory_resource>
#include <vector>

#include "contact/models/contact_rows.h"
#include "contact/solvers/implicit.h"
#include "saltus/contact/contact_model.h"

namespace saltus {

namespace internal {

// The conditions of one group, with dense rows. Unknowns: v' of its moving discs (with kTurn, each followed by the
// speed of the rim, r w), then multipliers z, then slacks s.
template <typename T, int kTurn>
struct KktEquations {
  using Scalar = T;
  struct Push {  // of a row on a moving disc
    int unknown;
    Vec2<T> direction;
    T inverse_mass;
    double rim = 0;           // with kTurn, -1 in tangents: by how much the speed of the rim, the next unknown, counts
    T rim_mobility = T(0.0);  // r^2 / I, 1/kg
  };

  double kappa = 1;
  bool has_friction = false;            // a contact has
  bool transposed = false;              // the source's backward pass
  std::vector<T> free_velocity;         // 2 per moving disc, 3 with kTurn
  std::vector<std::vector<Push>> rows;  // per contact: n, then t if there is friction
  std::vector<T> by_fixed;              // per row: the relative speed along it by fixed discs, which paths may move
  std::vector<T> rebound, friction;     // per contact: e n . w, and mu

  int num_velocities() const { return static_cast<int>(free_velocity.size()); }
  int num_contacts() const { return static_cast<int>(rebound.size()); }
  int per_contact() const { return has_friction ? 4 : 1; }
  int num_multipliers() const { return per_contact() * num_contacts(); }
  int size() const { return num_velocities() + 2 * num_multipliers(); }

  T Speed(std::span<const T> v, int row) const {
    T speed = by_fixed[row];
    for (const Push& push : rows[row]) {
      speed += Dot(push.direction, Vec2<T>(v[push.unknown], v[push.unknown + 1]));
      if constexpr (kTurn == kSpin) speed += push.rim * v[push.unknown + 2];
    }
    return speed;
  }

  void Residual(std::span<const T> x, std::span<T> F) const {
    const int nv = num_velocities(), nz = num_multipliers();
    for (int i = 0; i < nv; ++i) F[i] = x[i] - free_velocity[i];
    const auto apply = [&](int row, const T& impulse) {
      for (const Push& push : rows[row]) {
        for (int j = 0; j < 2; ++j) F[push.unknown + j] -= push.inverse_mass * push.direction[j] * impulse;
        if constexpr (kTurn == kSpin) F[push.unknown + 2] -= push.rim * push.rim_mobility * impulse;
      }
    };
    for (int c = 0; c < num_contacts(); ++c) {
      const T* z = &x[nv + c * per_contact()];
      T* out = &F[nv + c * per_contact()];
      const T* s = &x[nv + nz + c * per_contact()];
      const int normal = has_friction ? 2 * c : c;
      apply(normal, z[0]);
      out[0] = Speed(x, normal) + rebound[c] - s[0];
      if (!has_friction) continue;
      apply(normal + 1, T(z[1] - z[2]));
      if (!(Value(friction[c]) > 0)) {  // the multipliers of its tangent cancel out
        for (int i = 1; i < 4; ++i) out[i] = z[i] - s[i];
        continue;
      }
      const T slip = Speed(x, normal + 1);
      out[1] = slip + z[3] - s[1];
      out[2] = z[3] - slip - s[2];
      out[3] = friction[c] * z[0] - z[1] - z[2] - s[3];
      if (transposed) {  // F^T z in the place of F z
        out[0] += friction[c] * z[3];
        out[1] -= 2.0 * z[3];
        out[2] -= 2.0 * z[3];
        out[3] += z[1] + z[2] - friction[c] * z[0] + z[1] + z[2];
      }
    }
    for (int i = 0; i < nz; ++i) F[nv + nz + i] = x[nv + i] * x[nv + nz + i] - kappa;
  }

  template <typename Visit>
  void VisitPositive(const Eigen::VectorXd& x, const Eigen::VectorXd& dx, const Visit& visit) const {
    for (int i = num_velocities(); i < size(); ++i) visit(x[i], dx[i]);
  }

  template <typename U>
  KktEquations<U, kTurn> Cast() const {
    const auto number = [](const T& x) { return U(Value(x)); };
    KktEquations<U, kTurn> out;
    out.kappa = kappa;
    for (const T& mu : friction) out.friction.push_back(number(mu));
    out.has_friction = has_friction;
    out.transposed = transposed;
    for (const T& v : free_velocity) out.free_velocity.push_back(number(v));
    for (const T& r : rebound) out.rebound.push_back(number(r));
    for (const T& speed : by_fixed) out.by_fixed.push_back(number(speed));
    for (const std::vector<Push>& row : rows) {
      out.rows.emplace_back();
      for (const Push& push : row) {
        out.rows.back().push_back({push.unknown,
                                   Vec2<U>(number(push.direction[0]), number(push.direction[1])),
                                   number(push.inverse_mass),
                                   push.rim,
                                   number(push.rim_mobility)});
      }
    }
    return out;
  }
};

}  // namespace internal

template <int kTurn>
struct LcpKktOf : SemiImplicitFlight<kTurn> {
  static constexpr ModelTraits kTraits = {.name = "lcp_kkt",
                                          .summary = "complementarity by an interior point, impacts by halved steps",
                                          .source = "lcp-physics (de Avila Belbute-Peres et al. 2018)",
                                          .double_engine = true,
                                          .chains = true,
                                          .allocates = true,
                                          .accuracy = 1e-9,
                                          .relative = true,
                                          .by_pair = true};
  template <typename T>
  using State = BodyState<T, kTurn>;
  template <typename T>
  using Group = ContactGroup<T, kTurn>;

  double eps = 1e-4;        // m, gap from which on a pair is a contact
  double tolerance = 1e-6;  // m, overlap that a step may leave; less than eps
  double final_kappa = 1e-13;
  bool force_once = false;
  bool released_backward = false;
  template <typename Visit>
  void VisitOptions(const Visit& visit) {
    visit(ModelOption{"eps", "gap below which a pair is a contact, m", 2e-6, 1e-3}, eps);
    visit(ModelOption{"tolerance", "largest accepted overlap after a step, m", 1e-9, 1e-6}, tolerance);
    visit(ModelOption{"force_once", "1: no new solve with a halved step, as in the source", 0, 1}, force_once);
    visit(
        ModelOption{
            "released_backward", "1: the backward pass of the source, which is wrong with friction", 0, 1, true},
        released_backward);
  }

  template <typename T>
  void Step(const StepInput<T>& in, std::span<const State<T>> x, std::span<State<T>> next) const {
    FreeFlight(*this, in, x, next);
    const auto groups = FindContactGroups(in, x, [](const T&) { return true; });
    for (const Group<T>& group : groups) {
      const GroupDiscs members(group, x.size(), in.scratch);
      if (Overlap<T>(in, group, next) <= tolerance && Touching<T>(in, group, x).empty()) continue;
      for (const int disc : members.discs) next[disc] = x[disc];
      std::pmr::vector<char> reported(group.num_contacts(), 0, in.scratch);
      Advance<T>(in, group, members, next, reported);
      FlyUnlessReported<LcpKktOf, T>(*this, in, group, reported, x, next);
    }
  }

 private:
  template <typename T>
  static double Gap(const StepInput<T>& in, const Candidate& c, std::span<const State<T>> x) {
    return GapValue(in, c, [&](int i) -> Vec2d { return {Value(x[i].p[0]), Value(x[i].p[1])}; });
  }
  template <typename T>
  static double Overlap(const StepInput<T>& in, const Group<T>& group, std::span<const State<T>> x) {
    double deepest = 0;
    for (int i = 0; i < group.num_contacts(); ++i) {
      deepest = std::max(deepest, -Gap<T>(in, group.contact(i).candidate, x));
    }
    return deepest;
  }
  template <typename T>
  std::pmr::vector<int> Touching(const StepInput<T>& in, const Group<T>& group, std::span<const State<T>> x) const {
    std::pmr::vector<int> touching(in.scratch);
    for (int i = 0; i < group.num_contacts(); ++i) {
      if (Gap<T>(in, group.contact(i).candidate, x) <= eps) touching.push_back(i);
    }
    return touching;
  }

  // Advances one group by the whole step; the result is not a number if kMaxSubsteps do not suffice.
  template <typename T>
  void Advance(const StepInput<T>& in, const Group<T>& group, const GroupDiscs& members, std::span<State<T>> x,
               std::span<char> reported) const {
    std::pmr::vector<Twist<T, kTurn>> velocity(members.discs.size(), in.scratch);
    double rest = in.h;
    for (int substep = 0; substep < kMaxSubsteps && rest > 0; ++substep) {
      const std::pmr::vector<int> touching = Touching<T>(in, group, x);
      const std::span<const double> found =
          in.Solved([&] { return FindSubstep<T>(in, group, members, touching, x, rest); });
      const double length = found[0];
      FreeVelocities<T>(in, members, x, force_once ? rest : length, velocity);
      if (!touching.empty()) {
        const Eigen::VectorXd z = Eigen::Map<const Eigen::VectorXd>(&found[1], found.size() - 1);
        const internal::KktEquations<T, kTurn> equations = Pose<T>(in, group, members, touching, x, velocity);
        Report(in, group, equations, touching, z, reported);
        Eigen::MatrixXd jacobian;
        if constexpr (!std::is_same_v<T, double>) {
          internal::KktEquations<double, kTurn> values = equations.template Cast<double>();
          values.transposed = released_backward;
          jacobian = LinearizeByUnknowns(values, z).jacobian;
        }
        TakeVelocities<T>(in, members, DifferentiableCorrection(equations, z, jacobian), velocity);
      }
      for (std::size_t i = 0; i < members.discs.size(); ++i) {
        State<T>& disc = x[members.discs[i]];
        disc.v = velocity[i].v;
        disc.p += Scale(length, velocity[i].v);
        if constexpr (kTurn == kSpin) {
          disc.rotation[1] = velocity[i].w;
          disc.rotation[0] += length * velocity[i].w;
        }
      }
      rest -= length;
    }
    if (!(rest > 0)) return;
    in.Fail("the step does not reach its end within the most substeps: use more `steps`");
    for (const int disc : members.discs) x[disc].v = Vec2<T>::Constant(T(std::numeric_limits<double>::quiet_NaN()));
  }

  // Returns the length of the next substep and, if anything touches, the unknowns of its equations.
  template <typename T>
  Eigen::VectorXd FindSubstep(const StepInput<T>& in, const Group<T>& group, const GroupDiscs& members,
                              std::span<const int> touching, std::span<const State<T>> x, double rest) const {
    std::pmr::vector<Twist<T, kTurn>> velocity(members.discs.size(), in.scratch);
    std::pmr::vector<State<T>> tried(x.begin(), x.end(), in.scratch);
    const double overlap = std::max(tolerance, Overlap<T>(in, group, x));
    Eigen::VectorXd z(0);
    double length = rest;
    for (int halving = 0;; ++halving, length /= 2) {
      if (halving == 0 || !force_once) {
        FreeVelocities<T>(in, members, x, length, velocity);
        if (!touching.empty()) {
          z = Solve(in, Pose<T>(in, group, members, touching, x, velocity).template Cast<double>());
          TakeVelocities<T>(in, members, std::vector<T>(z.begin(), z.end()), velocity);
        }
      }
      for (std::size_t i = 0; i < members.discs.size(); ++i) {
        tried[members.discs[i]].p = x[members.discs[i]].p + Scale(length, velocity[i].v);
      }
      if (Overlap<T>(in, group, tried) <= overlap || halving == kMaxHalvings) break;
    }
    Eigen::VectorXd found(1 + z.size());
    found << length, z;
    return found;
  }

  // Returns the solution of the equations, not a number if the iteration does not converge.
  template <typename T>
  Eigen::VectorXd Solve(const StepInput<T>& in, internal::KktEquations<double, kTurn> equations) const {
    Eigen::VectorXd z = Eigen::VectorXd::Ones(equations.size());
    for (int i = 0; i < equations.num_velocities(); ++i) z[i] = equations.free_velocity[i];
    PathOptions path;
    path.kappa = final_kappa;
    path.tolerance = 1e-15;
    if (!InteriorPoint(path, &equations, &z)) {
      in.Fail("the interior point method does not converge");
      z.setConstant(std::numeric_limits<double>::quiet_NaN());
    }
    return z;
  }

  template <typename T>
  static void FreeVelocities(const StepInput<T>& in, const GroupDiscs& members, std::span<const State<T>> x,
                             double length, std::span<Twist<T, kTurn>> velocity) {
    for (std::size_t i = 0; i < members.discs.size(); ++i) {
      const int disc = members.discs[i];
      State<T> next = x[disc];
      Accelerate(length, AccelerationOf<kTurn>(in, disc), &next);
      velocity[i] = TwistOf(next);
    }
  }

  // Copies the velocities of the moving discs from the unknowns of the equations.
  template <typename T>
  static void TakeVelocities(const StepInput<T>& in, const GroupDiscs& members, const std::vector<T>& unknowns,
                             std::span<Twist<T, kTurn>> velocity) {
    int next = 0;
    for (std::size_t i = 0; i < members.discs.size(); ++i) {
      if (in.bodies[members.discs[i]].fixed) continue;
      velocity[i].v = {unknowns[next], unknowns[next + 1]};
      next += 2;
      if constexpr (kTurn == kSpin) velocity[i].w = Divide(unknowns[next++], in.bodies[members.discs[i]].radius);
    }
  }

  template <typename T>
  static void Report(const StepInput<T>& in, const Group<T>& group, const internal::KktEquations<T, kTurn>& equations,
                     std::span<const int> touching, const Eigen::VectorXd& z, std::span<char> reported) {
    for (std::size_t k = 0; k < touching.size(); ++k) {
      const int first = equations.num_velocities() + static_cast<int>(k) * equations.per_contact();
      const bool acts = z[first] > z[first + equations.num_multipliers()];
      char& known = reported[touching[k]];
      if (known || !acts) continue;
      known = 1;
      const bool rough = equations.friction[k] > 0.0, slips = rough && z[first + 3] > 1e-6;
      in.Report(group.contact(touching[k]).candidate, ModeOf(rough, !slips));
    }
  }

  template <typename T>
  static internal::KktEquations<T, kTurn> Pose(const StepInput<T>& in, const Group<T>& group, const GroupDiscs& members,
                                               std::span<const int> touching, std::span<const State<T>> x,
                                               std::span<const Twist<T, kTurn>> free_velocity) {
    internal::KktEquations<T, kTurn> equations;
    equations.has_friction = group.friction();
    std::pmr::vector<int> unknown(members.discs.size(), -1, in.scratch);
    for (std::size_t i = 0; i < members.discs.size(); ++i) {
      if (in.bodies[members.discs[i]].fixed) continue;
      unknown[i] = equations.num_velocities();
      for (int j = 0; j < 2; ++j) equations.free_velocity.push_back(free_velocity[i].v[j]);
      if constexpr (kTurn == kSpin) {
        equations.free_velocity.push_back(in.bodies[members.discs[i]].radius * free_velocity[i].w);
      }
    }
    for (const int contact : touching) {
      const Candidate& c = group.contact(contact).candidate;
      const Vec2<T> n = SeparationAt(in, c, [&](int i) -> const Vec2<T>& { return x[i].p; }).normal;
      const auto add_row = [&](const Vec2<T>& direction) {
        equations.rows.emplace_back();
        const int a = unknown[members.place[c.a]], b = c.plane ? -1 : unknown[members.place[c.b]];
        if (a >= 0) equations.rows.back().push_back({a, direction, in.InverseMassA(c)});
        if (b >= 0) equations.rows.back().push_back({b, Vec2<T>(-direction), in.InverseMassB(c)});
        T& speed = equations.by_fixed.emplace_back(T(0.0));
        if (a < 0) speed += Dot(direction, x[c.a].v);
        if (b < 0 && !c.plane) speed -= Dot(direction, x[c.b].v);
      };
      add_row(n);
      if (equations.has_friction) add_row(Perpendicular(n));
      if constexpr (kTurn == kSpin) {
        for (auto& push : equations.rows.back()) {
          if (!equations.has_friction) break;
          const auto& body = in.bodies[push.unknown == unknown[members.place[c.a]] ? c.a : c.b];
          push.rim = -1;
          push.rim_mobility = body.radius * body.radius * body.inverse_inertia;
        }
      }
      const Vec2<T> w = RelativeVelocity<T>(c, [&](int i) -> const Vec2<T>& { return x[i].v; });
      equations.rebound.push_back(in.ContactOf(c).restitution * Dot(n, w));
      equations.friction.push_back(in.ContactOf(c).friction);
    }
    return equations;
  }

  static constexpr int kMaxSubsteps = 1000;
  static constexpr int kMaxHalvings = 60;
};

struct LcpKkt : LcpKktOf<0> {
  using Spinning = LcpKktOf<kSpin>;
};

}  // namespace saltus
