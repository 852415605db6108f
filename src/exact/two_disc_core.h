// The common part of the optima in continuous time and on a time grid: the loss as a function of the time and the angle
// of the impact, Newton's method on it, and a check of the paths. See saltus/exact/two_disc_optimum.h.
#pragma once

#include <ceres/jet.h>

#include <optional>
#include <string>
#include <vector>

#include "exact/flow.h"
#include "exact/two_disc_optimum.h"

namespace saltus::exact_internal {

// Makes a constant in T, which may be a Jet over Jets.
template <typename T>
struct ConstantOf {
  static T Make(double value) { return T(value); }
};
template <typename S, int W>
struct ConstantOf<ceres::Jet<S, W>> {
  static ceres::Jet<S, W> Make(double value) { return ceres::Jet<S, W>(ConstantOf<S>::Make(value)); }
};
template <typename T>
Vec2<T> ConstantVector(const Vec2d& value) {
  return {ConstantOf<T>::Make(value[0]), ConstantOf<T>::Make(value[1])};
}

// The initial state of both discs, by which the loss is differentiated.
template <typename T>
struct TwoDiscState {
  Vec2<T> p1, v1, p2, v2;
};

struct TwoDiscProblem {
  TwoDiscState<double> start;
  double contact_distance = 0;  // r1 + r2
  double mass = 1;              // m1
  double kappa = 1;             // m1 (1 + e) / (m1 + m2)
  double effort = 0;
  double weight = 1;
  double duration = 1;
  Vec2d target = Vec2d::Zero();  // unfolded
  double step = 0;               // length of the control's constant pieces; 0 for any control
};

// Returns the problem of `scene`, or std::nullopt and a reason. `step` is 0.
std::optional<TwoDiscProblem> MakeTwoDiscProblem(const Scene& scene, TwoDiscSequence sequence, std::string* why_not);

template <typename T>
struct TwoDiscLoss {
  T terminal;
  T running;
  Vec2<T> n;      // normal
  Vec2<T> w;      // first disc's velocity before the impact
  Vec2<T> alpha;  // the acceleration is beta + alpha (s - t), at the middle of its step if there are steps
  Vec2<T> beta;
  T speed;  // n.(w - v2)
};

// The least loss with the impact at time s and angle phi. With steps of length h, s is a multiple of h (at least 2 h).
//
// The least-norm acceleration a(t) that covers D and gains W has the Gram matrix M of (s - t, 1), which for means over
// steps is [[s^3/3 - s h^2/12, s^2/2], [s^2/2, s]]. Effort = effort m1^2 (A |D|^2 + 2 B D.W + C |W|^2), with A, B, C
// the entries of the inverse of M.
template <typename T>
TwoDiscLoss<T> EvaluateTwoDisc(const TwoDiscProblem& problem, const TwoDiscState<T>& start, const T& s, const T& phi) {
  using std::cos;
  using std::sin;
  const auto constant = [](double value) { return ConstantOf<T>::Make(value); };
  const double h2 = problem.step * problem.step;
  const T spread = s * s - constant(h2);
  const T a = constant(12) / (s * spread);
  const T b = constant(-6) / spread;
  const T c = (constant(4) * s * s - constant(h2)) / (s * spread);

  TwoDiscLoss<T> loss;
  loss.n = Vec2<T>(cos(phi), sin(phi));
  const Vec2<T> m = Perpendicular(loss.n);
  const Vec2<T> way =
      start.p2 + Scale(s, Vec2<T>(start.v2 - start.v1)) - Scale(constant(problem.contact_distance), loss.n) - start.p1;
  const Vec2<T> coast = start.p2 + Scale(constant(problem.duration), start.v2) - ConstantVector<T>(problem.target);
  const T gain = constant(problem.kappa) * (constant(problem.duration) - s);
  const T effort = constant(problem.effort * problem.mass * problem.mass);
  const T weight = constant(problem.weight);

  // The loss is quadratic in W: along m only effort counts, along n also the second disc's end.
  const T given = Dot(Vec2<T>(start.v1 - start.v2), loss.n);
  const T w_n = -(effort * b * Dot(way, loss.n) + weight * gain * (Dot(coast, loss.n) + gain * given)) /
                (effort * c + weight * gain * gain);
  const Vec2<T> change = Scale(w_n, loss.n) + Scale(T(-(b / c) * Dot(way, m)), m);
  loss.w = start.v1 + change;
  loss.speed = w_n + given;
  const Vec2<T> miss = coast + Scale(T(gain * loss.speed), loss.n);
  loss.alpha = Scale(a, way) + Scale(b, change);
  loss.beta = Scale(b, way) + Scale(c, change);
  loss.terminal = weight * Dot(miss, miss);
  loss.running = effort * (Dot(way, loss.alpha) + Dot(change, loss.beta));
  return loss;
}

// Value, gradient and Hessian of the least loss by (s, phi).
struct TwoDiscDerivatives {
  double value;
  Eigen::Vector2d gradient;
  Eigen::Matrix2d hessian;
};
TwoDiscDerivatives DifferentiateTwoDisc(const TwoDiscProblem& problem, double s, double phi);

// Improves (s, phi), or phi alone, to the nearest minimum by Newton's method, regularised where the loss is not convex.
// False if it leaves 0 < s < T or does not converge.
bool MinimizeTwoDisc(const TwoDiscProblem& problem, bool move_time, double* s, double* phi);

// The position of a disc as polynomials in the time since `start`, per coordinate.
using Path = std::array<Polynomial, 2>;
struct PathPiece {
  double start;
  double end;
  Path first;
  Path second;
};

// The straight paths after the impact at time s, up to the plane and after it. `hit` receives when the second disc
// strikes the plane of kImpactThenPlane; nothing is returned if it does not.
std::optional<std::vector<PathPiece>> PathsAfterImpact(const Scene& scene, TwoDiscSequence sequence, double s,
                                                       const TwoDiscLoss<double>& loss, std::optional<double>* hit);

// Whether discs and planes stay apart on all pieces (to rounding).
bool PathsAreClear(const Scene& scene, const std::vector<PathPiece>& pieces);

}  // namespace saltus::exact_internal
