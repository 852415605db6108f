// Scalar conditions across contacts and the forces that satisfy them, with derivatives, in the event-driven model
// (event.h).
#pragma once

#include <algorithm>
#include <memory>
#include <memory_resource>
#include <type_traits>
#include <vector>

#include "base/scratch_memory.h"
#include "contact/event/event_disc.h"
#include "contact/solvers/contact_system.h"
#include "saltus/contact/step_input.h"
#include "saltus/internal/taped.h"

namespace saltus::internal {

// Returns the factorizations that the owner of the step keeps for the next step, nullptr if it keeps none.
inline ContactSystem::Cache* KeptFactors(std::pmr::memory_resource* scratch) {
  auto* const memory = dynamic_cast<ScratchMemory*>(scratch);
  return memory != nullptr ? &memory->Kept<ContactSystem::Cache>() : nullptr;
}

template <typename T, int kRotation = 0>
class ForceRows {
 public:
  struct Row {
    int a, b;           // b = -1: a wall
    Vec2<T> direction;  // along which the condition is measured
    Vec2<T> push;       // along which the force acts
    T violation;
    T force;
    // The parts of these two along the tangent, where discs that spin turn with it.
    T along = T(0.0), push_along = T(0.0);
    Vec2<T> turning = Vec2<T>(T(0.0), T(0.0));  // rate of change of the direction of the whole force, 1/s
  };

  explicit ForceRows(const StepInput<T>& in)
      : in_(in),
        rows_(in.scratch),
        inverse_mass_(in.scratch),
        turn_mobility_(in.scratch),
        sides_(in.scratch),
        matrix_(in.scratch) {}

  void Clear() {
    rows_.clear();
    if (!inverse_mass_.empty()) return;
    inverse_mass_.reserve(in_.bodies.size());
    for (const BodyConstants<T>& body : in_.bodies) {
      inverse_mass_.push_back(Value(body.inverse_mass));
      if (kRotation == kSpin) turn_mobility_.push_back(body.radius * body.radius * Value(body.inverse_inertia));
    }
  }
  void Add(const Row& row) { rows_.push_back(row); }
  auto begin() { return rows_.begin(); }
  auto end() { return rows_.end(); }
  const Row& operator[](std::size_t row) const { return rows_[row]; }
  // The inverse mass of each disc, 1/kg, as a value.
  std::span<const double> inverse_mass() const { return inverse_mass_; }

  // Sets the forces that undo the violations. A matrix of values is exact: violations are rounding or derivatives only.
  void Solve() {
    const int n = static_cast<int>(rows_.size());
    if (n == 0) return;
    sides_.clear();
    for (const Row& row : rows_) {
      sides_.push_back(
          {row.a, row.b, ValueOf(row.direction), ValueOf(row.push), Value(row.along), Value(row.push_along)});
    }
    if (n > kMostDenseRows && kRotation != kSpin) return SolveAsSystem();
    matrix_.resize(n * n);
    for (int i = 0; i < n; ++i) {
      for (int j = 0; j < n; ++j) matrix_[i * n + j] = Coupling(sides_[i], sides_[j], inverse_mass_, turn_mobility_);
    }
    PseudoInvert(n, matrix_);
    if constexpr (std::is_same_v<T, Taped>) {
      SetForces(std::make_shared<const Inverse>(Inverse{{matrix_.begin(), matrix_.end()}}));
    } else {
      for (int i = 0; i < n; ++i) {
        rows_[i].force = T(0.0);
        for (int j = 0; j < n; ++j) rows_[i].force -= rows_[j].violation * matrix_[i * n + j];
      }
    }
  }

  // Calls apply(disc, change) with the change of the rotation of each disc by the forces.
  template <typename Apply>
  void ForEachTurn(const Apply& apply) const {
    for (const Row& row : rows_) {
      const auto turn = [&](int i) {
        apply(i, T(-(row.force * row.push_along) * (in_.bodies[i].radius * in_.bodies[i].inverse_inertia)));
      };
      turn(row.a);
      if (row.b >= 0) turn(row.b);
    }
  }

  // Calls apply(disc, change) with the change of the position, velocity or acceleration of each disc by the forces.
  template <typename Apply>
  void ForEachPush(const Apply& apply) const {
    for (const Row& row : rows_) {
      apply(row.a, Scale(T(row.force * in_.bodies[row.a].inverse_mass), row.push));
      if (row.b >= 0) apply(row.b, Scale(T(-row.force * in_.bodies[row.b].inverse_mass), row.push));
    }
  }

 private:
  // The inverse of a small system, with the interface of ContactSystem.
  struct Inverse {
    std::vector<double> matrix;
    void Solve(std::span<double> x) const { Multiply(x, x.size(), 1); }
    void SolveTransposed(std::span<double> x) const { Multiply(x, 1, x.size()); }
    void Multiply(std::span<double> x, std::size_t by_row, std::size_t by_column) const {
      const std::vector<double> given(x.begin(), x.end());
      for (std::size_t i = 0; i < x.size(); ++i) {
        x[i] = 0;
        for (std::size_t j = 0; j < x.size(); ++j) x[i] += given[j] * matrix[i * by_row + j * by_column];
      }
    }
  };

  void SolveAsSystem() {
    system_ = std::make_shared<const ContactSystem>(sides_, inverse_mass_, system_.get(), KeptFactors(in_.scratch));
    SetForces(system_);
  }

  template <typename System>
  void SetForces(const std::shared_ptr<const System>& system) {
    const std::size_t n = rows_.size();
    std::vector<double> x(n);
    const auto solve = [&](const auto& part) {
      for (std::size_t i = 0; i < n; ++i) x[i] = part(rows_[i].violation);
      system->Solve(x);
    };
    solve([](const T& violation) { return Value(violation); });
    for (std::size_t i = 0; i < n; ++i) rows_[i].force = T(-x[i]);
    if constexpr (std::is_same_v<T, Taped>) {
      WriteMap(system);
    } else if constexpr (!std::is_same_v<T, double>) {
      for (int direction = 0; direction < kJetWidth; ++direction) {
        solve([&](const T& violation) { return violation.v[direction]; });
        for (std::size_t i = 0; i < n; ++i) rows_[i].force.v[direction] = -x[i];
      }
    }
  }

  template <typename System>
  void WriteMap(const std::shared_ptr<const System>& system) {
    std::vector<Taped> violations, forces;
    bool constant = true;
    for (const Row& row : rows_) {
      violations.push_back(row.violation);
      forces.push_back(row.force);
      constant = constant && row.violation.place() == 0;
    }
    if (constant) return;
    Tape::ThreadTape().AddMap(violations, forces, [system](std::span<const double> outputs, std::span<double> inputs) {
      std::copy(outputs.begin(), outputs.end(), inputs.begin());
      system->SolveTransposed(inputs);
      for (double& input : inputs) input = -input;
    });
    for (std::size_t i = 0; i < rows_.size(); ++i) rows_[i].force = forces[i];
  }

  const StepInput<T>& in_;
  std::pmr::vector<Row> rows_;
  std::pmr::vector<double> inverse_mass_, turn_mobility_;  // per disc; the latter empty if none spins
  std::pmr::vector<ContactRow> sides_;
  std::pmr::vector<double> matrix_;
  std::shared_ptr<const ContactSystem> system_;  // the last large system
};

}  // namespace saltus::internal
