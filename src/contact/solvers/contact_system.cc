#include "contact/solvers/contact_system.h"

#include <algorithm>
#include <cmath>

#include "base/linear_algebra.h"
#include "base/sparse_factors.h"
#include "base/statistics.h"
#include "contact/thresholds.h"

namespace saltus {
namespace {

using Matrix = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;
using Vector = Eigen::VectorXd;

}  // namespace

double Coupling(const ContactRow& i, const ContactRow& j, std::span<const double> inverse_mass,
                std::span<const double> turn_mobility) {
  const auto at_shared = [&](std::span<const double> mobility, double opposite) {
    double sum = 0;
    const auto add = [&](int p, int q, double sign) {
      if (p >= 0 && p == q) sum += sign * mobility[p];
    };
    add(i.a, j.a, 1);
    add(i.b, j.b, 1);
    add(i.a, j.b, opposite);
    add(i.b, j.a, opposite);
    return sum;
  };
  const double coupling = at_shared(inverse_mass, -1) * Dot(i.measured, j.push);
  if (turn_mobility.empty()) return coupling;
  // A force turns both discs the same way, whichever it pushes.
  return coupling + at_shared(turn_mobility, 1) * i.measured_along * j.push_along;
}

void PseudoInvert(int n, std::span<double> matrix) {
  if (n == 1) {
    if (matrix[0] != 0) matrix[0] = 1 / matrix[0];
    return;
  }
  PseudoInvertRows(n, matrix, internal::kDependentRows);
}

struct ContactSystem::Factors {
  SparseLdlt symmetric;
  SparseLu general;
  bool regular = false;
};

ContactSystem::ContactSystem(std::span<const ContactRow> rows, std::span<const double> inverse_mass,
                             const ContactSystem* like, Cache* cache)
    : rows_(rows.begin(), rows.end()), cache_(cache) {
  std::vector<int> number(inverse_mass.size(), -1);
  const auto renumber = [&](int& disc) {
    if (disc >= 0 && inverse_mass[disc] == 0) disc = -1;
    if (disc < 0) return;
    if (number[disc] < 0) {
      number[disc] = static_cast<int>(inverse_mass_.size());
      inverse_mass_.push_back(inverse_mass[disc]);
    }
    disc = number[disc];
  };
  for (ContactRow& row : rows_) {
    renumber(row.a);
    renumber(row.b);
    symmetric_ = symmetric_ && row.measured == row.push;
  }
  if (like != nullptr && HasSamePattern(*like)) factors_ = like->factors_;
}

bool ContactSystem::HasSamePattern(const ContactSystem& other) const {
  const auto near = [](const Vec2d& a, const Vec2d& b) { return (a - b).lpNorm<1>() <= internal::kSystemAlike; };
  const auto alike = [&](const ContactRow& r, const ContactRow& s) {
    return r.a == s.a && r.b == s.b && near(r.measured, s.measured) && near(r.push, s.push);
  };
  return symmetric_ == other.symmetric_ && std::ranges::equal(inverse_mass_, other.inverse_mass_) &&
         std::ranges::equal(rows_, other.rows_, alike);
}

void ContactSystem::Subtract(bool transposed, std::span<const double> x, std::span<double> y) const {
  std::vector<Vec2d> moved(inverse_mass_.size(), Vec2d(0, 0));
  for (std::size_t i = 0; i < rows_.size(); ++i) {
    const ContactRow& row = rows_[i];
    const Vec2d force = x[i] * (transposed ? row.measured : row.push);
    if (row.a >= 0) moved[row.a] += force;
    if (row.b >= 0) moved[row.b] -= force;
  }
  for (std::size_t disc = 0; disc < moved.size(); ++disc) moved[disc] *= inverse_mass_[disc];
  for (std::size_t i = 0; i < rows_.size(); ++i) {
    const ContactRow& row = rows_[i];
    Vec2d relative(0, 0);
    if (row.a >= 0) relative += moved[row.a];
    if (row.b >= 0) relative -= moved[row.b];
    y[i] -= Dot(transposed ? row.push : row.measured, relative);
  }
}

void ContactSystem::FindFactors() const {
  if (cache_ == nullptr) return Factor();
  std::vector<Cache::Known>& known = cache_->known_;
  const auto same = [](const ContactRow& r, const ContactRow& s) {
    return r.a == s.a && r.b == s.b && r.measured == s.measured && r.push == s.push;
  };
  const auto found = std::ranges::find_if(known, [&](const Cache::Known& system) {
    return std::ranges::equal(system.rows, rows_, same) && std::ranges::equal(system.inverse_mass, inverse_mass_);
  });
  if (found == known.end()) {
    Factor();
    if (known.size() == internal::kSystemKeptFactors) known.pop_back();
    known.insert(known.begin(), {rows_, inverse_mass_, factors_});
  } else {
    factors_ = found->factors;
    std::rotate(known.begin(), found, found + 1);
  }
}

void ContactSystem::Factor() const {
  const int n = static_cast<int>(rows_.size());
  std::vector<std::vector<int>> rows_of(inverse_mass_.size());
  std::vector<Eigen::Triplet<double>> entries;
  double largest = 0;
  for (int i = 0; i < n; ++i) {
    for (int disc : {rows_[i].a, rows_[i].b}) {
      if (disc >= 0) rows_of[disc].push_back(i);
    }
  }
  for (std::size_t disc = 0; disc < rows_of.size(); ++disc) {
    for (int i : rows_of[disc]) {
      for (int j : rows_of[disc]) {
        const bool same_side = (rows_[i].a == static_cast<int>(disc)) == (rows_[j].a == static_cast<int>(disc));
        const double coupling = inverse_mass_[disc] * Dot(rows_[i].measured, rows_[j].push);
        entries.emplace_back(i, j, same_side ? coupling : -coupling);
        if (i == j) largest = std::max(largest, std::abs(coupling));
      }
    }
  }
  for (int i = 0; i < n; ++i) entries.emplace_back(i, i, internal::kSystemShift * largest);
  const SparseMatrix matrix = SparseFromEntries(n, entries);
  factors_ = std::make_shared<Factors>();
  if (symmetric_) {
    factors_->regular = factors_->symmetric.Factor(matrix);
  } else {
    factors_->regular = factors_->general.Factor(matrix);
  }
}

bool ContactSystem::SolveSparse(bool transposed, std::span<double> x) const {
  if (Largest(x) == 0) return true;
  if (factors_ == nullptr) FindFactors();
  if (!factors_->regular) return false;
  const auto n = static_cast<Eigen::Index>(x.size());
  const double given = Largest(x);
  Vector left = Eigen::Map<const Vector>(x.data(), n), found = Vector::Zero(n), change(n);
  double undone = given;  // by the last correction
  for (int correction = 0; correction < internal::kSystemMostCorrections && undone > internal::kSystemRemainder * given;
       ++correction) {
    if (symmetric_) {
      change = factors_->symmetric.Solve(left);
    } else {
      change = transposed ? factors_->general.SolveTransposed(left) : factors_->general.Solve(left);
    }
    const Vector before = left;
    Subtract(transposed, {change.data(), x.size()}, {left.data(), x.size()});
    found += change;
    const double now = (before - left).lpNorm<Eigen::Infinity>();
    const bool shrinks = now <= 0.5 * undone || correction == 0;
    undone = now;
    if (!shrinks) break;
  }
  // A residual in the null space of a symmetric matrix remains, as no force can undo it.
  const double missed = symmetric_ ? undone : left.lpNorm<Eigen::Infinity>();
  if (!(missed <= internal::kSystemConverged * given)) return false;
  std::copy(found.begin(), found.end(), x.begin());
  return true;
}

void ContactSystem::SolveDense(bool transposed, std::span<double> x) const {
  const int n = static_cast<int>(rows_.size());
  if (dense_.empty()) {
    dense_.resize(static_cast<std::size_t>(n) * n);
    for (int i = 0; i < n; ++i) {
      for (int j = 0; j < n; ++j) dense_[i * n + j] = Coupling(rows_[i], rows_[j], inverse_mass_);
    }
    PseudoInvert(n, dense_);
  }
  const Eigen::Map<const Matrix> inverse(dense_.data(), n, n);
  Eigen::Map<Vector> map(x.data(), n);
  map = transposed ? Vector(inverse.transpose() * map) : Vector(inverse * map);
}

bool ContactSystem::SolveAs(bool transposed, std::span<double> x) const {
  const bool sparse = SolveSparse(transposed, x);
  if (!sparse) SolveDense(transposed, x);
  return sparse;
}

}  // namespace saltus
