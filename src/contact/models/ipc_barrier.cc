#include "contact/models/ipc_barrier.h"

#include <algorithm>

#include "base/linear_algebra.h"

namespace saltus {
namespace internal {
namespace {

using Energy = BarrierEnergy<double>;

constexpr int kMaxIterations = 300;
constexpr double kArmijo = 1e-4;

std::span<const double> Span(const Eigen::VectorXd& x) { return {x.data(), static_cast<std::size_t>(x.size())}; }

// Position of disc a relative to side b (any foot of the normal serves for a plane), and its relative step.
struct Motion {
  Vec2d from, by;
};
Motion RelativeMotion(const Energy& energy, const Energy::Side& side, const Eigen::VectorXd& x,
                      const Eigen::VectorXd& step) {
  const auto moved = [&](int disc) -> Vec2d {
    const int unknown = energy.discs[disc].unknown;
    return unknown < 0 ? Vec2d(0, 0) : Vec2d(step[unknown], step[unknown + 1]);
  };
  if (side.b < 0) return {energy.Position(Span(x), side.a), moved(side.a)};
  return {energy.Position(Span(x), side.a) - energy.Position(Span(x), side.b), moved(side.a) - moved(side.b)};
}

// Returns the fraction of `step` after which the first gap closes; infinite if none does.
double PartToContact(const Energy& energy, const Eigen::VectorXd& x, const Eigen::VectorXd& step) {
  double part = HUGE_VAL;
  for (const Energy::Side& side : energy.contacts) {
    const Motion m = RelativeMotion(energy, side, x, step);
    if (side.b < 0) {
      const double speed = Dot(side.plane.normal, m.by);
      const double gap = Dot(side.plane.normal, m.from) - side.plane.offset - side.touching;
      if (speed < 0) part = std::min(part, -gap / speed);
      continue;
    }
    const double a = Dot(m.by, m.by), b = Dot(m.from, m.by);
    const double c = Dot(m.from, m.from) - side.touching * side.touching, discriminant = b * b - a * c;
    if (b < 0 && discriminant >= 0) part = std::min(part, c / (-b + std::sqrt(discriminant)));
  }
  return part;
}

// Returns the Newton step of the Hessian, made positive definite by a multiple of the identity; NaN if none suffices.
Eigen::VectorXd DescentStep(const Linearized& at) {
  Eigen::MatrixXd hessian = at.jacobian;
  double shift = 0;
  while (true) {
    if (const std::optional<Eigen::VectorXd> step = SolveCholesky(hessian, -at.residual)) return *step;
    const double before = shift;
    shift = shift == 0 ? 1e-6 * at.jacobian.cwiseAbs().maxCoeff() : 4 * shift;
    if (!std::isfinite(shift)) return Eigen::VectorXd::Constant(at.residual.size(), NAN);
    hessian.diagonal().array() += shift - before;
  }
}

}  // namespace

bool MinimizeBarrierEnergy(const Energy& energy, Eigen::VectorXd* x) {
  double value = energy.Energy(Span(*x));
  for (int iteration = 0; iteration < kMaxIterations; ++iteration) {
    const Linearized at = LinearizeByUnknowns(energy, *x);
    if (!at.residual.allFinite() || !at.jacobian.allFinite()) return false;
    const Eigen::VectorXd step = DescentStep(at);
    if (!step.allFinite()) return false;
    const double size = step.cwiseAbs().maxCoeff();
    if (size <= 1e-15 * (1 + x->cwiseAbs().maxCoeff())) return true;
    const double slope = at.residual.dot(step);
    // A decrease below the rounding of the energy cannot be measured, so such a step is accepted as it is.
    const double rounding = 1e-10 * std::abs(value);
    double length = std::min(1.0, 0.9 * PartToContact(energy, *x, step));
    for (int halving = 0; halving < 60; ++halving, length /= 2) {
      const Eigen::VectorXd tried = *x + length * step;
      const double next = energy.Energy(Span(tried));
      if (!(next <= value + kArmijo * length * slope + rounding)) continue;
      *x = tried;
      value = next;
      break;
    }
  }
  return LinearizeByUnknowns(energy, *x).residual.norm() < 1e-12;
}

bool StaysBeyondRange(const Energy& energy) {
  for (const Energy::Side& side : energy.contacts) {
    const auto target = [&](int disc) -> Vec2d {
      return energy.discs[disc].unknown < 0 ? energy.discs[disc].q : energy.discs[disc].target;
    };
    Vec2d from = energy.discs[side.a].q, by = target(side.a) - from;
    if (side.b < 0) {
      const double gap = Dot(side.plane.normal, from) - side.plane.offset - side.touching;
      if (!(std::min(gap, gap + Dot(side.plane.normal, by)) >= energy.range)) return false;
      continue;
    }
    by -= target(side.b) - energy.discs[side.b].q;
    from -= energy.discs[side.b].q;
    const double length = Dot(by, by);
    const double nearest = length > 0 ? std::clamp(-Dot(from, by) / length, 0.0, 1.0) : 0.0;
    if (!((from + nearest * by).norm() - side.touching >= energy.range)) return false;
  }
  return true;
}

std::string UnsupportedByBarrier(const Scene& scene) {
  if (scene.HasEdges())
    return "walls end: this model keeps gaps open within a step to what is nearest at its start only";
  if (scene.HasPaths()) return "prescribed motions: what moves whatever it meets leaves no gap for a barrier";
  for (int i = 0; i < scene.num_bodies(); ++i) {
    const Body& a = scene.bodies[i];
    for (int j = i + 1; j < scene.num_bodies(); ++j) {
      const Body& b = scene.bodies[j];
      if (a.fixed && b.fixed) continue;
      if (!((a.position - b.position).norm() > a.radius + b.radius)) {
        return a.name + " and " + b.name + " touch at the start: a barrier needs a gap";
      }
    }
    for (const Plane& plane : scene.planes) {
      if (a.fixed) continue;
      const double distance = Dot(Vec2d(plane.normal.normalized()), Vec2d(a.position - plane.point));
      if (!(distance > a.radius)) return a.name + " touches " + plane.name + " at the start: a barrier needs a gap";
    }
  }
  return "";
}

}  // namespace internal
}  // namespace saltus
