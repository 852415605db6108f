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

void Push(const PressingContact& c, const Vec2d& force, std::span<const double> inverse_mass,
          std::span<Vec2d> acceleration) {
  acceleration[c.a] += inverse_mass[c.a] * force;
  if (c.b >= 0) acceleration[c.b] -= inverse_mass[c.b] * force;
}

// One contact with all others held. Returns the change of force over the effective mass, m/s^2.
double Relax(double friction, std::span<const double> inverse_mass, std::span<Vec2d> acceleration, PressingContact* c) {
  const Vec2d tangent = Perpendicular(c->normal);
  const double closing = Dot(c->normal, RelativeAcceleration(*c, acceleration)) + c->turning;
  const double normal_force = std::max(0.0, c->normal_force - c->mass * closing);
  double tangential_force = -c->sliding * friction * normal_force;
  if (c->sliding == 0) {
    const double slipping = Dot(tangent, RelativeAcceleration(*c, acceleration));
    const double bound = friction * normal_force;
    tangential_force = std::clamp(c->tangential_force - c->mass * slipping, -bound, bound);
  }
  const double dn = normal_force - c->normal_force, dt = tangential_force - c->tangential_force;
  Push(*c, dn * c->normal + dt * tangent, inverse_mass, acceleration);
  c->normal_force = normal_force;
  c->tangential_force = tangential_force;
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
  using Matrix = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;
  Eigen::Map<Matrix> map(matrix.data(), n, n);
  Eigen::CompleteOrthogonalDecomposition<Matrix> decomposition;
  decomposition.setThreshold(kRank);
  decomposition.compute(map);
  map = decomposition.pseudoInverse();
}

}  // namespace saltus
