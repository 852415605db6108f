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
// Values by block Gauss-Seidel over contacts, each solved in closed form; derivatives by one Newton correction in the
// active edges of the cones. Everything is differentiated. With d_0 > 0 the force jumps where a contact begins, and the
// error of the gradient does not vanish with the step; with d_0 = 1e-4 over 1 cm it does.
#pragma once

#include <Eigen/Dense>
#include <array>
#include <memory_resource>
#include <vector>

#include "saltus/contact/contact_model.h"
#include "saltus/contact/contact_rows.h"
#include "saltus/physics/power.h"

namespace saltus {

struct SoftConvex {
  static constexpr ModelTraits kTraits = {.name = "soft_convex",
                                          .summary = "regularised convex program with impedance",
                                          .source = "MuJoCo (Todorov 2014)",
                                          .compliant = true,
                                          .double_engine = true,
                                          .rebound = Rebound::kEmergent,
                                          .allocates = true};
  static constexpr int kRotation = 0;
  template <typename T>
  using State = BodyState<T, kRotation>;

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
    visit(ModelOption{"damping", "of closing, 1/s; that of the restitution if negative", -1, 1e6}, damping);
    visit(ModelOption{"tangential_damping", "of sliding, 1/s; 2 sqrt(stiffness) if negative", -1, 1e6},
          tangential_damping);
    visit(ModelOption{"impratio", "of normal to tangential softness", 1e-6, 1e6}, impratio);
    visit(ModelOption{"dmin", "impedance where discs touch", 1e-4, 0.9999}, impedance.at_contact);
    visit(ModelOption{"dmax", "impedance from `width` on", 1e-4, 0.9999}, impedance.at_width);
    visit(ModelOption{"width", "overlap over which the impedance rises, m", 1e-9, 1}, impedance.width);
  }

  template <typename T>
  State<T> Free(const StepInput<T>& in, int i, const State<T>& x) const {
    return SemiImplicitEuler(in, i, x);
  }

  template <typename T>
  void Step(const StepInput<T>& in, std::span<const State<T>> x, std::span<State<T>> next) const {
    FreeFlight(*this, in, x, next);
    const auto groups = FindContactGroups(in, x, [](const T& gap) { return gap < Base<T>(0); });
    for (const ContactGroup<T>& group : groups) {
      const Program<T> program = Pose<T>(in, group, x);
      const std::pmr::vector<T> force = SolveProgram(in, group, program);
      group.Push(force, [&](int i, const Vec2<T>& change) {
        next[i].v += Scale(in.h, change);
        next[i].p += Scale(T(T(in.h) * in.h), change);
      });
    }
  }

 private:
  // 1/2 f^T (A + diag(regularization)) f + f^T c
  template <typename T>
  struct Program {
    std::pmr::vector<T> regularization, c;
  };

  // How a contact pushes: not at all, freely in its cone, or along the edge (1, +-mu).
  enum class Edge { kOpen, kInside, kUpper, kLower };

  template <typename T>
  Program<T> Pose(const StepInput<T>& in, const ContactGroup<T>& group, std::span<const State<T>> x) const {
    using S = Base<T>;
    const int n = group.num_contacts();
    const S at_width = S(impedance.at_width);
    const T normal_damping = damping >= 0 ? T(S(damping)) : DampingOf(in);
    const T sliding_damping =
        tangential_damping >= 0 ? T(S(tangential_damping)) : T(S(2) * SafeSqrt(in.contact.stiffness));
    Program<T> program{std::pmr::vector<T>(group.size(), T(S(0)), in.scratch),
                       std::pmr::vector<T>(group.size(), T(S(0)), in.scratch)};
    for (int row = 0; row < group.size(); ++row) {
      const T& gap = group.contact(group.NormalOf(row)).gap;
      const T d = ImpedanceAt(T(-gap));
      const T regularization = Divide(T(S(1) - d), d) * group.Coupling(group.NormalOf(row), group.NormalOf(row));
      program.regularization[row] = row < n ? regularization : Divide(regularization, S(impratio));
      const T speed = group.Along(row, [&](int i) -> const Vec2<T>& { return x[i].v; });
      T reference = -Divide(T((row < n ? normal_damping : sliding_damping) * speed), at_width);
      if (row < n) reference -= Divide(T(in.contact.stiffness * d * gap), S(at_width * at_width));
      program.c[row] = group.Along(row, [&](int i) -> Vec2<T> { return in.Acceleration(i); }) - reference;
    }
    return program;
  }

  // Twice the damping ratio of a linear spring with the restitution e, times its frequency.
  template <typename T>
  static T DampingOf(const StepInput<T>& in) {
    using std::log;
    using S = Base<T>;
    constexpr double kPi = 3.14159265358979323846;
    const T decrement = log(MaxOf(T(S(1e-6)), in.contact.restitution));
    return S(-2) * Divide(decrement, SafeSqrt(T(decrement * decrement + S(kPi * kPi)))) *
           SafeSqrt(in.contact.stiffness);
  }

  template <typename T>
  T ImpedanceAt(const T& depth) const {
    using S = Base<T>;
    const S middle = S(impedance.middle), power = S(impedance.power);
    T y = T(S(1));
    if (depth < S(impedance.width)) {
      const T x = Divide(depth, S(impedance.width));
      y = x <= middle ? Divide(Power(x, power), S(std::pow(middle, power - S(1))))
                      : T(S(1) - Divide(Power(T(S(1) - x), power), S(std::pow(S(1) - middle, power - S(1)))));
    }
    return S(impedance.at_contact) + y * S(impedance.at_width - impedance.at_contact);
  }

  // The forces of the group's rows.
  template <typename T>
  std::pmr::vector<T> SolveProgram(const StepInput<T>& in, const ContactGroup<T>& group,
                                   const Program<T>& program) const {
    using S = Base<T>;
    using Matrix = typename ContactGroup<T>::Matrix;
    using Vector = typename ContactGroup<T>::Vector;
    const int n = group.num_contacts();
    const S mu = Value(in.contact.friction);
    Matrix H = group.CouplingValues();
    Vector c(group.size());
    for (int i = 0; i < group.size(); ++i) {
      H(i, i) += Value(program.regularization[i]);
      c[i] = Value(program.c[i]);
    }
    Vector f = Vector::Zero(group.size());
    std::vector<Edge> edges(n, Edge::kOpen);
    for (int sweep = 0; sweep < kMaxSweeps; ++sweep) {
      const Vector before = f;
      for (int i = 0; i < n; ++i) SolveContact(group, H, c, mu, i, &f, &edges[i]);
      if ((f - before).cwiseAbs().maxCoeff() <= S(1e-15) * f.cwiseAbs().maxCoeff()) break;
    }
    for (int i = 0; i < n; ++i) {
      if (edges[i] == Edge::kOpen) continue;
      in.Report(group.contact(i).candidate,
                !group.friction()           ? ContactMode::kFrictionless
                : edges[i] == Edge::kInside ? ContactMode::kStick
                                            : ContactMode::kSlip);
    }
    return ForcesAlongEdges(in, group, program, f, edges);
  }

  // The best force of contact i while the others stay.
  template <typename G, typename Matrix, typename Vector, typename S>
  static void SolveContact(const G& group, const Matrix& H, const Vector& c, S mu, int i, Vector* f, Edge* edge) {
    const auto pull = [&](int row, S own, int other, S other_force) {
      return c[row] + H.row(row).dot(*f) - H(row, row) * own - (other < 0 ? S(0) : H(row, other) * other_force);
    };
    if (!group.friction()) {
      const S best = -pull(i, (*f)[i], -1, 0) / H(i, i);
      *edge = best > 0 ? Edge::kInside : Edge::kOpen;
      (*f)[i] = std::max(S(0), best);
      return;
    }
    // Normal and tangent of one contact do not couple: they are orthogonal.
    const int t = i + group.num_contacts();
    const S c_n = pull(i, (*f)[i], t, (*f)[t]), c_t = pull(t, (*f)[t], i, (*f)[i]);
    const S f_n = -c_n / H(i, i), f_t = -c_t / H(t, t);
    if (f_n > 0 && std::abs(f_t) <= mu * f_n) {
      *edge = Edge::kInside;
      (*f)[i] = f_n;
      (*f)[t] = f_t;
      return;
    }
    const S side = c_t < 0 ? S(1) : S(-1), slope = c_n + side * mu * c_t;
    *edge = !(slope < 0) ? Edge::kOpen : side > 0 ? Edge::kUpper : Edge::kLower;
    (*f)[i] = slope < 0 ? -slope / (H(i, i) + mu * mu * H(t, t)) : S(0);
    (*f)[t] = side * mu * (*f)[i];
  }

  // f in T: with E the active edges, f = E alpha and E^T ((A + R) f + c) = 0.
  template <typename T>
  std::pmr::vector<T> ForcesAlongEdges(const StepInput<T>& in, const ContactGroup<T>& group, const Program<T>& program,
                                       const typename ContactGroup<T>::Vector& values,
                                       const std::vector<Edge>& edges) const {
    using S = Base<T>;
    const int n = group.num_contacts(), size = group.size();
    std::pmr::vector<T> f(size, T(S(0)), in.scratch);
    for (int i = 0; i < size; ++i) f[i] = T(values[i]);
    if constexpr (!std::is_same_v<T, S>) {
      // Columns of E: each has an entry in one row, or in a normal row and, +-mu times it, in its tangent.
      struct Column {
        int row;
        S slope;  // +-1 along an edge, else 0
      };
      std::vector<Column> columns;
      for (int i = 0; i < n; ++i) {
        if (edges[i] == Edge::kOpen) continue;
        const S slope = edges[i] == Edge::kInside ? S(0) : edges[i] == Edge::kUpper ? S(1) : S(-1);
        columns.push_back({i, slope});
        if (edges[i] == Edge::kInside && group.friction()) columns.push_back({i + n, S(0)});
        if (slope != 0) f[i + n] = slope * (in.contact.friction * f[i]);
      }
      const auto projected = [&](const Column& column, const auto& row_value) {
        T value = row_value(column.row);
        if (column.slope != 0) value += column.slope * (in.contact.friction * row_value(column.row + n));
        return value;
      };
      const int m = static_cast<int>(columns.size());
      typename ContactGroup<T>::Matrix K(m, m);
      std::pmr::vector<T> residual(in.scratch);
      for (int i = 0; i < m; ++i) {
        residual.push_back(projected(columns[i], [&](int row) {
          T sum = program.c[row] + program.regularization[row] * f[row];
          for (int j = 0; j < size; ++j) sum += group.Coupling(row, j) * f[j];
          return sum;
        }));
        for (int j = 0; j < m; ++j) {
          K(i, j) = Value(projected(columns[i], [&](int row) {
            return projected(columns[j], [&](int other) {
              return row == other ? T(group.Coupling(row, row) + program.regularization[row])
                                  : group.Coupling(row, other);
            });
          }));
        }
      }
      const typename ContactGroup<T>::Matrix inverse = K.inverse();
      for (int i = 0; i < m; ++i) {
        T change = T(S(0));
        for (int j = 0; j < m; ++j) change += inverse(i, j) * (residual[j] - Value(residual[j]));
        f[columns[i].row] -= change;
      }
      for (const Column& column : columns) {
        if (column.slope != 0) f[column.row + n] = column.slope * (in.contact.friction * f[column.row]);
      }
      for (int i = 0; i < size; ++i) f[i].a = values[i];
    }
    return f;
  }

  static constexpr int kMaxSweeps = 1000;
};

}  // namespace saltus
