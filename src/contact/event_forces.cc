#include "saltus/contact/event_forces.h"

#include <Eigen/QR>
#include <algorithm>
#include <cmath>

namespace saltus {
namespace {

constexpr int kMaxSweeps = 20000;
constexpr double kConverged = 1e-14;  // of the largest acceleration given
constexpr double kWedged = 1e9;       // likewise
constexpr double kRank = 1e-10;

Vec2d RelativeAcceleration(const PressingContact& c, std::span<const Vec2d> acceleration) {
  if (c.b < 0) return acceleration[c.a];
  return acceleration[c.a] - acceleration[c.b];
}

// One contact with all others held. Returns the change of force over the effective mass, m/s^2. In plain numbers: this
// is where the time goes.
double Relax(double friction, std::span<const double> inverse_mass, std::span<Vec2d> acceleration, PressingContact* c) {
  const double nx = c->normal[0], ny = c->normal[1];
  double* a = acceleration[c->a].data();
  double* b = c->b < 0 ? nullptr : acceleration[c->b].data();
  const double x = b ? a[0] - b[0] : a[0], y = b ? a[1] - b[1] : a[1];
  const double normal_force = std::max(0.0, c->normal_force - c->mass * (nx * x + ny * y + c->turning));
  const double bound = friction * normal_force;
  const double tangential_force = c->sliding == 0
                                      ? std::clamp(c->tangential_force - c->mass * (nx * y - ny * x), -bound, bound)
                                      : -c->sliding * bound;
  const double dn = normal_force - c->normal_force, dt = tangential_force - c->tangential_force;
  c->normal_force = normal_force;
  c->tangential_force = tangential_force;
  const double fx = dn * nx - dt * ny, fy = dn * ny + dt * nx;
  a[0] += inverse_mass[c->a] * fx;
  a[1] += inverse_mass[c->a] * fy;
  if (b) {
    b[0] -= inverse_mass[c->b] * fx;
    b[1] -= inverse_mass[c->b] * fy;
  }
  return (std::abs(dn) + std::abs(dt)) / c->mass;
}

}  // namespace

bool SolvePressingForces(double friction, std::span<const double> inverse_mass, std::span<Vec2d> acceleration,
                         std::span<PressingContact> contacts) {
  double scale = 0;
  for (PressingContact& c : contacts) {
    c.normal_force = c.tangential_force = 0;
    scale = std::max({scale, RelativeAcceleration(c, acceleration).norm(), c.turning});
  }
  for (int sweep = 0; sweep < kMaxSweeps; ++sweep) {
    double change = 0;
    for (PressingContact& c : contacts) change = std::max(change, Relax(friction, inverse_mass, acceleration, &c));
    if (change <= kConverged * scale) break;
    if (change > kWedged * scale) return false;
  }
  return true;
}

void PseudoInvert(int n, std::span<double> matrix) {
  if (n == 1) {
    if (matrix[0] != 0) matrix[0] = 1 / matrix[0];
    return;
  }
  using Matrix = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;
  Eigen::Map<Matrix> map(matrix.data(), n, n);
  Eigen::CompleteOrthogonalDecomposition<Matrix> decomposition;
  decomposition.setThreshold(kRank);
  decomposition.compute(map);
  map = decomposition.pseudoInverse();
}

}  // namespace saltus
