#include "contact/solvers/crowd_impulses.h"

#include <algorithm>
#include <cmath>
#include <vector>

#include "base/sparse_factors.h"

namespace saltus {
namespace {

constexpr double kConverged = 1e-13;  // of the largest velocity given
constexpr int kSweeps = 50;
constexpr int kMostCentral = 100;          // steps along the central path
constexpr double kCentralEnd = 1e-12;      // of the largest velocity given
constexpr double kArrived = 1e-6;          // likewise: where rounding may end that, if nothing betters it
constexpr double kLeastPart = 1e-2;        // of a step that is taken, or it ends there
constexpr double kTowardsTheEdge = 0.995;  // of the way to where a push or a gap is 0
constexpr double kCompliance = 2e-6;       // of a row, relative to its own inverse mass
constexpr int kMostMultipliers = 20;       // updates of the augmented Lagrangian
constexpr int kMostNewton = 15;            // steps in all of these
constexpr int kMostHalvings = 50;

using Vector = Eigen::VectorXd;

double SpeedOf(const CrowdRow& row, std::span<const Vec2d> velocity) {
  const double at_a = Dot(row.direction, velocity[row.a]);
  return row.b >= 0 ? at_a - Dot(row.direction, velocity[row.b]) : at_a;
}

// The masses of the discs that move and, of each row, a weight (kg) times the square of its direction: symmetric,
// positive definite, and 0 at the same places whatever the weights.
class WeightedMasses {
 public:
  WeightedMasses(std::span<const double> inverse_mass, std::span<const CrowdRow> rows)
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

  // False if it has no factors.
  bool Factor(std::span<const double> weights) {
    double* values = matrix_.valuePtr();
    std::fill_n(values, matrix_.nonZeros(), 0.0);
    ForEachMass([&](int j, double mass) { matrix_.valuePtr()[matrix_.outerIndexPtr()[j]] = mass; });
    const int* slot = slots_.data();
    ForEachEntry([&](std::size_t k, int, int, double value) { values[*slot++] += weights[k] * value; });
    return cholesky_.FactorAnalyzed(matrix_);
  }

  // The velocities of the discs that move under the momenta `given`; of others 0.
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
  // Of the lower half of what each row adds by a weight of 1.
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
  std::span<const CrowdRow> rows_;
  std::vector<int> number_;  // of the discs that move, else -1
  int count_ = 0;            // of these
  SparseMatrix matrix_;
  std::vector<int> slots_;  // of each entry in the matrix, in the order of ForEachEntry
  SparseLdlt cholesky_;
};

// What the rows of a crowd do to it. Sweeps suffice where few rows depend on each other.
class Solver {
 public:
  Solver(std::span<const double> inverse_mass, std::span<const Vec2d> given, std::span<CrowdRow> rows)
      : inverse_mass_(inverse_mass),
        given_(given),
        velocity_(given.begin(), given.end()),
        rows_(rows),
        mass_(rows.size()),
        weights_(rows.size()) {
    for (std::size_t k = 0; k < rows.size(); ++k) {
      CrowdRow& row = rows_[k];
      const double mobility = inverse_mass[row.a] + (row.b >= 0 ? inverse_mass[row.b] : 0.0);
      mass_[k] = 1 / (mobility * row.direction.squaredNorm());
      row.impulse = 0;
      const double given_here = SpeedOf(row, velocity_);
      scale_ = std::max(scale_, std::abs(given_here));
    }
  }

  bool Run() {
    if (!std::isfinite(scale_)) return false;
    for (int sweep = 0; sweep < kSweeps; ++sweep) {
      if (Sweep(sweep % 2 == 1) <= kConverged * scale_) return true;
    }
    WeightedMasses masses(inverse_mass_, rows_);
    const double left = FollowCentralPath(masses);
    return Polish(masses, left) || left <= kArrived * scale_;
  }
  std::span<const Vec2d> velocity() const { return velocity_; }

 private:
  // Each row in turn with all others held. Returns the largest change of velocity.
  double Sweep(bool back) {
    double change = 0;
    const std::size_t n = rows_.size();
    for (std::size_t j = 0; j < n; ++j) {
      const std::size_t k = back ? n - 1 - j : j;
      CrowdRow& row = rows_[k];
      const double impulse = std::max(0.0, row.impulse - mass_[k] * GapOf(k, velocity_));
      const double more = impulse - row.impulse;
      if (more == 0) continue;
      row.impulse = impulse;
      velocity_[row.a] += inverse_mass_[row.a] * more * row.direction;
      if (row.b >= 0) velocity_[row.b] -= inverse_mass_[row.b] * more * row.direction;
      change = std::max(change, std::abs(more) / mass_[k]);
    }
    return change;
  }

  // m/s; not negative in the end.
  double GapOf(std::size_t k, std::span<const Vec2d> velocity) const {
    return SpeedOf(rows_[k], velocity) + rows_[k].apart;
  }
  static void AddMomentum(const CrowdRow& row, double impulse, std::span<Vec2d> momenta) {
    momenta[row.a] += impulse * row.direction;
    if (row.b >= 0) momenta[row.b] -= impulse * row.direction;
  }
  // What is missing to the given momenta.
  std::vector<Vec2d> MissingMomenta() const {
    std::vector<Vec2d> momenta(given_.size(), Vec2d(0, 0));
    for (std::size_t i = 0; i < momenta.size(); ++i) {
      if (inverse_mass_[i] > 0) momenta[i] = (given_[i] - velocity_[i]) / inverse_mass_[i];
    }
    return momenta;
  }

  // Of a row: its gap and its push, m/s: the impulse by the effective mass. Both stay positive.
  struct Central {
    double gap, push;
    double gap_step = 0, push_step = 0;
    double missing = 0;  // to the gap under the velocities
    double excess = 0;   // of the product of gap and push
  };

  // Mehrotra's predictor and corrector (1992): gaps times pushes go to 0 together, so none of them stops at 0 too
  // early. Ends where rounding ends it, with the nearest that was met. Returns what is left there, m/s.
  double FollowCentralPath(WeightedMasses& masses) {
    std::vector<Central> rows(rows_.size());
    velocity_.assign(given_.begin(), given_.end());
    for (std::size_t k = 0; k < rows.size(); ++k) {
      const double gap = GapOf(k, velocity_);
      rows[k] = {.gap = std::max(gap, scale_), .push = std::max(-gap, scale_)};
    }
    std::vector<Vec2d> nearest;
    double least = HUGE_VAL, part = 1;
    for (int count = 0; count < kMostCentral; ++count) {
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
      if (least <= kCentralEnd * scale_ || part < kLeastPart || !masses.Factor(weights_)) break;
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
  // Newton's, of the velocities, gaps and pushes, to where nothing is missing and there is no excess.
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
  // How much of the step may be taken.
  static double PartOf(std::span<const Central> rows) {
    double part = 1 / kTowardsTheEdge;
    for (const Central& row : rows) {
      if (row.gap_step < 0) part = std::min(part, -row.gap / row.gap_step);
      if (row.push_step < 0) part = std::min(part, -row.push / row.push_step);
    }
    return kTowardsTheEdge * part;
  }
  static double MeanAfter(std::span<const Central> rows, double part) {
    double sum = 0;
    for (const Central& row : rows) sum += (row.gap + part * row.gap_step) * (row.push + part * row.push_step);
    return sum / static_cast<double>(rows.size());
  }

  // The impulses and velocities to the last bit, by an augmented Lagrangian, the rows that press by Newton's method.
  // False, and nothing changed, if that does not lead to better than what was found but for `left`, m/s.
  bool Polish(WeightedMasses& masses, double left) {
    const std::vector<CrowdRow> rows(rows_.begin(), rows_.end());
    const std::vector<Vec2d> velocity = velocity_;
    newton_ = 0;
    presses_.assign(rows.size(), -1);
    double missing = HUGE_VAL;
    for (int step = 0; step < kMostMultipliers && missing > kConverged * scale_; ++step) {
      if (!Minimize(masses)) break;
      missing = UpdateImpulses();
    }
    if (missing < left) return true;
    std::ranges::copy(rows, rows_.begin());
    velocity_ = velocity;
    return false;
  }

  double Stiffness(std::size_t k) const { return mass_[k] / kCompliance; }
  // The impulse of a row under velocities and its compliance; negative where it would have to pull.
  double TrialOf(std::size_t k, std::span<const Vec2d> velocity) const {
    return rows_[k].impulse - Stiffness(k) * GapOf(k, velocity);
  }

  // The velocities under the impulses of compliant rows: the least of a convex function. False if that is not found.
  bool Minimize(WeightedMasses& masses) {
    for (bool first = true; first || ++newton_ < kMostNewton; first = false) {
      bool same = true;
      for (std::size_t k = 0; k < rows_.size(); ++k) {
        const char presses = TrialOf(k, velocity_) > 0;
        same = same && presses == presses_[k];
        presses_[k] = presses;
        weights_[k] = presses ? Stiffness(k) : 0;
      }
      if (!same && !masses.Factor(weights_)) return false;
      std::vector<Vec2d> step = MissingMomenta();
      for (std::size_t k = 0; k < rows_.size(); ++k) {
        if (presses_[k]) AddMomentum(rows_[k], TrialOf(k, velocity_), step);
      }
      masses.Solve(step);
      const double part = LowestOn(step);
      for (std::size_t i = 0; i < step.size(); ++i) velocity_[i] += part * step[i];
      if (part == 1) return true;
    }
    return false;
  }

  // The part of a step at which the function is least; 1 if all the same rows press there. Its slope grows with the
  // part.
  double LowestOn(std::span<const Vec2d> step) const {
    std::vector<double> trial(rows_.size()), change(rows_.size());
    bool agrees = true;
    for (std::size_t k = 0; k < rows_.size(); ++k) {
      trial[k] = TrialOf(k, velocity_);
      change[k] = -Stiffness(k) * SpeedOf(rows_[k], step);
      agrees = agrees && (trial[k] + change[k] > 0) == (presses_[k] != 0);
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
    for (int halving = 0; halving < kMostHalvings; ++halving) {
      const double middle = 0.5 * (low + high);
      (slope(middle) < 0 ? low : high) = middle;
    }
    return low;
  }

  // Returns the largest velocity that was missing.
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
  std::span<CrowdRow> rows_;
  std::vector<double> mass_;     // effective masses of the rows, kg
  std::vector<double> weights_;  // of the rows, kg
  std::vector<char> presses_;    // of each row: it does
  double scale_ = 0;             // m/s
  int newton_ = 0;               // steps in Polish
};

}  // namespace

bool SolveCrowdImpulses(std::span<const double> inverse_mass, std::span<Vec2d> velocity, std::span<CrowdRow> rows) {
  const std::vector<Vec2d> given(velocity.begin(), velocity.end());
  Solver solver(inverse_mass, given, rows);
  if (!solver.Run()) return false;
  std::ranges::copy(solver.velocity(), velocity.begin());
  return true;
}

}  // namespace saltus
