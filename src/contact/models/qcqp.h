// Contact impulses by staggered cone programs (Le Lidec et al. 2021, "Differentiable simulation for physical system
// identification").
//
//   v^f = v + h (u/m + g);  contacts where the gap at the old positions is <= 0; normals N, tangents T of each group
//   normal impulses    l_n = argmin over l >= 0 of        1/2 l^T (N M^-1 N^T) l + l^T (N v^f + N M^-1 T^T l_t + e N v)
//   friction impulses  l_t = argmin over |l_t| <= mu l_n  1/2 l^T (T M^-1 T^T) l + l^T (T v^f + T M^-1 N^T l_n)
//   v'  = v^f + M^-1 (N^T l_n + T^T l_t),   p' = p + h v'
//
// in turn until neither changes by more than `tolerance`. In the plane each friction disc is an interval. The term of
// restitution acts where N v < 0, on the velocity before forces; it is not in the source. If `passes` do not suffice,
// as may happen with much friction, the step has no result: it is not a number.
//
// The derivative is that of the fixed point of both programs in their active sets, not of the passes. Everything is
// differentiated; not differentiable where a contact appears and where an active set changes. Momentum is conserved.
#pragma once

#include <Eigen/Core>
#include <limits>
#include <memory_resource>
#include <optional>
#include <vector>

#include "contact/models/contact_rows.h"
#include "saltus/contact/contact_model.h"

namespace saltus {

// Returns argmin of 1/2 x^T A x + c^T x over low <= x <= high for symmetric positive semidefinite A: coordinate
// descent, then one direct solve for the coordinates that are not at a bound. Returns std::nullopt if the descent does
// not end within its limit of sweeps and the direct solve does not give the minimum either.
std::optional<Eigen::VectorXd> SolveBoxQp(const Eigen::MatrixXd& A, const Eigen::VectorXd& c,
                                          const Eigen::VectorXd& low, const Eigen::VectorXd& high,
                                          const Eigen::VectorXd& start);

struct StaggeredImpulses {
  Eigen::VectorXd x;  // normals, then tangents
  std::vector<LcpClass> classes;
  bool converged = false;
};
// Solves both programs in turn. `c`: N v^f + restitution, then T v^f; without tangents one entry for each contact.
// `friction`: of each contact.
StaggeredImpulses SolveStaggered(const Eigen::MatrixXd& A, const Eigen::VectorXd& c, const Eigen::VectorXd& friction,
                                 int passes, double tolerance);

template <int kTurn>
struct QcqpOf : SemiImplicitFlight<kTurn> {
  static constexpr ModelTraits kTraits = {.name = "qcqp",
                                          .summary = "staggered programs for normal and friction impulses",
                                          .source = "Le Lidec et al. 2021",
                                          .double_engine = true,
                                          .allocates = true,
                                          .relative = true,
                                          .by_pair = true};
  template <typename T>
  using State = BodyState<T, kTurn>;
  template <typename T>
  using Group = ContactGroup<T, kTurn>;

  int passes = 1000;
  double tolerance = 1e-13;  // of the impulses, relative to the largest
  template <typename Visit>
  void VisitOptions(const Visit& visit) {
    visit(ModelOption{"passes", "passes over the two programs", 1, 1e6}, passes);
    visit(ModelOption{"tolerance", "tolerance of the impulses, relative to the largest", 1e-15, 1e-3}, tolerance);
  }

  template <typename T>
  void Step(const StepInput<T>& in, std::span<const State<T>> x, std::span<State<T>> next) const {
    FreeFlight(*this, in, x, next);
    const auto groups = FindContactGroups(in, x, [](const T& gap) { return gap <= 0.0; });
    for (const Group<T>& group : groups) {
      const std::pmr::vector<T> c = Velocities<T>(in, group, x, next);
      Eigen::VectorXd values(group.size());
      for (int row = 0; row < group.size(); ++row) values[row] = Value(c[row]);
      Eigen::VectorXd friction(group.num_contacts());
      for (int i = 0; i < group.num_contacts(); ++i) friction[i] = Value(group.friction(i));
      const StaggeredImpulses solution = SolveStaggered(group.CouplingValues(), values, friction, passes, tolerance);
      group.Report([&](int row) { return solution.classes[row]; });
      std::pmr::vector<T> impulse = ImpulsesInClasses(in, group, c, solution.x, solution.classes);
      if (!solution.converged) {
        in.Fail(
            "the programs for normal and friction impulses do not come to agree within `passes`: raise this option");
        impulse[0] = T(std::numeric_limits<double>::quiet_NaN());
      }
      group.Push(impulse, [&](int i, const Twist<T, kTurn>& change) { Kick(change, in.h, &next[i]); });
    }
  }

 private:
  // Returns the linear terms of both programs, m/s.
  template <typename T>
  static std::pmr::vector<T> Velocities(const StepInput<T>& in, const Group<T>& group, std::span<const State<T>> x,
                                        std::span<const State<T>> flying) {
    std::pmr::vector<T> c(in.scratch);
    for (int row = 0; row < group.size(); ++row) {
      c.push_back(group.RowVelocity(row, [&](int i) { return TwistOf(flying[i]); }));
      if (!group.IsNormal(row)) continue;
      const T before = group.RowVelocity(row, [&](int i) { return TwistOf(x[i]); });
      if (before < 0.0) c.back() += in.ContactOf(group.candidate(row)).restitution * before;
    }
    return c;
  }
};

struct Qcqp : QcqpOf<0> {
  using Spinning = QcqpOf<kSpin>;
};

}  // namespace saltus
