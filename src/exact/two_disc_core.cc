#include "exact/two_disc_core.h"

#include <Eigen/Dense>
#include <cmath>

namespace saltus::exact_internal {
namespace {

constexpr double kClear = 1e-11;  // overlap below this is rounding

Path Straight(const Vec2d& position, const Vec2d& velocity) {
  return {Polynomial{position[0], velocity[0]}, Polynomial{position[1], velocity[1]}};
}

Polynomial Scaled(double s, const Polynomial& p) { return Multiply({s}, p); }

// Returns the distance of a disc to a plane, less its radius, as a polynomial in time.
Polynomial PlaneGap(const Plane& plane, double radius, const Path& path) {
  const Vec2d n = plane.normal.normalized();
  return Add(Add(Scaled(n[0], path[0]), Scaled(n[1], path[1])), {-n.dot(plane.point) - radius});
}

// Returns |first - second|^2 - (contact distance)^2 as a polynomial in time.
Polynomial DiscGap(double contact_distance, const PathPiece& piece) {
  Polynomial gap = {-contact_distance * contact_distance};
  for (int c = 0; c < 2; ++c) {
    const Polynomial d = Add(piece.first[c], Scaled(-1, piece.second[c]));
    gap = Add(gap, Multiply(d, d));
  }
  return gap;
}

const char* WhyNotTwoDiscs(const Scene& scene) {
  if (scene.num_bodies() != 2) return "there must be two discs";
  for (const Body& body : scene.bodies) {
    if (body.fixed) return "a disc is fixed";
  }
  if (scene.control.bodies != std::vector<int>{0}) return "the first disc, and only it, must be pushed";
  if (scene.gravity != Vec2d(0, 0)) return "there is gravity";
  if (scene.contact.friction != 0) return "there is friction";
  if (scene.contact.restitution <= 0) return "restitution is 0";
  if (scene.objective.effort <= 0) return "effort is 0";
  if (scene.objective.terminal.size() != 1) return "the objective must have one terminal term";
  const TerminalTerm& term = scene.objective.terminal[0];
  if (term.body != 1 || term.component || term.quantity != TerminalTerm::Quantity::kPosition || term.weight <= 0) {
    return "the objective must be the second disc's squared distance to a point";
  }
  return nullptr;
}

}  // namespace

std::optional<TwoDiscProblem> MakeTwoDiscProblem(const Scene& scene, TwoDiscSequence sequence, std::string* why_not) {
  if (std::string wrong = WhatIsWrongWith(scene); !wrong.empty()) return Refuse(why_not, wrong);
  if (const char* reason = WhyNotTwoDiscs(scene)) return Refuse(why_not, reason);
  const Body& first = scene.bodies[0];
  const Body& second = scene.bodies[1];
  const TerminalTerm& term = scene.objective.terminal[0];
  TwoDiscProblem problem;
  problem.start = {first.position, first.velocity, second.position, second.velocity};
  problem.contact_distance = first.radius + second.radius;
  problem.mass = first.mass;
  problem.kappa = first.mass * (1 + scene.contact.restitution) / (first.mass + second.mass);
  problem.effort = scene.objective.effort;
  problem.weight = term.weight;
  problem.duration = scene.duration;
  problem.target = term.target;
  if (sequence == TwoDiscSequence::kImpactThenPlane) {
    if (scene.planes.size() != 1) return Refuse(why_not, "there must be one plane");
    if (scene.contact.restitution != 1) return Refuse(why_not, "the plane must be elastic");
    problem.target = Mirror(scene.planes[0], second.radius, term.target);
  }
  return problem;
}

TwoDiscDerivatives DifferentiateTwoDisc(const TwoDiscProblem& problem, double s, double phi) {
  using First = ceres::Jet<double, 2>;
  using Second = ceres::Jet<First, 2>;
  Second jets[2];
  for (int i = 0; i < 2; ++i) {
    jets[i] = ConstantOf<Second>::Make(0);
    jets[i].a = First(i == 0 ? s : phi, i);
    jets[i].v[i] = First(1.0);
  }
  const TwoDiscState<double>& x = problem.start;
  const TwoDiscState<Second> start = {ConstantVector<Second>(x.p1),
                                      ConstantVector<Second>(x.v1),
                                      ConstantVector<Second>(x.p2),
                                      ConstantVector<Second>(x.v2)};
  const TwoDiscLoss<Second> parts = EvaluateTwoDisc(problem, start, jets[0], jets[1]);
  const Second loss = parts.terminal + parts.running;
  TwoDiscDerivatives result;
  result.value = loss.a.a;
  result.gradient = loss.a.v;
  for (int i = 0; i < 2; ++i) result.hessian.row(i) = loss.v[i].v.transpose();
  return result;
}

bool MinimizeTwoDisc(const TwoDiscProblem& problem, bool move_time, double* s, double* phi) {
  constexpr int kMostIterations = 200;
  double damping = 0;
  double last_size = 1;
  TwoDiscDerivatives now = DifferentiateTwoDisc(problem, *s, *phi);
  for (int i = 0; i < kMostIterations; ++i) {
    if (!move_time) {  // freeze s
      now.gradient[0] = now.hessian(0, 1) = now.hessian(1, 0) = 0;
      now.hessian(0, 0) = 1;
    }
    const Eigen::LLT<Eigen::Matrix2d> factor(now.hessian + damping * Eigen::Matrix2d::Identity());
    const Eigen::Vector2d move = -factor.solve(now.gradient);
    const double s_next = *s + move[0];
    const bool usable = factor.info() == Eigen::Success && s_next > 2 * problem.step && s_next < problem.duration;
    const TwoDiscDerivatives next = usable && s_next > 0 ? DifferentiateTwoDisc(problem, s_next, *phi + move[1]) : now;
    const double size = std::hypot(move[0] / problem.duration, move[1]);
    const bool tiny = usable && size < 1e-7;  // near the minimum the loss is flat to rounding; the gradient is not
    if (usable && (tiny || next.value < now.value)) {
      *s = s_next;
      *phi += move[1];
      now = next;
      if (tiny && damping == 0 && (size < 1e-15 || size >= 0.5 * last_size)) return true;  // only rounding moves it now
      last_size = tiny ? size : 1;
      damping = damping < 1e-9 ? 0 : damping * 0.1;
    } else {
      damping = std::max(10 * damping, 1e-6 * (1 + now.hessian.norm()));
      if (!(damping < 1e12)) return false;
    }
  }
  return false;
}

std::optional<std::vector<PathPiece>> PathsAfterImpact(const Scene& scene, TwoDiscSequence sequence, double s,
                                                       const TwoDiscLoss<double>& loss, std::optional<double>* hit) {
  const Body& first = scene.bodies[0];
  const Body& second = scene.bodies[1];
  const double kappa = first.mass * (1 + scene.contact.restitution) / (first.mass + second.mass);
  const Vec2d kick = kappa * loss.speed * loss.n;  // of the second disc
  const Vec2d p2 = second.position + s * second.velocity;
  const Vec2d p1 = p2 - (first.radius + second.radius) * loss.n;
  const Vec2d v1 = loss.w - second.mass / first.mass * kick;
  const Vec2d v2 = second.velocity + kick;
  if (sequence == TwoDiscSequence::kImpact) {
    return std::vector<PathPiece>{{s, scene.duration, Straight(p1, v1), Straight(p2, v2)}};
  }
  const Plane& plane = scene.planes[0];
  const Vec2d n = plane.normal.normalized();
  const double wait = (n.dot(p2 - plane.point) - second.radius) / -n.dot(v2);
  if (!(wait > 0 && wait < scene.duration - s)) return std::nullopt;
  *hit = s + wait;
  const Vec2d rebound = v2 - 2 * n.dot(v2) * n;
  return std::vector<PathPiece>{
      {s, s + wait, Straight(p1, v1), Straight(p2, v2)},
      {s + wait, scene.duration, Straight(p1 + wait * v1, v1), Straight(p2 + wait * v2, rebound)}};
}

bool PathsAreClear(const Scene& scene, const std::vector<PathPiece>& pieces) {
  const double contact_distance = scene.bodies[0].radius + scene.bodies[1].radius;
  for (const PathPiece& piece : pieces) {
    const double length = piece.end - piece.start;
    if (MinimumBetween(DiscGap(contact_distance, piece), 0, length) < -2 * contact_distance * kClear) return false;
    for (const Plane& plane : scene.planes) {
      if (MinimumBetween(PlaneGap(plane, scene.bodies[0].radius, piece.first), 0, length) < -kClear) return false;
      if (MinimumBetween(PlaneGap(plane, scene.bodies[1].radius, piece.second), 0, length) < -kClear) return false;
    }
  }
  return true;
}

}  // namespace saltus::exact_internal
