#include "contact/models/qcqp.h"

#include <algorithm>
#include <utility>

#include "base/linear_algebra.h"
#include "contact/solvers/complementarity.h"

namespace saltus {
namespace {

constexpr int kMaxSweeps = 20000;

// Sweeps until nothing changes by more than rounding. Returns false if that takes more than kMaxSweeps.
bool DescendCoordinates(const Eigen::MatrixXd& A, const Eigen::VectorXd& c, const Eigen::VectorXd& low,
                        const Eigen::VectorXd& high, Eigen::VectorXd* x) {
  for (int sweep = 0; sweep < kMaxSweeps; ++sweep) {
    const double change = GaussSeidelSweep(x->size(), [&](std::ptrdiff_t i) {
      const double slope = c[i] + A.row(i).dot(*x);
      const double moved = std::clamp((*x)[i] - slope / A(i, i), low[i], high[i]);
      return std::abs(moved - std::exchange((*x)[i], moved));
    });
    if (change <= 1e-15 * x->cwiseAbs().maxCoeff()) return true;
  }
  return false;
}

// Whether x is the minimum, to rounding: the slope vanishes inside and points out of the box at its sides.
bool IsMinimum(const Eigen::MatrixXd& A, const Eigen::VectorXd& c, const Eigen::VectorXd& low,
               const Eigen::VectorXd& high, const Eigen::VectorXd& x) {
  for (int i = 0; i < x.size(); ++i) {
    const double slope = c[i] + A.row(i).dot(x);
    const double rounding = 1e-12 * (std::abs(c[i]) + A.row(i).cwiseAbs().dot(x.cwiseAbs()));
    if (x[i] > low[i] && slope > rounding) return false;
    if (x[i] < high[i] && slope < -rounding) return false;
  }
  return true;
}

}  // namespace

std::optional<Eigen::VectorXd> SolveBoxQp(const Eigen::MatrixXd& A, const Eigen::VectorXd& c,
                                          const Eigen::VectorXd& low, const Eigen::VectorXd& high,
                                          const Eigen::VectorXd& start) {
  Eigen::VectorXd x = start.cwiseMax(low).cwiseMin(high);
  const bool ended = DescendCoordinates(A, c, low, high, &x);
  std::vector<int> inside;
  for (int i = 0; i < x.size(); ++i) {
    if (x[i] > low[i] && x[i] < high[i]) inside.push_back(i);
  }
  const auto checked = [&](const Eigen::VectorXd& found) -> std::optional<Eigen::VectorXd> {
    if (!found.allFinite() || (!ended && !IsMinimum(A, c, low, high, found))) return std::nullopt;
    return found;
  };
  if (inside.empty()) return checked(x);
  const Eigen::VectorXd slope = c + A * x;
  const Eigen::VectorXd step = LeastNormSolution(A(inside, inside), -slope(inside));
  Eigen::VectorXd polished = x;
  for (std::size_t i = 0; i < inside.size(); ++i) polished[inside[i]] += step[i];
  const bool feasible = (polished.array() >= low.array()).all() && (polished.array() <= high.array()).all();
  return checked(feasible ? polished : x);
}

StaggeredImpulses SolveStaggered(const Eigen::MatrixXd& A, const Eigen::VectorXd& c, const Eigen::VectorXd& friction,
                                 int passes, double tolerance) {
  const int n = static_cast<int>(friction.size()), size = static_cast<int>(c.size());
  const Eigen::VectorXd zero = Eigen::VectorXd::Zero(n);
  const Eigen::VectorXd unbounded = Eigen::VectorXd::Constant(n, std::numeric_limits<double>::infinity());
  StaggeredImpulses result{Eigen::VectorXd::Zero(size), std::vector<LcpClass>(size, LcpClass::kFree), false};
  Eigen::VectorXd& x = result.x;
  for (int pass = 0; pass < passes && !result.converged; ++pass) {
    const Eigen::VectorXd before = x;
    const Eigen::VectorXd pull = c.head(n) + A.topRightCorner(n, size - n) * x.tail(size - n);
    const auto normals = SolveBoxQp(A.topLeftCorner(n, n), pull, zero, unbounded, x.head(n));
    if (!normals) break;
    x.head(n) = *normals;
    if (size > n) {
      const Eigen::VectorXd bound = friction.cwiseProduct(x.head(n));
      const Eigen::VectorXd slide = c.tail(n) + A.bottomLeftCorner(n, n) * x.head(n);
      const auto tangents = SolveBoxQp(A.bottomRightCorner(n, n), slide, -bound, bound, x.tail(n));
      if (!tangents) break;
      x.tail(n) = *tangents;
    }
    result.converged = size == n || (x - before).cwiseAbs().maxCoeff() <= tolerance * x.cwiseAbs().maxCoeff();
  }
  for (int i = 0; i < n; ++i) {
    if (!(x[i] > 0)) continue;
    result.classes[i] = LcpClass::kClamping;
    if (size == n) continue;
    const double bound = friction[i] * x[i];
    result.classes[i + n] = x[i + n] >= bound    ? LcpClass::kUpperBound
                            : x[i + n] <= -bound ? LcpClass::kLowerBound
                                                 : LcpClass::kClamping;
  }
  return result;
}

}  // namespace saltus
