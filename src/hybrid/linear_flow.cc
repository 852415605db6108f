#include "saltus/internal/linear_flow.h"

#include <glog/logging.h>

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <utility>

namespace saltus {
namespace {

using Entry = LinearFlow::Entry;
constexpr double kLastTerm = 0x1p-60;  // of the series, relative to the first
constexpr int kMostParts = 64;         // of a step; more are taken by squaring
constexpr int kSweeps = 20;            // of the balancing

// Returns the smallest power of a matrix of this pattern that is zero, or 0 if there is none: the number of variables
// on the longest path, if no path returns.
int NilpotencyOf(const std::vector<Entry>& matrix, int size) {
  std::vector<int> reads(size, 0), depth(size, 1);
  for (const Entry& entry : matrix) ++reads[entry.row];
  std::vector<int> ready;
  for (int i = 0; i < size; ++i) {
    if (reads[i] == 0) ready.push_back(i);
  }
  int deepest = 0;
  for (size_t next = 0; next < ready.size(); ++next) {
    deepest = std::max(deepest, depth[ready[next]]);
    for (const Entry& entry : matrix) {
      if (entry.column != ready[next]) continue;
      depth[entry.row] = std::max(depth[entry.row], depth[entry.column] + 1);
      if (--reads[entry.row] == 0) ready.push_back(entry.row);
    }
  }
  return static_cast<int>(ready.size()) == size ? deepest : 0;
}

// Returns the largest sum of a row's absolute values, after changes of units (Osborne) that make it small.
double BalancedNorm(const std::vector<Entry>& matrix, int size) {
  Eigen::MatrixXd balanced = Eigen::MatrixXd::Zero(size, size);
  for (const Entry& entry : matrix) balanced(entry.row, entry.column) = std::abs(entry.value);
  double norm = balanced.rowwise().sum().maxCoeff();
  for (int sweep = 0; sweep < kSweeps; ++sweep) {
    for (int i = 0; i < size; ++i) {
      const double row = balanced.row(i).sum() - balanced(i, i), column = balanced.col(i).sum() - balanced(i, i);
      if (!(row > 0) || !(column > 0)) continue;
      const double unit = std::sqrt(column / row), own = balanced(i, i);
      balanced.row(i) *= unit;
      balanced.col(i) /= unit;
      balanced(i, i) = own;
    }
    norm = std::min(norm, balanced.rowwise().sum().maxCoeff());
  }
  return norm;
}

void AddProduct(const std::vector<Entry>& matrix, const double* by, double* out) {
  for (const Entry& entry : matrix) out[entry.row] += entry.value * by[entry.column];
}

void Multiply(const std::vector<Entry>& matrix, const double* by, int size, double* out) {
  std::fill_n(out, size, 0.0);
  AddProduct(matrix, by, out);
}

// Returns A^(k-1) / k! for k = 2, 3, ... below the power of A that is zero.
std::vector<std::vector<Entry>> TermsOfNilpotent(const std::vector<Entry>& matrix, int size, int nilpotent) {
  Eigen::MatrixXd a = Eigen::MatrixXd::Zero(size, size), term = Eigen::MatrixXd::Identity(size, size);
  for (const Entry& entry : matrix) a(entry.row, entry.column) = entry.value;
  std::vector<std::vector<Entry>> terms;
  for (int k = 2; k <= nilpotent; ++k) {
    term = (a * term / k).eval();
    std::vector<Entry>& entries = terms.emplace_back();
    for (int row = 0; row < size; ++row) {
      for (int column = 0; column < size; ++column) {
        if (term(row, column) != 0) entries.push_back({row, column, term(row, column)});
      }
    }
  }
  return terms;
}

std::vector<Entry> Transposed(std::vector<Entry> matrix) {
  for (Entry& entry : matrix) std::swap(entry.row, entry.column);
  return matrix;
}

}  // namespace

LinearFlow::LinearFlow(int n, int columns, const std::vector<Entry>& entries) : n_(n), columns_(columns), size_(n) {
  CHECK(n > 0 && n <= kMostStates);
  for (const Entry& entry : entries) {
    CHECK(std::isfinite(entry.value));
    if (entry.column <= n) {
      along_.matrix.push_back(entry);
      size_ = std::max(size_, entry.column + 1);
    } else {
      rest_.push_back(entry);
    }
  }
  nilpotent_ = NilpotencyOf(along_.matrix, size_);
  norm_ = BalancedNorm(along_.matrix, size_);
  along_.terms = TermsOfNilpotent(along_.matrix, size_, nilpotent_);
  back_.matrix = Transposed(along_.matrix);
  for (const std::vector<Entry>& term : along_.terms) back_.terms.push_back(Transposed(term));
}

// Returns the parts of a step, so short that the series converges at once, and the terms of the series in each.
LinearFlow::Plan LinearFlow::PlanOf(double h) const {
  if (nilpotent_ > 0) return {1, nilpotent_};
  const double parts = std::max(1.0, std::ceil(norm_ * std::abs(h))), part = norm_ * std::abs(h) / parts;
  int terms = 1;
  for (double term = 1; term > kLastTerm; ++terms) term *= part / (terms + 1);
  return {parts, terms};
}

// Adds Psi slope to `sum`, and A Psi slope to `slope`, for A or its transpose.
void LinearFlow::Sweep(const Series& series, double h, double* slope, double* sum) const {
  double change[kMostStates + 1], term[kMostStates + 1], next[kMostStates + 1];
  const auto advance = [&] {
    for (int i = 0; i < size_; ++i) sum[i] += change[i];
    AddProduct(series.matrix, change, slope);
  };
  if (nilpotent_ > 0) {
    for (int i = 0; i < size_; ++i) change[i] = h * slope[i];
    double power = h;
    for (const std::vector<Entry>& entries : series.terms) {
      power *= h;
      for (const Entry& entry : entries) change[entry.row] += power * entry.value * slope[entry.column];
    }
    return advance();
  }
  const Plan plan = PlanOf(h);
  if (!(plan.parts <= kMostParts)) {
    const Matrix psi = &series == &along_ ? Psi(h) : Matrix(Psi(h).transpose());
    Eigen::Map<Eigen::VectorXd>(change, size_) = psi * Eigen::Map<const Eigen::VectorXd>(slope, size_);
    return advance();
  }
  const double length = h / plan.parts;
  for (int part = 0; part < static_cast<int>(plan.parts); ++part) {
    for (int i = 0; i < size_; ++i) change[i] = term[i] = length * slope[i];
    for (int k = 2; k <= plan.terms; ++k) {
      Multiply(series.matrix, term, size_, next);
      for (int i = 0; i < size_; ++i) change[i] += term[i] = next[i] * (length / k);
    }
    advance();
  }
}

// Computes Psi by doubling: Psi(2 h) = 2 Psi + E Psi and E(2 h) = 2 E + E^2 with E = A Psi, the change of the state by
// itself. Unlike squares of I + E, these keep the relative accuracy of what changes slowly in a stiff flow.
LinearFlow::Matrix LinearFlow::Psi(double h) const {
  int doublings = 0;
  if (const double parts = PlanOf(h).parts; parts > 1) std::frexp(parts, &doublings);
  const double length = std::ldexp(h, -doublings);
  const int terms = PlanOf(length).terms;
  Matrix a = Matrix::Zero(size_, size_);
  for (const Entry& entry : along_.matrix) a(entry.row, entry.column) = entry.value;
  Matrix term = length * Matrix::Identity(size_, size_), psi = term;
  for (int k = 2; k <= terms; ++k) psi += term = (length / k) * (a * term).eval();
  Matrix change = a * psi;
  for (int i = 0; i < doublings; ++i) {
    psi = 2 * psi + (change * psi).eval();
    change = 2 * change + (change * change).eval();
  }
  return psi;
}

void LinearFlow::Step(double h, const double* x, const double* slope, double* after) const {
  double rate[kMostStates + 1], sum[kMostStates + 1];
  std::copy_n(slope, n_, rate);
  std::copy_n(x, n_, sum);
  rate[n_] = 1;  // of the time
  sum[n_] = 0;
  Sweep(along_, h, rate, sum);
  std::copy_n(sum, n_, after);
}

void LinearFlow::Jacobian(double h, double* jacobian) const {
  using RowMajor = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;
  Eigen::Map<RowMajor> out(jacobian, n_, columns_);
  const Matrix psi = Psi(h);
  out.setZero();
  out.leftCols(n_).setIdentity();
  const auto add = [&](const Entry& entry) { out.col(entry.column) += entry.value * psi.col(entry.row).head(n_); };
  for (const Entry& entry : along_.matrix) add(entry);
  for (const Entry& entry : rest_) add(entry);
}

void LinearFlow::PullBack(double h, const double* after, int num_parameters, StepCotangent* out) const {
  double cotangent[kMostStates + 1], sum[kMostStates + 1] = {};
  std::copy_n(after, n_, cotangent);
  cotangent[n_] = 0;
  Sweep(back_, h, cotangent, sum);
  std::copy_n(cotangent, n_, out->x);
  out->t = size_ > n_ ? cotangent[n_] : 0.0;
  for (const Entry& entry : rest_) {
    const int parameter = entry.column - n_ - 1;
    double& by = parameter < num_parameters ? out->p[parameter] : out->u[parameter - num_parameters];
    by += entry.value * sum[entry.row];
  }
}

}  // namespace saltus
