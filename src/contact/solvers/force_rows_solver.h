// The linear systems behind event_forces.h: accelerations that must vanish, and the forces that make them do so.
#pragma once

#include <memory_resource>
#include <optional>
#include <span>
#include <vector>

#include "base/linear_algebra.h"
#include "base/local_memory.h"
#include "contact/event/event_forces.h"
#include "contact/solvers/contact_system.h"

namespace saltus {

// An acceleration that must vanish, and the force that makes it do so.
struct ForceRow {
  int contact;
  ContactRow row;
  double turning;
};

// How much the torque of the force of row j changes what row i measures.
inline double TurnCoupling(const ForceRow& i, const ForceRow& j, std::span<const PressingContact> contacts) {
  const PressingContact &c = contacts[i.contact], &d = contacts[j.contact];
  double mobility = 0;
  const auto meet = [&](int p, const PressingContact::Turns& disc, int q) {
    if (p >= 0 && p == q) mobility += disc.radius * disc.radius * disc.inverse_inertia;
  };
  meet(c.a, c.turns_a, d.a);
  meet(c.a, c.turns_a, d.b);
  meet(c.b, c.turns_b, d.a);
  meet(c.b, c.turns_b, d.b);
  return mobility * Dot(Perpendicular(c.normal), i.row.measured) * Dot(Perpendicular(d.normal), j.row.push);
}

// Solves systems of the same rows: small ones densely, large ones sparsely.
class RowSolver {
 public:
  RowSolver(std::span<const ForceRow> rows, std::span<const double> inverse_mass,
            std::span<const PressingContact> contacts, bool turns) {
    LocalMemory memory;
    std::pmr::vector<ContactRow> sides(memory.get());
    sides.reserve(rows.size());
    for (const ForceRow& row : rows) sides.push_back(row.row);
    const int n = static_cast<int>(sides.size());
    if (n > kMostDenseRows && !turns) {
      system_.emplace(sides, inverse_mass);
      return;
    }
    const auto decompose = [&](auto matrix) {
      for (int i = 0; i < n; ++i) {
        for (int j = 0; j < n; ++j) {
          matrix(i, j) = Coupling(sides[i], sides[j], inverse_mass);
          if (turns) matrix(i, j) += TurnCoupling(rows[i], rows[j], contacts);
        }
      }
      dense_.emplace(matrix, kDependentRows);
    };
    if (n <= kMostDenseRows) {
      decompose(SmallMatrix(n, n));
    } else {
      decompose(Eigen::MatrixXd(n, n));
    }
  }
  // Overwrites the right side with the solution. If `hasty`, false where that would take long.
  bool Solve(bool hasty, std::span<double> x) const {
    if (system_ && hasty) return system_->SolveOnlySparse(x);
    if (system_) {
      system_->Solve(x);
      return true;
    }
    Eigen::Map<Eigen::VectorXd> map(x.data(), static_cast<Eigen::Index>(x.size()));
    dense_->Solve(map, map);
    return true;
  }

 private:
  // Not on the heap.
  using SmallMatrix = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, 0, kMostDenseRows, kMostDenseRows>;

  std::optional<LeastNormSolver> dense_;
  std::optional<ContactSystem> system_;
};

}  // namespace saltus
