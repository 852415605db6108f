#include "contact/solvers/impulse_qp.h"

#include <algorithm>
#include <cmath>
#include <vector>

#include "base/sparse_factors.h"
#include "contact/solvers/complementarity.h"
#include "contact/thresholds.h"

namespace saltus {
namespace {

using Vector = Eigen::VectorXd;

double SpeedOf(const ImpulseRow& row, std::span<const Vec2d> velocity) {
  const double at_a = Dot(row.direction, velocity[row.a]);
  return row.b >= 0 ? at_a - Dot(row.direction, velocity[row.b]) : at_a;
}

// The sum of the masses of the discs that move and, for each row, a weight (kg) times the square of its direction. It
// is symmetric and positive definite; its sparsity pattern does not depend on the weights.
class WeightedMasses {
 public:
  WeightedMasses(std::span<const double> inverse_mass, std::span<const ImpulseRow> rows)
      : inverse_mass_(inverse_mass), rows_(rows), number_(inverse_mass.size(), -1) {
    for (std::size_t i = 0; i < number_.size(); ++i) {
      if (inverse_mass[i] > 0) number_[i] = count_++;
    }
    std::vector<Eigen::Triplet<double>> entries;
    ForEachMass([&](int j, double mass) { entries.emplace_back(j, j, mass); });
    ForEachEntry([&](std::size_t, int row, int column, double value) { entries.emplace_back(row, column, value); });
    matrix_ = SparseFromEntries(2 * count_, entries);
    ForEachEntry([&](std::size_t, int row, int column, double) {
      slots_.push_back(static_cast<int>(&matrix_.coeffRef(row, column) - matrix_.valuePtr()));
    });
    cholesky_.Analyze(matrix_);
  }

  // Returns false if the factorization fails.
  bool Factor(std::span<const double> weights) {
    double* values = matrix_.valuePtr();
    std::fill_n(values, matrix_.nonZeros(), 0.0);
    ForEachMass([&](int j, double mass) { matrix_.valuePtr()[matrix_.outerIndexPtr()[j]] = mass; });
    const int* slot = slots_.data();
    ForEachEntry([&](std::size_t k, int, int, double value) { values[*slot++] += weights[k] * value; });
    return cholesky_.FactorAnalyzed(matrix_);
  }

  // Sets the velocities of the moving discs to those under the momenta `given`, of others to 0.
  void Solve(std::span<Vec2d> x) const {
    Vector right(2 * count_);
    for (std::size_t i = 0; i < number_.size(); ++i) {
      if (number_[i] >= 0) right.segment<2>(2 * number_[i]) = x[i];
    }
    const Vector found = cholesky_.Solve(right);
    for (std::size_t i = 0; i < number_.size(); ++i) {
      x[i] = number_[i] >= 0 ? Vec2d(found.segment<2>(2 * number_[i])) : Vec2d(0, 0);
    }
  }

 private:
  template <typename Visit>
  void ForEachMass(Visit visit) const {
    for (std::size_t i = 0; i < number_.size(); ++i) {
      for (int j = 0; j < 2 && number_[i] >= 0; ++j) visit(2 * number_[i] + j, 1 / inverse_mass_[i]);
    }
  }
  // Calls visit for each entry that a row with weight 1 adds to the lower half of the matrix.
  template <typename Visit>
  void ForEachEntry(Visit visit) const {
    for (std::size_t k = 0; k < rows_.size(); ++k) {
      const Vec2d& direction = rows_[k].direction;
      const int discs[2] = {number_[rows_[k].a], rows_[k].b < 0 ? -1 : number_[rows_[k].b]};
      for (int i = 0; i < 2; ++i) {
        for (int j = 0; j < 2; ++j) {
          if (discs[j] < 0 || discs[i] < discs[j]) continue;
          const double sign = i == j ? 1 : -1;
          for (int r = 0; r < 2; ++r) {
            for (int c = 0; c <= (i == j ? r : 1); ++c) {
              visit(k, 2 * discs[i] + r, 2 * discs[j] + c, sign * direction[r] * direction[c]);
            }
          }
        }
      }
    }
  }

  std::span<const double> inverse_mass_;
  std::span<const ImpulseRow> rows_;
  std::vector<int> number_;  // of the discs that move, else -1
  int count_ = 0;            // of these
  SparseMatrix matrix_;
  std::vector<int> slots_;  // of each entry in the matrix, in the order of ForEachEntry
  SparseLdlt cholesky_;
};

class ImpulseSolver {
 public:
  ImpulseSolver(std::span<const double> inverse_mass, std::span<const Vec2d> given, std::span<ImpulseRow> rows)
      : inverse_mass_(inverse_mass),
        given_(given),
        velocity_(given.begin(), given.end()),
        rows_(rows),
        mass_(rows.size()),
        weights_(rows.size()) {
    for (std::size_t k = 0; k < rows.size(); ++k) {
      ImpulseRow& row = rows_[k];
      const double mobility = inverse_mass[row.a] + (row.b >= 0 ? inverse_mass[row.b] : 0.0);
      mass_[k] = 1 / (mobility * row.direction.squaredNorm());
      row.impulse = 0;
      const double given_here = SpeedOf(row, velocity_);
      scale_ = std::max(scale_, std::abs(given_here));
    }
  }

  bool Run() {
    if (!std::isfinite(scale_)) return false;
    for (int sweep = 0; sweep < internal::kQpSweeps; ++sweep) {
      if (Sweep(sweep % 2 == 1) <= internal::kQpConverged * scale_) return true;
    }
    WeightedMasses masses(inverse_mass_, rows_);
    const double left = FollowCentralPath(masses);
    return Polish(masses, left) || left <= internal::kQpNearly * scale_;
  }
  std::span<const Vec2d> velocity() const { return velocity_; }

 private:
  // Makes one sweep of projected Gauss-Seidel; returns the largest change of velocity, m/s.
  double Sweep(bool backwards) {
    return GaussSeidelSweep(
        std::ssize(rows_),
        [&](std::ptrdiff_t k) {
          ImpulseRow& row = rows_[k];
          const double impulse = std::max(0.0, row.impulse - mass_[k] * GapOf(k, velocity_));
          const double more = impulse - row.impulse;
          if (more == 0) return 0.0;
          row.impulse = impulse;
          velocity_[row.a] += inverse_mass_[row.a] * more * row.direction;
          if (row.b >= 0) velocity_[row.b] -= inverse_mass_[row.b] * more * row.direction;
          return std::abs(more) / mass_[k];
        },
        backwards);
  }

  // Returns the rate of the gap of a row, m/s, which is not negative in the solution.
  double GapOf(std::size_t k, std::span<const Vec2d> velocity) const {
    return SpeedOf(rows_[k], velocity) + rows_[k].apart;
  }
  static void AddMomentum(const ImpulseRow& row, double impulse, std::span<Vec2d> momenta) {
    momenta[row.a] += impulse * row.direction;
    if (row.b >= 0) momenta[row.b] -= impulse * row.direction;
  }
  // Returns the given momenta less those of the velocities, N s.
  std::vector<Vec2d> MissingMomenta() const {
    std::vector<Vec2d> momenta(given_.size(), Vec2d(0, 0));
    for (std::size_t i = 0; i < momenta.size(); ++i) {
      if (inverse_mass_[i] > 0) momenta[i] = (given_[i] - velocity_[i]) / inverse_mass_[i];
    }
    return momenta;
  }

  // A row of an iterate on the central path. Gap and push stay positive.
  struct Central {
    double gap, push;  // m/s; the push is the impulse divided by the effective mass
    double gap_step = 0, push_step = 0;
    double missing = 0;  // difference of the gap under the velocities to `gap`
    double excess = 0;   // of the product of gap and push
  };

  // Mehrotra's predictor and corrector (1992), along the central path, on which all products of gap and push are the
  // same. Ends where rounding does not let it go on, with the best iterate. Returns the residual of that, m/s.
  double FollowCentralPath(WeightedMasses& masses) {
    std::vector<Central> rows(rows_.size());
    velocity_.assign(given_.begin(), given_.end());
    for (std::size_t k = 0; k < rows.size(); ++k) {
      const double gap = GapOf(k, velocity_);
      rows[k] = {.gap = std::max(gap, scale_), .push = std::max(-gap, scale_)};
    }
    std::vector<Vec2d> nearest;
    double least = HUGE_VAL, part = 1;
    for (int count = 0; count < internal::kQpMostCentral; ++count) {
      double mean = 0, left = 0;
      for (std::size_t k = 0; k < rows.size(); ++k) {
        Central& row = rows[k];
        row.missing = GapOf(k, velocity_) - row.gap;
        row.excess = row.gap * row.push;
        mean += row.excess / static_cast<double>(rows.size());
        left = std::max({left, std::abs(row.missing), std::min(row.gap, row.push)});
        weights_[k] = mass_[k] * row.push / row.gap;
      }
      if (left < least) {
        least = left;
        nearest = velocity_;
        for (std::size_t k = 0; k < rows.size(); ++k) {
          rows_[k].impulse = rows[k].push > rows[k].gap ? mass_[k] * rows[k].push : 0.0;
        }
      }
      if (least <= internal::kQpCentralEnd * scale_ || part < internal::kQpLeastPart || !masses.Factor(weights_)) break;
      FindStep(masses, rows);
      const double predicted = MeanAfter(rows, PartOf(rows));
      const double centre = std::pow(predicted / mean, 3) * mean;
      for (Central& row : rows) row.excess += row.gap_step * row.push_step - centre;
      const std::vector<Vec2d> step = FindStep(masses, rows);
      part = PartOf(rows);
      for (std::size_t i = 0; i < step.size(); ++i) velocity_[i] += part * step[i];
      for (Central& row : rows) {
        row.gap += part * row.gap_step;
        row.push += part * row.push_step;
      }
    }
    velocity_ = nearest;
    return least;
  }
  // Returns the Newton step of velocities, gaps and pushes to where `missing` and `excess` are zero.
  std::vector<Vec2d> FindStep(const WeightedMasses& masses, std::span<Central> rows) const {
    std::vector<Vec2d> step = MissingMomenta();
    for (std::size_t k = 0; k < rows.size(); ++k) {
      const Central& row = rows[k];
      AddMomentum(rows_[k], mass_[k] * (row.push - (row.excess + row.push * row.missing) / row.gap), step);
    }
    masses.Solve(step);
    for (std::size_t k = 0; k < rows.size(); ++k) {
      Central& row = rows[k];
      row.gap_step = SpeedOf(rows_[k], step) + row.missing;
      row.push_step = -(row.excess + row.push * row.gap_step) / row.gap;
    }
    return step;
  }
  // Returns the fraction of the step up to which gaps and pushes stay positive.
  static double PartOf(std::span<const Central> rows) {
    double part = 1 / internal::kQpToBoundary;
    for (const Central& row : rows) {
      if (row.gap_step < 0) part = std::min(part, -row.gap / row.gap_step);
      if (row.push_step < 0) part = std::min(part, -row.push / row.push_step);
    }
    return internal::kQpToBoundary * part;
  }
  static double MeanAfter(std::span<const Central> rows, double part) {
    double sum = 0;
    for (const Central& row : rows) sum += (row.gap + part * row.gap_step) * (row.push + part * row.push_step);
    return sum / static_cast<double>(rows.size());
  }

  // Refines impulses and velocities to rounding by an augmented Lagrangian, with its active rows by Newton's method.
  // Returns false, and changes nothing, if the residual is not smaller than `left`, m/s.
  bool Polish(WeightedMasses& masses, double left) {
    const std::vector<ImpulseRow> rows(rows_.begin(), rows_.end());
    const std::vector<Vec2d> velocity = velocity_;
    newton_ = 0;
    active_.assign(rows.size(), -1);
    double missing = HUGE_VAL;
    for (int step = 0; step < internal::kQpMostMultipliers && missing > internal::kQpConverged * scale_; ++step) {
      if (!Minimize(masses)) break;
      missing = UpdateImpulses();
    }
    if (missing < left) return true;
    std::ranges::copy(rows, rows_.begin());
    velocity_ = velocity;
    return false;
  }

  double Stiffness(std::size_t k) const { return mass_[k] / internal::kQpCompliance; }
  // Returns the impulse of a row under given velocities and its compliance, N s; negative if it would pull.
  double TrialOf(std::size_t k, std::span<const Vec2d> velocity) const {
    return rows_[k].impulse - Stiffness(k) * GapOf(k, velocity);
  }

  // Finds the velocities under the impulses of compliant rows, which minimise a convex function. Returns false if they
  // are not found.
  bool Minimize(WeightedMasses& masses) {
    for (bool first = true; first || ++newton_ < internal::kQpMostNewton; first = false) {
      bool same = true;
      for (std::size_t k = 0; k < rows_.size(); ++k) {
        const char active = TrialOf(k, velocity_) > 0;
        same = same && active == active_[k];
        active_[k] = active;
        weights_[k] = active ? Stiffness(k) : 0;
      }
      if (!same && !masses.Factor(weights_)) return false;
      std::vector<Vec2d> step = MissingMomenta();
      for (std::size_t k = 0; k < rows_.size(); ++k) {
        if (active_[k]) AddMomentum(rows_[k], TrialOf(k, velocity_), step);
      }
      masses.Solve(step);
      const double part = LowestOn(step);
      for (std::size_t i = 0; i < step.size(); ++i) velocity_[i] += part * step[i];
      if (part == 1) return true;
    }
    return false;
  }

  // Returns the fraction of a step at which the function is smallest; 1 if the same rows are active there. The function
  // is convex: its slope grows along the step.
  double LowestOn(std::span<const Vec2d> step) const {
    std::vector<double> trial(rows_.size()), change(rows_.size());
    bool agrees = true;
    for (std::size_t k = 0; k < rows_.size(); ++k) {
      trial[k] = TrialOf(k, velocity_);
      change[k] = -Stiffness(k) * SpeedOf(rows_[k], step);
      agrees = agrees && (trial[k] + change[k] > 0) == (active_[k] != 0);
    }
    if (agrees) return 1;
    const std::vector<Vec2d> missing = MissingMomenta();
    double inertia = 0, start = 0;
    for (std::size_t i = 0; i < step.size(); ++i) {
      if (!(inverse_mass_[i] > 0)) continue;
      start -= Dot(missing[i], step[i]);
      inertia += step[i].squaredNorm() / inverse_mass_[i];
    }
    const auto slope = [&](double part) {
      double sum = start + part * inertia;
      for (std::size_t k = 0; k < rows_.size(); ++k) {
        sum += std::max(trial[k] + part * change[k], 0.0) * change[k] / Stiffness(k);
      }
      return sum;
    };
    double low = 0, high = 1;
    for (int halving = 0; halving < internal::kQpMostHalvings; ++halving) {
      const double middle = 0.5 * (low + high);
      (slope(middle) < 0 ? low : high) = middle;
    }
    return low;
  }

  // Updates the multipliers (impulses); returns the largest violation before, m/s.
  double UpdateImpulses() {
    double missing = 0;
    for (std::size_t k = 0; k < rows_.size(); ++k) {
      const double impulse = std::max(TrialOf(k, velocity_), 0.0);
      missing = std::max(missing, std::abs(impulse - rows_[k].impulse) / Stiffness(k));
      rows_[k].impulse = impulse;
    }
    return missing;
  }

  std::span<const double> inverse_mass_;
  std::span<const Vec2d> given_;
  std::vector<Vec2d> velocity_;
  std::span<ImpulseRow> rows_;
  std::vector<double> mass_;     // effective masses of the rows, kg
  std::vector<double> weights_;  // of the rows, kg
  std::vector<char> active_;     // of each row
  double scale_ = 0;             // m/s
  int newton_ = 0;               // Newton steps in Polish
};

}  // namespace

bool SolveImpulseQp(std::span<const double> inverse_mass, std::span<Vec2d> velocity, std::span<ImpulseRow> rows) {
  const std::vector<Vec2d> given(velocity.begin(), velocity.end());
  ImpulseSolver solver(inverse_mass, given, rows);
  if (!solver.Run()) return false;
  std::ranges::copy(solver.velocity(), velocity.begin());
  return true;
}

}  // namespace saltus
