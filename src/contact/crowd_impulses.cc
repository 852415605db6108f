#include "contact/crowd_impulses.h"

#include <Eigen/SparseCholesky>
#include <algorithm>
#include <cmath>
#include <vector>

namespace saltus {
namespace {

constexpr double kFirstCompliance = 1e-2;  // of a row, relative to its own inverse mass
constexpr double kUsualCompliance = 2e-6;
constexpr double kLeastCompliance = 5e-8;  // where impulses of rows that depend on each other creep
constexpr double kConverged = 1e-13;       // of the largest velocity given
constexpr double kArrived = 1e-9;          // likewise: it is small enough
constexpr int kSweeps = 50;
constexpr int kMostSteps = 300;    // of the augmented Lagrangian
constexpr int kMostNewton = 100;   // in each
constexpr int kMostHalvings = 40;  // of a step of Newton's

using Sparse = Eigen::SparseMatrix<double>;
using Vector = Eigen::VectorXd;

class Solver {
 public:
  Solver(std::span<const double> inverse_mass, std::span<const Vec2d> given, std::span<CrowdRow> rows)
      : inverse_mass_(inverse_mass),
        given_(given),
        velocity_(given.begin(), given.end()),
        rows_(rows),
        mass_(rows.size()),
        presses_(rows.size(), 0),
        number_(given.size(), -1) {
    for (std::size_t i = 0; i < given.size(); ++i) {
      if (inverse_mass[i] > 0) number_[i] = count_++;
    }
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
    double before = HUGE_VAL;
    for (int step = 0; step < kMostSteps; ++step) {
      if (!Minimize()) return false;
      const double missing = UpdateImpulses();
      if (missing <= kConverged * scale_) return true;
      const bool slow = missing > 0.5 * before;
      before = missing;
      if (compliance_ <= kUsualCompliance && missing <= kArrived * scale_) return true;
      if (compliance_ > kUsualCompliance || (slow && compliance_ > kLeastCompliance)) {
        compliance_ *= 0.1;
        factored_ = false;
      }
    }
    return false;
  }
  std::span<const Vec2d> velocity() const { return velocity_; }

 private:
  static double SpeedOf(const CrowdRow& row, std::span<const Vec2d> velocity) {
    const double at_a = Dot(row.direction, velocity[row.a]);
    return row.b >= 0 ? at_a - Dot(row.direction, velocity[row.b]) : at_a;
  }
  double Stiffness(std::size_t k) const { return mass_[k] / compliance_; }

  // Each row in turn with all others held. Returns the largest change of velocity.
  double Sweep(bool back) {
    double change = 0;
    const std::size_t n = rows_.size();
    for (std::size_t j = 0; j < n; ++j) {
      const std::size_t k = back ? n - 1 - j : j;
      CrowdRow& row = rows_[k];
      const double impulse = std::max(0.0, row.impulse - mass_[k] * (SpeedOf(row, velocity_) + row.apart));
      const double more = impulse - row.impulse;
      if (more == 0) continue;
      row.impulse = impulse;
      velocity_[row.a] += inverse_mass_[row.a] * more * row.direction;
      if (row.b >= 0) velocity_[row.b] -= inverse_mass_[row.b] * more * row.direction;
      change = std::max(change, std::abs(more) / mass_[k]);
    }
    return change;
  }

  // The impulse of a row under velocities and its compliance; negative where it would have to pull.
  double TrialOf(std::size_t k, std::span<const Vec2d> velocity) const {
    return rows_[k].impulse - Stiffness(k) * (SpeedOf(rows_[k], velocity) + rows_[k].apart);
  }

  // The velocities under the impulses of compliant rows: the least of a convex function, by Newton's method with a line
  // search. False if that does not arrive.
  bool Minimize() {
    for (int newton = 0; newton < kMostNewton; ++newton) {
      for (std::size_t k = 0; k < rows_.size(); ++k) {
        const char presses = TrialOf(k, velocity_) > 0;
        if (presses != presses_[k]) factored_ = false;
        presses_[k] = presses;
      }
      if (!factored_) Factor();
      if (cholesky_.info() != Eigen::Success) return false;
      std::vector<Vec2d> to = SolveVelocities();
      bool agrees = true;
      for (std::size_t k = 0; k < rows_.size() && agrees; ++k) agrees = (TrialOf(k, to) > 0) == (presses_[k] != 0);
      if (agrees) {
        velocity_ = std::move(to);
        return true;
      }
      if (!GoTowards(to)) return true;  // it is as low as rounding tells
    }
    return false;
  }

  // False if no part of the way is lower.
  bool GoTowards(const std::vector<Vec2d>& to) {
    const std::vector<Vec2d> from = velocity_;
    const double before = Potential(from);
    double part = 1;
    for (int halving = 0; halving < kMostHalvings; ++halving, part *= 0.5) {
      for (std::size_t i = 0; i < from.size(); ++i) velocity_[i] = from[i] + part * (to[i] - from[i]);
      if (Potential(velocity_) < before) return true;
    }
    return false;
  }
  double Potential(std::span<const Vec2d> velocity) const {
    double sum = 0;
    for (std::size_t i = 0; i < velocity.size(); ++i) {
      if (number_[i] >= 0) sum += (velocity[i] - given_[i]).squaredNorm() / inverse_mass_[i];
    }
    for (std::size_t k = 0; k < rows_.size(); ++k) {
      const double impulse = std::max(TrialOf(k, velocity), 0.0);
      sum += impulse * impulse / Stiffness(k);
    }
    return 0.5 * sum;
  }

  int NumberOf(int disc) const { return disc < 0 ? -1 : number_[disc]; }

  void Factor() {
    entries_.clear();
    for (std::size_t i = 0; i < number_.size(); ++i) {
      for (int j = 0; j < 2 && number_[i] >= 0; ++j) {
        entries_.emplace_back(2 * number_[i] + j, 2 * number_[i] + j, 1 / inverse_mass_[i]);
      }
    }
    for (std::size_t k = 0; k < rows_.size(); ++k) {
      if (presses_[k]) AddRow(k);
    }
    Sparse matrix(2 * count_, 2 * count_);
    matrix.setFromTriplets(entries_.begin(), entries_.end());
    cholesky_.compute(matrix);
    factored_ = true;
  }
  // The lower half of what a row adds.
  void AddRow(std::size_t k) {
    const Vec2d& direction = rows_[k].direction;
    const int discs[2] = {NumberOf(rows_[k].a), NumberOf(rows_[k].b)};
    for (int i = 0; i < 2; ++i) {
      for (int j = 0; j < 2; ++j) {
        if (discs[j] < 0 || discs[i] < discs[j]) continue;
        const double sign = i == j ? Stiffness(k) : -Stiffness(k);
        for (int r = 0; r < 2; ++r) {
          for (int c = 0; c < 2; ++c) {
            entries_.emplace_back(2 * discs[i] + r, 2 * discs[j] + c, sign * direction[r] * direction[c]);
          }
        }
      }
    }
  }

  // Under the rows that press.
  std::vector<Vec2d> SolveVelocities() const {
    Vector right = Vector::Zero(2 * count_);
    for (std::size_t i = 0; i < number_.size(); ++i) {
      if (number_[i] >= 0) right.segment<2>(2 * number_[i]) = given_[i] / inverse_mass_[i];
    }
    for (std::size_t k = 0; k < rows_.size(); ++k) {
      if (!presses_[k]) continue;
      const CrowdRow& row = rows_[k];
      const Vec2d push = (row.impulse - Stiffness(k) * row.apart) * row.direction;
      if (NumberOf(row.a) >= 0) right.segment<2>(2 * number_[row.a]) += push;
      if (NumberOf(row.b) >= 0) right.segment<2>(2 * number_[row.b]) -= push;
    }
    const Vector found = cholesky_.solve(right);
    std::vector<Vec2d> velocity(given_.begin(), given_.end());
    for (std::size_t i = 0; i < velocity.size(); ++i) {
      if (number_[i] >= 0) velocity[i] = found.segment<2>(2 * number_[i]);
    }
    return velocity;
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
  std::vector<double> mass_;   // effective masses of the rows, kg
  std::vector<char> presses_;  // of each row: it does
  std::vector<int> number_;    // of the discs that move, else -1
  int count_ = 0;              // of these
  double scale_ = 0;           // m/s
  double compliance_ = kFirstCompliance;
  bool factored_ = false;
  std::vector<Eigen::Triplet<double>> entries_;
  Eigen::SimplicialLDLT<Sparse> cholesky_;  // of the rows that press
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
