// Contacts as a linear complementarity problem by projected Gauss-Seidel, differentiated through its sweeps (Tiny
// Differentiable Simulator; Heiden et al. 2021, "NeuralSim"), or by the reverse of the sweeps (after Qiao et al. 2021).
//
//   v^f = v + h (u/m + g)
//   contacts at the old positions, where the gap is negative; rows J and A = J M^-1 J^T + cfm I of each group
//   b_n = -(1 + e) n . w^f - erp gap / h,     b_t = -t . w^f              restitution after forces, no threshold
//   x   = 0; `sweeps` times, row by row:  y = (b_i - sum over j != i of A_ij x_j) / A_ii
//         x_i = max(y, 0) on normals,  y clamped to +-mu x_n on tangents, with the x_n of the same sweep
//   v'  = v^f + M^-1 J^T x,   p' = p + h v'
//
// Both variants have the derivative of exactly this iteration, converged or not; it tends to that of the exact problem
// with the rate of Gauss-Seidel. The reverse sweep keeps one number a row and sweep, and no tape. With erp > 0 bodies
// leave faster than by the restitution, and the gradient grows like erp / h; with erp = 0 overlaps are not corrected.
// Not differentiable where a contact appears and where a row's clamp begins to act. Momentum is conserved.
#pragma once

#include <memory_resource>
#include <span>
#include <type_traits>
#include <vector>

#include "contact/models/contact_rows.h"
#include "saltus/contact/contact_model.h"

namespace saltus {

// Updates one row of A x = b with all others held, within its bounds. Normals are rows [0, num_normals); row
// num_normals + i is the tangent of normal i. Returns the class in which the update left the row.
template <typename T>
LcpClass UpdateRow(std::span<const T> A, std::span<const T> b, const T& friction, int num_normals, int i,
                   std::span<T> x) {
  const int n = static_cast<int>(b.size());
  T rest = b[i];
  for (int j = 0; j < n; ++j) {
    if (j != i) rest -= A[i * n + j] * x[j];
  }
  const T y = Divide(rest, A[i * n + i]);
  if (i < num_normals) {
    const bool free = y > 0.0;
    x[i] = free ? y : T(0.0);
    return free ? LcpClass::kClamping : LcpClass::kFree;
  }
  const T bound = friction * x[i - num_normals];
  const auto kind = y > bound ? LcpClass::kUpperBound : y < -bound ? LcpClass::kLowerBound : LcpClass::kClamping;
  x[i] = kind == LcpClass::kUpperBound ? bound : kind == LcpClass::kLowerBound ? T(-bound) : y;
  return kind;
}

// Projected Gauss-Seidel on values, with a record of all updates for the reverse sweep.
class GaussSeidelSweeps {
 public:
  // Rows [0, n) of A are normals; if there are 2 n rows, row n + i is the tangent of normal i, whose coefficient of
  // friction is friction[kind[i]]. A lies row by row and is to outlive the sweeps, as are `friction` and `kind`, and
  // `memory`, of which they are made.
  GaussSeidelSweeps(std::span<const double> A, std::span<const double> b, std::span<const double> friction,
                    std::span<const int> kind, int sweeps,
                    std::pmr::memory_resource* memory = std::pmr::get_default_resource());

  std::span<const double> x() const { return x_; }
  // Returns the class of a row in its last update.
  LcpClass ClassOf(int row) const;

  // The derivative of x[row] with respect to b, to friction, and to A, in the layout of A.
  struct Derivative {
    std::pmr::vector<double> by_A, by_b, by_friction;
  };
  Derivative Reverse(int row) const;

 private:
  struct Update {
    LcpClass kind;
    double overwritten;  // the value of x before
  };

  std::span<const double> A_;
  std::pmr::vector<double> x_;
  std::span<const double> friction_;
  std::span<const int> kind_;
  int num_normals_;
  std::pmr::vector<Update> updates_;  // row by row, sweep by sweep
};

template <bool kAdjoint, int kTurn>
struct LcpPgsOf : SemiImplicitFlight<kTurn> {
  static constexpr ModelTraits kTraits = {
      .name = kAdjoint ? "lcp_pgs_adjoint" : "lcp_pgs",
      .summary = kAdjoint ? "projected Gauss-Seidel, differentiated by reverse sweeps"
                          : "projected Gauss-Seidel, differentiated through its sweeps",
      .source = kAdjoint ? "after Qiao et al. 2021" : "Tiny Differentiable Simulator (Heiden et al. 2021)",
      .double_engine = true,
      .rebound = Rebound::kEmergent,
      .relative = true,
      .by_pair = true};
  template <typename T>
  using State = BodyState<T, kTurn>;
  template <typename T>
  using Group = ContactGroup<T, kTurn>;

  int sweeps = 50;
  double erp = 0.1;  // part of the overlap that a step corrects
  double cfm = 0;    // 1/kg
  template <typename Visit>
  void VisitOptions(const Visit& visit) {
    visit(ModelOption{"sweeps", "number of Gauss-Seidel sweeps", 1, 1e5}, sweeps);
    visit(ModelOption{"erp", "fraction of the overlap that a step corrects", 0, 1}, erp);
    visit(ModelOption{"cfm", "softness of the constraints, 1/kg", 0, 1e3}, cfm);
  }

  template <typename T>
  void Step(const StepInput<T>& in, std::span<const State<T>> x, std::span<State<T>> next) const {
    FreeFlight(*this, in, x, next);
    const auto groups = FindContactGroups(in, x, [](const T& gap) { return gap < 0.0; });
    for (const Group<T>& group : groups) {
      std::pmr::vector<T> b(in.scratch);
      for (int row = 0; row < group.size(); ++row) {
        const T speed = group.RowVelocity(row, [&](int i) { return TwistOf(next[i]); });
        b.push_back(group.IsNormal(row) ? T(-(in.ContactOf(group.candidate(row)).restitution + 1.0) * speed -
                                            Divide(T(erp * group.contact(row).gap), in.h))
                                        : T(-speed));
      }
      group.Push(Impulses(in, group, b), [&](int i, const Twist<T, kTurn>& change) { Kick(change, in.h, &next[i]); });
    }
  }

 private:
  template <typename T>
  std::pmr::vector<T> Impulses(const StepInput<T>& in, const Group<T>& group, const std::pmr::vector<T>& b) const {
    const int n = group.size();
    std::pmr::vector<T> A(in.scratch);
    const std::span<double> A_values = in.template Array<double>(n * n), b_values = in.template Array<double>(n);
    for (int i = 0; i < n; ++i) {
      for (int j = 0; j < n; ++j) {
        A.push_back(group.Coupling(i, j));
        if (i == j) A.back() += cfm;
        A_values[i * n + j] = Value(A.back());
      }
      b_values[i] = Value(b[i]);
    }
    const std::span<double> friction = in.template Array<double>(in.num_pairs());
    const std::span<int> kind = in.template Array<int>(group.num_contacts());
    for (int pair = 0; pair < in.num_pairs(); ++pair) friction[pair] = Value(in.ContactOfPair(pair).friction);
    for (int i = 0; i < group.num_contacts(); ++i) kind[i] = in.PairOf(group.candidate(i));
    const GaussSeidelSweeps solution(A_values, b_values, friction, kind, sweeps, in.scratch);
    group.Report([&](int row) { return solution.ClassOf(row); });
    std::pmr::vector<T> x(n, T(0.0), in.scratch);
    if constexpr (std::is_same_v<T, double>) {
      for (int i = 0; i < n; ++i) x[i] = solution.x()[i];
    } else if constexpr (kAdjoint) {
      const auto variation = [](const T& value) { return T(value - Value(value)); };
      for (int row = 0; row < n; ++row) {
        const GaussSeidelSweeps::Derivative d = solution.Reverse(row);
        x[row] = T(solution.x()[row]);
        for (int pair = 0; pair < in.num_pairs(); ++pair) {
          x[row] += d.by_friction[pair] * variation(in.ContactOfPair(pair).friction);
        }
        for (int i = 0; i < n; ++i) {
          x[row] += d.by_b[i] * variation(b[i]);
          for (int j = 0; j < n; ++j) x[row] += d.by_A[i * n + j] * variation(A[i * n + j]);
        }
      }
    } else {
      for (int sweep = 0; sweep < sweeps; ++sweep) {
        for (int i = 0; i < n; ++i) {
          UpdateRow<T>(A, b, group.friction(group.NormalOf(i)), group.num_contacts(), i, x);
        }
      }
    }
    return x;
  }
};

template <bool kAdjoint>
struct LcpPgs : LcpPgsOf<kAdjoint, 0> {
  using Spinning = LcpPgsOf<kAdjoint, kSpin>;
};

}  // namespace saltus
