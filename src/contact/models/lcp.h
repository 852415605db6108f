// Contacts as one linear complementarity problem per group of touching discs, and the gradient published with it
// (NimblePhysics 0.7.2; Werling et al. 2021, "Fast and Feature-Complete Differentiable Physics Engine").
//
//   v^f = v + h (u/m + g)                      velocity without contact
//   contacts at the old positions, with overlap d in [0, 0.03 m]: normal n, tangent t; a row a of impulse directions
//         (n on disc a, -n on disc b) and, if friction > 1e-3, one with t
//   b   = -a . v^f, on normal rows enlarged by min(e b, 100 m/s) if e > 1e-3 and e b > 0.1 m/s: the contact "bounces";
//         below that it is plastic
//   x   = impulses, N s: Lambda x - b complementary to the bounds of x, Lambda = A M^-1 A^T (lcp_solver.h)
//   v'  = v^f + M^-1 A^T x
//   p'  = p + h v                              with the velocity before the step; nothing corrects positions
//
// Overlaps deeper than 0.03 m are no contacts: a disc that moves further in one step can pass a plane.
//
// Step<Jet> differentiates this exactly within fixed classes of rows (separating, clamping, at a bound of friction):
// values come from the solver, derivatives from one Newton correction. Linearize is what the source publishes: the same
// for v', but dp'/dp = X and dp'/dv = h X, where the bounce matrix X is the one closest to the identity with a^T X a =
// -e for every bouncing contact. X is I without a bounce; it depends neither on masses nor on friction. Without
// friction momentum and restitution hold exactly for a single contact that bounces.
//
// Discs that spin: rows, Lambda and M have their angular velocities, tangents the arms of the points of contact. X is
// that of the normals, so it knows no spin.
//
// The option complementarity_aware makes reverse sweeps take a search direction that is no gradient. With l' the
// cotangent after the step and l = (l_p, l_v, l_u) that before it, per group:
//
//   c_i = a_i . l_v'           normals: clamping if c_i >= 0, else separating, whatever their forces; tangents separate
//   l~                         as l, from the Jacobian in these classes, with X = I
//   size s = |l_v| + |l_u| / h; l~ is taken if its size is larger
//
// so that a contact that hides the loss from the force behind it is opened where the loss wants it open. In the source
// a contact that has bounced and is set to clamping reads from an empty matrix; here X = I holds for it too.
#pragma once

#include <Eigen/Core>
#include <limits>
#include <memory_resource>
#include <type_traits>
#include <vector>

#include "contact/models/contact_rows.h"
#include "contact/solvers/lcp_solver.h"
#include "saltus/contact/contact_model.h"

namespace saltus {

template <int kTurn>
struct LcpOf : ExplicitFlight<kTurn> {
  static constexpr ModelTraits kTraits = {.name = "lcp",
                                          .summary = "linear complementarity problem with the published Jacobian",
                                          .source = "NimblePhysics 0.7.2 (Werling et al. 2021)",
                                          .double_engine = true,
                                          .published_jacobian = true,
                                          .compared = true,
                                          .relative = true,
                                          .by_pair = true};
  template <typename T>
  using State = BodyState<T, kTurn>;

  bool complementarity_aware = false;

  template <typename Visit>
  void VisitOptions(const Visit& visit) {
    visit(ModelOption{"complementarity_aware",
                      "1: reverse sweeps choose the contact modes that leave a larger gradient",
                      0,
                      1,
                      true},
          complementarity_aware);
  }

  template <typename T>
  void Step(const StepInput<T>& in, std::span<const State<T>> x, std::span<State<T>> next) const {
    FreeFlight(*this, in, x, next);
    for (const Group<T>& group : FindGroups<T>(in, x, next)) {
      if (IsSmall(group)) {
        StepGroup<kFewLcpRows>(in, group, next);
      } else {
        StepGroup<Eigen::Dynamic>(in, group, next);
      }
    }
  }

  // The source's Jacobian of the step. A is (4 n) x (4 n) over [p_x p_y v_x v_y] of each disc (with kTurn (6 n) x (6
  // n), angle and angular velocity following), B is (4 n) x (2 n) over the forces. Fixed discs have the identity in A
  // and nothing else.
  void Linearize(const StepInput<double>& in, std::span<const State<double>> x, Eigen::Ref<Eigen::MatrixXd> A,
                 Eigen::Ref<Eigen::MatrixXd> B) const;

  // The complementarity-aware reverse of the step: from l' to l, shapes as in contact_model.h.
  void PullBack(const StepInput<double>& in, std::span<const State<double>> x, std::span<const double> after,
                std::span<double> before) const;

 private:
  // One direction in which a contact can push.
  template <typename T>
  struct Row {
    Candidate candidate;
    Vec2<T> direction;  // of the impulse on disc a; disc b gets the opposite
    T distance;         // m, as in Separation
    T rhs;              // m/s
    int normal;         // the normal row of the contact, as an index into the group
    bool bounced;
    bool tangent = false;
  };
  // Contacts that are connected by moving discs, in the order of candidates; tangents follow their normals.
  template <typename T>
  using Group = std::pmr::vector<Row<T>>;
  // Whether the matrices of a group have a bounded size and so need no heap.
  template <typename T>
  static bool IsSmall(const Group<T>& group) {
    return group.size() <= kFewLcpRows;
  }

  template <int kMaxRows, typename T>
  void StepGroup(const StepInput<T>& in, const Group<T>& group, std::span<State<T>> next) const {
    const LcpSolutionUpTo<kMaxRows> solution = SolveBoxedLcp(Problem<kMaxRows>(in, group));
    ReportTouches(in, group, solution);
    std::pmr::vector<T> impulses = Impulses(in, group, solution);
    if (!solution.fits) {
      in.Fail("the complementarity problem is not solved");
      impulses[0] = T(std::numeric_limits<Base<T>>::quiet_NaN());
    }
    ApplyImpulses<T>(in, group, impulses, next);
  }

  static constexpr double kMaxDepth = 0.03;        // m
  static constexpr double kMinRestitution = 1e-3;  // below, there is none
  static constexpr double kMinFriction = 1e-3;
  static constexpr double kBounceThreshold = 0.1;  // m/s, of e b
  static constexpr double kMaxBounce = 100;        // m/s

  template <typename T>
  static bool HasFriction(const StepInput<T>& in, const Candidate& c) {
    return in.ContactOf(c).friction > Base<T>(kMinFriction);
  }

  // Returns the groups of contacts. `flying` has the velocities without contact.
  template <typename T>
  static std::pmr::vector<Group<T>> FindGroups(const StepInput<T>& in, std::span<const State<T>> x,
                                               std::span<const State<T>> flying) {
    using S = Base<T>;
    struct Touching {
      Candidate candidate;
      Separation<T> at;
    };
    std::pmr::vector<Touching> contacts(in.scratch);
    for (const Candidate& c : in.candidates) {
      const Separation<T> at = SeparationAt(in, c, [&](int i) -> Vec2<T> { return x[i].p; });
      const T depth = in.ContactDistance(c) - at.distance;
      if (depth >= S(0) && depth <= S(kMaxDepth)) contacts.push_back({c, at});
    }
    std::pmr::vector<Group<T>> groups(in.scratch);
    const std::pmr::vector<std::size_t> numbers = NumbersOfGroups(in, x.size(), contacts);
    for (std::size_t i = 0; i < contacts.size(); ++i) {
      if (numbers[i] == groups.size()) groups.emplace_back();
      AddRows<T>(in, contacts[i].candidate, contacts[i].at, flying, &groups[numbers[i]]);
    }
    return groups;
  }

  template <typename T>
  static void AddRows(const StepInput<T>& in, const Candidate& c, const Separation<T>& at,
                      std::span<const State<T>> flying, Group<T>* group) {
    using S = Base<T>;
    const Vec2<T> velocity = ContactVelocity<kTurn>(in, c, at.normal, [&](int i) { return TwistOf(flying[i]); });
    const int normal = static_cast<int>(group->size());
    T rhs = -Dot(at.normal, velocity);
    const T& restitution = in.ContactOf(c).restitution;
    const T bounce = restitution * rhs;
    const bool bounced = restitution > S(kMinRestitution) && bounce > S(kBounceThreshold);
    if (bounced) rhs += MinOf(bounce, T(S(kMaxBounce)));
    group->push_back({c, at.normal, at.distance, rhs, normal, bounced});
    if (!HasFriction(in, c)) return;
    const Vec2<T> tangent = Perpendicular(at.normal);
    group->push_back({c, tangent, at.distance, T(-Dot(tangent, velocity)), normal, false, true});
  }

  // Returns an entry of Lambda, 1/kg: the change of velocity along `i` by a unit impulse along `j`.
  template <typename T>
  static T Coupling(const StepInput<T>& in, const Row<T>& i, const Row<T>& j) {
    using S = Base<T>;
    const auto sign_in_j = [&](int disc) {
      return j.candidate.a == disc ? S(1) : !j.candidate.plane && j.candidate.b == disc ? S(-1) : S(0);
    };
    T mobility = in.InverseMassA(i.candidate) * sign_in_j(i.candidate.a);
    if (!i.candidate.plane) mobility -= in.InverseMassB(i.candidate) * sign_in_j(i.candidate.b);
    T coupling = mobility * Dot(i.direction, j.direction);
    if constexpr (kTurn == kSpin) {
      // An impulse along a tangent turns both of its discs the same way.
      const auto add = [&](int disc) {
        const auto& body = in.bodies[disc];
        if (sign_in_j(disc) != S(0)) coupling += body.radius * body.radius * body.inverse_inertia;
      };
      if (!i.tangent || !j.tangent) return coupling;
      add(i.candidate.a);
      if (!i.candidate.plane) add(i.candidate.b);
    }
    return coupling;
  }

  template <int kMaxRows, typename T>
  static BoxedLcpUpTo<kMaxRows> Problem(const StepInput<T>& in, const Group<T>& group) {
    const int n = static_cast<int>(group.size());
    BoxedLcpUpTo<kMaxRows> problem;
    problem.matrix.resize(n, n);
    problem.rhs.resize(n);
    problem.friction.resize(n);
    for (int i = 0; i < n; ++i) {
      for (int j = 0; j < n; ++j) problem.matrix(i, j) = Value(Coupling(in, group[i], group[j]));
      problem.rhs[i] = Value(group[i].rhs);
      problem.friction[i] = Value(in.ContactOf(group[i].candidate).friction);
      problem.normal.push_back(group[i].normal);
    }
    return problem;
  }

  // Returns the impulse of each row: its value from the solution, its derivative from
  //   Q dx_C = db_C - dQ x_C,   x at a bound = +-mu x_n.
  template <int kMaxRows, typename T>
  static std::pmr::vector<T> Impulses(const StepInput<T>& in, const Group<T>& group,
                                      const LcpSolutionUpTo<kMaxRows>& solution) {
    using S = Base<T>;
    const int n = static_cast<int>(group.size());
    std::pmr::vector<T> x(n, T(S(0)), in.scratch);
    for (int i = 0; i < n; ++i) x[i] = T(S(solution.x[i]));
    if constexpr (!std::is_same_v<T, S>) {
      const auto variation = [](const T& value) { return T(value - Value(value)); };
      const auto follow_normals = [&] {
        for (int i = 0; i < n; ++i) {
          const LcpClass c = solution.classes[i];
          if (c != LcpClass::kUpperBound && c != LcpClass::kLowerBound) continue;
          const S sign = c == LcpClass::kUpperBound ? S(1) : S(-1);
          x[i] = S(solution.x[i]) + variation(sign * (in.ContactOf(group[i].candidate).friction * x[group[i].normal]));
        }
      };
      follow_normals();
      const int num_clamping = static_cast<int>(solution.clamping.size());
      std::pmr::vector<T> residual(in.scratch);
      for (int i : solution.clamping) {
        T velocity = group[i].rhs;
        for (int j = 0; j < n; ++j) {
          if (solution.classes[j] != LcpClass::kFree) velocity -= Coupling(in, group[i], group[j]) * x[j];
        }
        residual.push_back(variation(velocity));
      }
      for (int i = 0; i < num_clamping; ++i) {
        for (int j = 0; j < num_clamping; ++j) x[solution.clamping[i]] += S(solution.inverse(i, j)) * residual[j];
      }
      follow_normals();
    }
    return x;
  }

  template <int kMaxRows, typename T>
  void ReportTouches(const StepInput<T>& in, const Group<T>& group, const LcpSolutionUpTo<kMaxRows>& solution) const {
    for (int i = 0; i < static_cast<int>(group.size()); ++i) {
      const bool idle = solution.x[i] == 0 && !complementarity_aware;
      if (group[i].normal != i || idle) continue;
      const LcpClass tangent = HasFriction(in, group[i].candidate) ? solution.classes[i + 1] : LcpClass::kFree;
      in.Report(group[i].candidate, ModeOf(tangent != LcpClass::kFree, tangent == LcpClass::kClamping));
    }
  }

  template <typename T>
  static void ApplyImpulses(const StepInput<T>& in, const Group<T>& group, const std::pmr::vector<T>& x,
                            std::span<State<T>> next) {
    std::pmr::vector<Vec2<T>> momentum(next.size(), Vec2<T>::Zero(), in.scratch);
    for (size_t i = 0; i < group.size(); ++i) {
      const Vec2<T> impulse = Scale(x[i], group[i].direction);
      momentum[group[i].candidate.a] += impulse;
      if (!group[i].candidate.plane) momentum[group[i].candidate.b] -= impulse;
    }
    for (size_t i = 0; i < next.size(); ++i) next[i].v += Scale(in.bodies[i].inverse_mass, momentum[i]);
    if constexpr (kTurn == kSpin) {
      for (size_t i = 0; i < group.size(); ++i) {
        if (!group[i].tangent) continue;
        ApplyAngularImpulse(in, group[i].candidate, x[i], [&](int disc, const T& dw) { next[disc].rotation[1] += dw; });
      }
    }
  }

  // Sets the blocks of one group's published Jacobian in that of free flight. Without `with_bounces`, X = I.
  template <int kMaxRows>
  static void LinearizeGroup(const StepInput<double>& in, std::span<const State<double>> flying,
                             const Group<double>& group, const LcpSolutionUpTo<kMaxRows>& solution, bool with_bounces,
                             Eigen::Ref<Eigen::MatrixXd> A, Eigen::Ref<Eigen::MatrixXd> B);

  // Returns the classes that the sign of the cotangent along the normals asks for (complementarity_aware, above).
  static std::vector<LcpClass> PreferredClasses(const StepInput<double>& in, const Group<double>& group,
                                                const Eigen::VectorXd& cotangent);
};

struct Lcp : LcpOf<0> {
  using Spinning = LcpOf<kSpin>;
};

}  // namespace saltus
