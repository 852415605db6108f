// Regularised convex contact: forces as the minimiser of a strictly convex program, in MuJoCo's form (Todorov 2014;
// MuJoCo documentation, "Computation" and "Modeling").
//
// A pair is in contact iff its gap g at the start of the step is negative. With J the rows of a group of contacts,
// A = J M^-1 J^T, and w the relative velocities at the start of the step, the forces of the group are
//
//   f     = argmin 1/2 f^T (A + R) f + f^T (J a - a_ref)   over   f_n >= 0, |f_t| <= mu f_n      a = u/m + g
//   R_n   = (1 - d)/d A_nn,   R_t = R_n / impratio                          d = impedance(-g) in (0, 1)
//   a_ref = -(damping w_n + stiffness d g / d_w) / d_w                      normal
//   a_ref = -2 sqrt(stiffness) w_t / d_w                                    tangential
//   v'    = v + h (a + M^-1 J^T f),   p' = p + h v'
//
// The impedance grows from d_0 at no overlap to d_w at `width`. Stiffness is that of a contact of 1 kg, in N/m, so the
// same number in 1/s^2; damping, 1/s, is that of a linear spring with the scene's restitution unless it is given.
// Damping of the scene is not read.
//
// Values by block Gauss-Seidel over contacts, each solved in closed form, until forces change by no more than rounding;
// a step in which they go on changing is not a number. Derivatives by one Newton correction in the active edges of the
// cones. Everything is differentiated. With d_0 > 0 the force jumps where a contact begins, and the
// error of the gradient does not vanish with the step; with d_0 = 1e-4 over 1 cm it does.
#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <limits>
#include <memory_resource>
#include <vector>

#include "base/power.h"
#include "contact/models/contact_rows.h"
#include "saltus/contact/contact_model.h"

namespace saltus {

template <int kTurn>
struct SoftConvexOf : SemiImplicitFlight<kTurn> {
  static constexpr ModelTraits kTraits = {.name = "soft_convex",
                                          .summary = "regularised convex program with impedance",
                                          .source = "MuJoCo (Todorov 2014)",
                                          .compliant = true,
                                          .double_engine = true,
                                          .rebound = Rebound::kEmergent,
                                          .relative = true,
                                          .by_pair = true};
  template <typename T>
  using State = BodyState<T, kTurn>;
  template <typename T>
  using Group = ContactGroup<T, kTurn>;

  struct Impedance {
    double at_contact = 0.9, at_width = 0.95;  // d_0, d_w
    double width = 1e-3;                       // m
    double middle = 0.5, power = 2;            // of the sigmoid between them
  };

  Impedance impedance;
  double impratio = 1;
  double damping = -1;             // 1/s; that of the restitution if negative
  double tangential_damping = -1;  // 1/s; 2 sqrt(stiffness) if negative
  template <typename Visit>
  void VisitOptions(const Visit& visit) {
    visit(
        ModelOption{
            "damping", "normal damping, 1/s; if negative, the value that gives the restitution of the scene", -1, 1e6},
        damping);
    visit(ModelOption{"tangential_damping", "tangential damping, 1/s; if negative, 2 sqrt(stiffness)", -1, 1e6},
          tangential_damping);
    visit(ModelOption{"impratio", "ratio of normal to tangential softness", 1e-6, 1e6}, impratio);
    visit(ModelOption{"dmin", "impedance at zero overlap", 1e-4, 0.9999}, impedance.at_contact);
    visit(ModelOption{"dmax", "impedance at an overlap of `width` or more", 1e-4, 0.9999}, impedance.at_width);
    visit(ModelOption{"width", "overlap over which the impedance rises, m", 1e-9, 1}, impedance.width);
  }

  template <typename T>
  void Step(const StepInput<T>& in, std::span<const State<T>> x, std::span<State<T>> next) const {
    const std::span<Twist<T, kTurn>> acceleration = in.template Array<Twist<T, kTurn>>(x.size());
    for (std::size_t i = 0; i < x.size(); ++i) {
      acceleration[i] = AccelerationOf<kTurn>(in, static_cast<int>(i));
      next[i] = SemiImplicitEuler(in.h, acceleration[i], x[i]);
    }
    const auto groups = FindContactGroups(in, x, [](const T& gap) { return gap < Base<T>(0); });
    for (const Group<T>& group : groups) {
      const Program<T> program = Pose<T>(in, group, x, acceleration);
      const std::pmr::vector<T> force = SolveProgram(in, group, program);
      group.Push(force, [&](int i, const Twist<T, kTurn>& change) {
        Accelerate(in.h, change, &next[i]);
        next[i].p += Scale(in.h * in.h, change.v);
        if constexpr (kTurn == kSpin) next[i].rotation[0] += in.h * in.h * change.w;
      });
    }
  }

 private:
  // 1/2 f^T H f + f^T c, where H has the diagonal here and otherwise is A.
  template <typename T>
  struct Program {
    std::span<T> diagonal, c;
  };

  using MatrixMap = Eigen::Map<Eigen::MatrixXd>;
  using VectorMap = Eigen::Map<Eigen::VectorXd>;

  template <typename T>
  Program<T> Pose(const StepInput<T>& in, const Group<T>& group, std::span<const State<T>> x,
                  std::span<const Twist<T, kTurn>> acceleration) const {
    using S = Base<T>;
    const int n = group.num_contacts();
    const S at_width = S(impedance.at_width);
    const T sliding_damping = !group.friction()         ? T(S(0))
                              : tangential_damping >= 0 ? T(S(tangential_damping))
                                                        : T(S(2) * SafeSqrt(in.contact.stiffness));
    const Program<T> program{in.template Array<T>(group.size()), in.template Array<T>(group.size())};
    for (int row = 0; row < group.size(); ++row) {
      const T& gap = group.contact(group.NormalOf(row)).gap;
      const T d = ImpedanceAt(T(-gap));
      const T coupling = group.Coupling(row, row), softness = Divide(T(S(1) - d), d);
      program.diagonal[row] = coupling + (row < n ? softness : Divide(softness, S(impratio))) * coupling;
      const T speed = group.RowVelocity(row, [&](int i) { return TwistOf(x[i]); });
      const T normal_damping = row >= n || damping >= 0 ? T(S(damping)) : DampingOf(in, group.candidate(row));
      T reference = -Divide(T((row < n ? normal_damping : sliding_damping) * speed), at_width);
      if (row < n) reference -= Divide(T(in.contact.stiffness * d * gap), S(at_width * at_width));
      program.c[row] = group.RowVelocity(
                           row, [&](int i) -> const auto& { return acceleration[i]; }) -
                       reference;
    }
    return program;
  }

  // Returns 2 zeta(e) sqrt(stiffness): twice damping ratio times frequency of a linear spring with restitution e.
  template <typename T>
  static T DampingOf(const StepInput<T>& in, const Candidate& c) {
    using S = Base<T>;
    const T& restitution = in.ContactOf(c).restitution;
    constexpr S kSquaredPi = S(9.869604401089358);
    const S e = std::max(S(1e-6), Value(restitution)), decrement = std::log(e);
    const S squared = decrement * decrement + kSquaredPi, root = std::sqrt(squared);
    const S zeta = -decrement / root, frequency = std::sqrt(Value(in.contact.stiffness));
    T damping = T(S(2) * zeta * frequency);
    if constexpr (!std::is_same_v<T, S>) {
      const S slope = e > S(1e-6) ? -kSquaredPi / (squared * root * e) : S(0);  // of zeta
      damping.v = S(2) * slope * frequency * restitution.v;
      if (frequency > S(0)) damping.v += zeta / frequency * in.contact.stiffness.v;
    }
    return damping;
  }

  template <typename T>
  T ImpedanceAt(const T& depth) const {
    using S = Base<T>;
    const S middle = S(impedance.middle), power = S(impedance.power);
    T y = T(S(1));
    if (depth < S(impedance.width)) {
      const T x = Divide(depth, S(impedance.width));
      const T from_end = S(1) - x;
      y = x <= middle ? middle * Power(T(Divide(x, middle)), power)
                      : S(1) - (S(1) - middle) * Power(T(Divide(from_end, S(S(1) - middle))), power);
    }
    return S(impedance.at_contact) + y * S(impedance.at_width - impedance.at_contact);
  }

  // Returns the forces of the group's rows, N.
  template <typename T>
  std::pmr::vector<T> SolveProgram(const StepInput<T>& in, const Group<T>& group, const Program<T>& program) const {
    const int size = group.size();
    MatrixMap H(in.template Array<double>(size * size).data(), size, size);
    for (int i = 0; i < size; ++i) {
      for (int j = 0; j < size; ++j) H(i, j) = i == j ? Value(program.diagonal[i]) : group.CouplingValue(i, j);
    }
    const std::span<const double> found = in.Solved([&] { return Minimize<T>(in, group, H, program.c); });
    const auto edge = [&](int i) { return static_cast<LcpClass>(static_cast<int>(found[size + i])); };
    group.Report([&](int row) { return edge(group.NormalOf(row)); });
    std::pmr::vector<T> f(found.begin(), found.begin() + size, in.scratch);
    if constexpr (!std::is_same_v<T, Base<T>>) Differentiate(in, group, program, H, edge, &f);
    return f;
  }

  // Returns the forces as values (not a number if the sweeps do not converge), then the edge of each contact.
  template <typename T>
  static std::span<const double> Minimize(const StepInput<T>& in, const Group<T>& group, const MatrixMap& H,
                                          std::span<const T> linear) {
    const int n = group.num_contacts(), size = group.size();
    const std::span<double> found = in.template Array<double>(size + n);
    VectorMap f(found.data(), size), before(in.template Array<double>(size).data(), size),
        c(in.template Array<double>(size).data(), size);
    f.setZero();
    for (int i = 0; i < size; ++i) c[i] = Value(linear[i]);
    double change = 0;
    for (int sweep = 0; sweep < kMaxSweeps; ++sweep) {
      before = f;
      for (int i = 0; i < n; ++i) {
        const LcpClass edge = SolveContact(group, H, c, Value(group.friction(i)), i, f);
        found[size + i] = static_cast<int>(edge);
      }
      change = (f - before).cwiseAbs().maxCoeff();
      if (change <= 1e-15 * f.cwiseAbs().maxCoeff()) return found;
    }
    // In a large group the sums round to more than the tolerance of the sweeps.
    if (change <= 1e-12 * f.cwiseAbs().maxCoeff()) return found;
    in.Fail("the sweeps for the contact forces do not converge");
    f.setConstant(std::numeric_limits<double>::quiet_NaN());
    return found;
  }

  // Solves for the force of contact i with all others held. Returns its class: no force, inside its cone, or along the
  // edge (1, +-mu).
  template <typename T>
  static LcpClass SolveContact(const Group<T>& group, const MatrixMap& H, const VectorMap& c, double mu, int i,
                               VectorMap f) {
    const auto pull = [&](int row, int without) {
      return c[row] + H.row(row).dot(f) - H(row, row) * f[row] - (without < 0 ? 0 : H(row, without) * f[without]);
    };
    if (!group.friction()) {
      const double best = -pull(i, -1) / H(i, i);
      f[i] = std::max(0.0, best);
      return best > 0 ? LcpClass::kClamping : LcpClass::kFree;
    }
    // Normal and tangent of one contact do not couple: they are orthogonal.
    const int t = i + group.num_contacts();
    const double c_n = pull(i, t), c_t = pull(t, i), f_n = -c_n / H(i, i), f_t = -c_t / H(t, t);
    if (f_n > 0 && std::abs(f_t) <= mu * f_n) {
      f[i] = f_n;
      f[t] = f_t;
      return LcpClass::kClamping;
    }
    const double side = c_t < 0 ? 1 : -1, slope = c_n + side * mu * c_t;
    f[i] = slope < 0 ? -slope / (H(i, i) + mu * mu * H(t, t)) : 0;
    f[t] = side * mu * f[i];
    return !(slope < 0) ? LcpClass::kFree : side > 0 ? LcpClass::kUpperBound : LcpClass::kLowerBound;
  }

  // Adds the derivatives: with E the active edges, f = E alpha and E^T (H f + c) = 0, where H = A + R.
  template <typename T, typename EdgeOf>
  static void Differentiate(const StepInput<T>& in, const Group<T>& group, const Program<T>& program,
                            const MatrixMap& H, const EdgeOf& edge, std::pmr::vector<T>* forces) {
    std::pmr::vector<T>& f = *forces;
    const int n = group.num_contacts(), size = group.size();
    // Columns of E: each has an entry in one row, or in a normal row and, +-mu times it, in its tangent.
    struct Column {
      int row;
      double slope;  // +-1 along an edge, else 0
    };
    std::pmr::vector<Column> columns(in.scratch);
    for (int i = 0; i < n; ++i) {
      if (edge(i) == LcpClass::kFree) continue;
      const double slope = edge(i) == LcpClass::kClamping ? 0 : edge(i) == LcpClass::kUpperBound ? 1 : -1;
      columns.push_back({i, slope});
      if (edge(i) == LcpClass::kClamping && group.friction()) columns.push_back({i + n, 0});
    }
    const auto follow_normals = [&] {
      for (const Column& column : columns) {
        if (column.slope == 0) continue;
        f[column.row + n].v = (column.slope * (group.friction(column.row) * f[column.row])).v;
      }
    };
    follow_normals();
    // Row by row, E^T applied to a vector of numbers of type U.
    const auto project = [&](const Column& column, const auto& friction, const auto& row_value) {
      auto value = row_value(column.row);
      if (column.slope != 0) value += column.slope * (friction(column.row) * row_value(column.row + n));
      return value;
    };
    const auto mu = [&](int i) -> double { return Value(group.friction(i)); };
    const int m = static_cast<int>(columns.size());
    if (m == 0) return;
    MatrixMap K(in.template Array<double>(m * m).data(), m, m),
        changes(in.template Array<double>(m * kJetWidth).data(), m, kJetWidth);
    for (int i = 0; i < m; ++i) {
      const T residual = project(
          columns[i],
          [&](int c) -> const T& { return group.friction(c); },
          [&](int row) {
            T sum = program.c[row] + program.diagonal[row] * f[row];
            for (int j = 0; j < size; ++j) {
              if (j != row) sum += group.Coupling(row, j) * f[j];
            }
            return sum;
          });
      changes.row(i) = -residual.v;
      for (int j = 0; j < m; ++j) {
        K(i, j) = project(
            columns[i], mu, [&](int row) { return project(columns[j], mu, [&](int other) { return H(row, other); }); });
      }
    }
    if (m == 1) {
      changes /= K(0, 0);
    } else {
      SolveCholeskyInPlace(K, changes);
    }
    for (int i = 0; i < m; ++i) f[columns[i].row].v += changes.row(i);
    follow_normals();
  }

  static constexpr int kMaxSweeps = 10000;
};

struct SoftConvex : SoftConvexOf<0> {
  using Spinning = SoftConvexOf<kSpin>;
};

}  // namespace saltus
