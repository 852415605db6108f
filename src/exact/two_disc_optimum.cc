#include "exact/two_disc_optimum.h"

#include <ceres/jet.h>
#include <glog/logging.h>

#include <Eigen/Dense>
#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>

#include "exact/flow.h"
#include "scene/units.h"

namespace saltus {
namespace {

using namespace exact_internal;  // NOLINT: the parts of the closed forms

// The common part of both optima: the loss as a function of the time and the angle of the impact, Newton's method on
// it, and a check of the paths.

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

// The position of a disc as polynomials in the time since `start`, per coordinate.
using Path = std::array<Polynomial, 2>;
struct PathPiece {
  double start;
  double end;
  Path first;
  Path second;
};

constexpr double kClear = 1e-11;  // overlap below this is rounding

Path LinearPath(const Vec2d& position, const Vec2d& velocity) {
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

const char* UnsupportedByTwoDiscOptimum(const Scene& scene) {
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

// Returns the problem of `scene`, or std::nullopt and a reason. `step` is 0.
std::optional<TwoDiscProblem> MakeTwoDiscProblem(const Scene& scene, TwoDiscSequence sequence,
                                                 std::string* reason_not_applicable) {
  if (std::string wrong = ValidateForClosedForm(scene); !wrong.empty()) return Refuse(reason_not_applicable, wrong);
  if (const char* reason = UnsupportedByTwoDiscOptimum(scene)) return Refuse(reason_not_applicable, reason);
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
    if (scene.planes.size() != 1) return Refuse(reason_not_applicable, "there must be one plane");
    if (scene.contact.restitution != 1) return Refuse(reason_not_applicable, "the plane must be elastic");
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

// Improves (s, phi), or phi alone, to the nearest minimum by Newton's method, regularised where the loss is not convex.
// False if it leaves 0 < s < T or does not converge.
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

// The straight paths after the impact at time s, up to the plane and after it. `hit` receives when the second disc
// strikes the plane of kImpactThenPlane; nothing is returned if it does not.
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
    return std::vector<PathPiece>{{s, scene.duration, LinearPath(p1, v1), LinearPath(p2, v2)}};
  }
  const Plane& plane = scene.planes[0];
  const Vec2d n = plane.normal.normalized();
  const double wait = (n.dot(p2 - plane.point) - second.radius) / -n.dot(v2);
  if (!(wait > 0 && wait < scene.duration - s)) return std::nullopt;
  *hit = s + wait;
  const Vec2d rebound = v2 - 2 * n.dot(v2) * n;
  return std::vector<PathPiece>{
      {s, s + wait, LinearPath(p1, v1), LinearPath(p2, v2)},
      {s + wait, scene.duration, LinearPath(p1 + wait * v1, v1), LinearPath(p2 + wait * v2, rebound)}};
}

// Whether discs and planes stay apart on all pieces (to rounding).
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

// ---- In continuous time

// Returns the paths of both discs from time 0 to the impact at s.
PathPiece PathsBeforeImpact(const TwoDiscProblem& problem, double s, const Vec2d& c0, const Vec2d& c1) {
  const TwoDiscState<double>& x = problem.start;
  PathPiece piece = {0, s, {}, {}};
  for (int c = 0; c < 2; ++c) {
    piece.first[c] = {x.p1[c], x.v1[c], c0[c] / (2 * problem.mass), c1[c] / (6 * problem.mass)};
    piece.second[c] = {x.p2[c], x.v2[c]};
  }
  return piece;
}

// Returns the gradient of the minimum by the initial state (envelope theorem).
TwoDiscCostate InitialCostate(const TwoDiscProblem& problem, double s, double phi) {
  using Jet = ceres::Jet<double, 8>;
  const TwoDiscState<double>& x = problem.start;
  const auto seed = [](const Vec2d& value, int first) {
    return Vec2<Jet>(Jet(value[0], first), Jet(value[1], first + 1));
  };
  const TwoDiscState<Jet> start = {seed(x.p1, 0), seed(x.v1, 2), seed(x.p2, 4), seed(x.v2, 6)};
  const TwoDiscLoss<Jet> parts = EvaluateTwoDisc(problem, start, Jet(s), Jet(phi));
  const Jet loss = parts.terminal + parts.running;
  const auto part = [&](int first) { return Vec2d(loss.v[first], loss.v[first + 1]); };
  return {{part(0), part(4)}, {part(2), part(6)}};
}

// Sets the costates and the Hamiltonian from the other results.
void FillCostates(const TwoDiscProblem& problem, TwoDiscOptimum* o) {
  const TwoDiscState<double>& x = problem.start;
  const double s = o->impact_time;
  TwoDiscCostate& start = o->costate_start;
  start = InitialCostate(problem, s, o->angle);
  o->costate_before = start;
  for (int i = 0; i < 2; ++i) o->costate_before.velocity[i] -= s * start.position[i];
  const Vec2d unfolded_end = x.p2 + s * x.v2 + (problem.duration - s) * o->target_velocity;
  const Vec2d pull = 2 * problem.weight * (unfolded_end - problem.target);
  o->costate_after = {{Vec2d(0, 0), pull}, {Vec2d(0, 0), (problem.duration - s) * pull}};

  const auto hamiltonian = [&](const TwoDiscCostate& costate, const Vec2d& v1, const Vec2d& v2, const Vec2d& u) {
    return problem.effort * u.squaredNorm() + costate.position[0].dot(v1) + costate.position[1].dot(v2) +
           costate.velocity[0].dot(u) / problem.mass;
  };
  const Vec2d last = o->control_start + s * o->control_slope;
  o->hamiltonian_start = hamiltonian(start, x.v1, x.v2, o->control_start);
  o->hamiltonian_before = hamiltonian(o->costate_before, o->striker_velocity, x.v2, last);
  o->hamiltonian_after = hamiltonian(o->costate_after, Vec2d(0, 0), o->target_velocity, Vec2d(0, 0));
  o->kink_slope = problem.effort * last.squaredNorm();
}

// Returns the candidate at a minimum (s, phi), or std::nullopt if its paths meet anything else.
std::optional<TwoDiscOptimum> CandidateAt(const Scene& scene, TwoDiscSequence sequence, const TwoDiscProblem& problem,
                                          double s, double phi) {
  const TwoDiscLoss<double> loss = EvaluateTwoDisc(problem, problem.start, s, phi);
  if (!(loss.speed > 0)) return std::nullopt;
  TwoDiscOptimum o;
  o.terminal = loss.terminal;
  o.running = loss.running;
  o.loss = o.terminal + o.running;
  o.impact_time = s;
  o.angle = std::atan2(loss.n[1], loss.n[0]);
  o.normal = loss.n;
  o.striker_velocity = loss.w;
  o.impact_speed = loss.speed;
  o.control_start = problem.mass * (loss.beta + s * loss.alpha);
  o.control_slope = -problem.mass * loss.alpha;
  o.target_velocity = problem.start.v2 + problem.kappa * loss.speed * loss.n;
  const auto after = PathsAfterImpact(scene, sequence, s, loss, &o.plane_time);
  if (!after) return std::nullopt;
  std::vector<PathPiece> pieces = {PathsBeforeImpact(problem, s, o.control_start, o.control_slope)};
  pieces.insert(pieces.end(), after->begin(), after->end());
  if (!PathsAreClear(scene, pieces)) return std::nullopt;
  const PathPiece& last = pieces.back();
  for (int c = 0; c < 2; ++c) o.target_final[c] = Evaluate(last.second[c], last.end - last.start);
  FillCostates(problem, &o);
  const Eigen::Matrix2d hessian = DifferentiateTwoDisc(problem, s, phi).hessian;
  o.curvature = hessian(0, 0) - hessian(0, 1) * hessian(1, 0) / hessian(1, 1);
  return o;
}

TwoDiscOptimum Convert(TwoDiscOptimum o, const Units& from, const Units& to) {
  const UnitFactors by(from, to);
  for (double* loss : {&o.loss, &o.terminal, &o.running}) *loss *= by.loss;
  o.impact_time *= by.time;
  o.striker_velocity *= by.speed;
  o.impact_speed *= by.speed;
  o.control_start *= by.force;
  o.control_slope *= by.force / by.time;
  o.target_velocity *= by.speed;
  o.target_final = ConvertPosition(o.target_final, from, to);
  if (o.plane_time) *o.plane_time *= by.time;
  for (TwoDiscCostate* costate : {&o.costate_start, &o.costate_before, &o.costate_after}) {
    for (Vec2d& entry : costate->position) entry *= by.loss / by.length;
    for (Vec2d& entry : costate->velocity) entry *= by.loss / by.speed;
  }
  for (double* rate : {&o.hamiltonian_start, &o.hamiltonian_before, &o.hamiltonian_after, &o.kink_slope}) {
    *rate *= by.loss / by.time;
  }
  o.curvature *= by.loss / (by.time * by.time);
  return o;
}

}  // namespace

Vec2d TwoDiscOptimum::Control(double t) const {
  if (t >= impact_time) return Vec2d(0, 0);
  return control_start + t * control_slope;
}

std::optional<TwoDiscOptimum> FindTwoDiscOptimum(const Scene& scene, TwoDiscSequence sequence,
                                                 std::string* reason_not_applicable) {
  if (!scene.units.natural) {
    const Scene natural = ToNaturalUnits(scene);
    const std::optional<TwoDiscOptimum> optimum = FindTwoDiscOptimum(natural, sequence, reason_not_applicable);
    return optimum ? std::optional(Convert(*optimum, natural.units, scene.units)) : std::nullopt;
  }
  constexpr int kTimes = 16;
  constexpr int kAngles = 12;
  const auto problem = MakeTwoDiscProblem(scene, sequence, reason_not_applicable);
  if (!problem) return std::nullopt;
  const Vec2d way = problem->start.p2 - problem->start.p1;
  std::optional<TwoDiscOptimum> best;
  for (int i = 0; i < kTimes; ++i) {
    for (int j = 0; j < kAngles; ++j) {
      double s = problem->duration * (i + 0.5) / kTimes;
      double phi = std::atan2(way[1], way[0]) + std::numbers::pi * ((j + 0.5) / kAngles - 0.5);
      if (!MinimizeTwoDisc(*problem, true, &s, &phi)) continue;
      const std::optional<TwoDiscOptimum> candidate = CandidateAt(scene, sequence, *problem, s, phi);
      if (candidate && (!best || candidate->loss < best->loss)) best = candidate;
    }
  }
  if (!best) return Refuse(reason_not_applicable, "no minimum with these collisions was found");
  return best;
}

// ---- On a time grid

namespace {

// The grid of a scene, and the angle of impact from which Newton's method starts.
struct Grid {
  TwoDiscProblem problem;  // with step
  double angle = 0;
};

std::optional<Grid> MakeGrid(const Scene& scene, TwoDiscSequence sequence, std::string* reason_not_applicable) {
  const auto problem = MakeTwoDiscProblem(scene, sequence, reason_not_applicable);
  if (!problem) return std::nullopt;
  const auto optimum = FindTwoDiscOptimum(scene, sequence, reason_not_applicable);
  if (!optimum) return std::nullopt;
  Grid grid = {*problem, optimum->angle};
  grid.problem.step = scene.dt();
  return grid;
}

// Returns the least loss with the impact on `node`; std::nullopt if Newton's method fails or the discs would separate.
std::optional<TwoDiscLoss<double>> BestAtNode(const Grid& grid, int node) {
  double s = node * grid.problem.step;
  double phi = grid.angle;
  if (!MinimizeTwoDisc(grid.problem, false, &s, &phi)) return std::nullopt;
  const auto loss = EvaluateTwoDisc(grid.problem, grid.problem.start, s, phi);
  if (!(loss.speed > 0)) return std::nullopt;
  return loss;
}

std::vector<PathPiece> PathsBeforeImpact(const Scene& scene, const GridOptimum& o) {
  std::vector<PathPiece> pieces;
  Motion<double> first = InitialMotion(scene, 0);
  Motion<double> second = InitialMotion(scene, 1);
  for (int i = 0; i < o.node; ++i) {
    const Vec2d a = o.control[i] / scene.bodies[0].mass;
    PathPiece piece = {i * scene.dt(), (i + 1) * scene.dt(), {}, {}};
    for (int c = 0; c < 2; ++c) {
      piece.first[c] = {first.position[c], first.velocity[c], a[c] / 2};
      piece.second[c] = {second.position[c], second.velocity[c]};
    }
    pieces.push_back(piece);
    first = Fly(first, a, scene.dt());
    second = Fly(second, Vec2d(0, 0), scene.dt());
  }
  return pieces;
}

// Returns the gradient of the terminal loss by position and velocity of the first disc at the node, under `force`.
std::array<Vec2d, 2> ImpactCostate(const Scene& scene, const TwoDiscProblem& problem, const GridOptimum& o,
                                   const Vec2d& force) {
  using Jet = ceres::Jet<double, 4>;
  const Body& first = scene.bodies[0];
  const Body& second = scene.bodies[1];
  const Vec2d p2 = second.position + o.impact_time * second.velocity;
  const Vec2d p1 = p2 - problem.contact_distance * o.normal;
  const Vec2d& w = o.striker_velocity;
  DiscPair<Jet> discs;
  discs.first = {{Jet(p1[0], 0), Jet(p1[1], 1)}, {Jet(w[0], 2), Jet(w[1], 3)}};
  discs.second = Cast<Jet>({p2, second.velocity});
  const PairParameters pair = {problem.contact_distance, first.mass, second.mass, force / first.mass, Vec2d(0, 0)};
  const ContactLaw<Jet> law = {Jet(scene.contact.restitution), Jet(0.0)};
  const DiscPair<Jet> end = CollideOnce(pair, law, discs, 0, problem.duration - o.impact_time);
  const Vec2<Jet> miss = end.second.position - problem.target.cast<Jet>();
  const Jet loss = problem.weight * Dot(miss, miss);
  return {Vec2d(loss.v[0], loss.v[1]), Vec2d(loss.v[2], loss.v[3])};
}

// Returns the gradient of the loss by each force before the impact, if `force` acts at the impact.
std::vector<Vec2d> ControlGradient(const Scene& scene, const TwoDiscProblem& problem, const GridOptimum& o,
                                   const Vec2d& force) {
  const std::array<Vec2d, 2> costate = ImpactCostate(scene, problem, o, force);
  const double h = problem.step;
  std::vector<Vec2d> gradient;
  for (int i = 0; i < o.node; ++i) {
    const double left = o.impact_time - (i + 0.5) * h;
    gradient.push_back(h / problem.mass * (costate[1] + left * costate[0]) + 2 * problem.effort * h * o.control[i]);
  }
  return gradient;
}

void FillCertificate(const Scene& scene, const TwoDiscProblem& problem, GridOptimum* o) {
  const std::vector<Vec2d> early = ControlGradient(scene, problem, *o, o->control[o->node - 1]);
  const std::vector<Vec2d> late = ControlGradient(scene, problem, *o, Vec2d(0, 0));
  double up = 0;
  double down = 0;
  for (int i = 0; i < o->node; ++i) {
    up -= late[i].dot(early[i] - late[i]);
    down += (early[i] - late[i]).squaredNorm();
  }
  o->theta = up / down;
  for (int i = 0; i < o->node; ++i) {
    const Vec2d sum = o->theta * early[i] + (1 - o->theta) * late[i];
    o->residual = std::max(o->residual, sum.cwiseAbs().maxCoeff());
  }
}

std::optional<GridOptimum> MakeOptimum(const Scene& scene, TwoDiscSequence sequence, const Grid& grid, int node,
                                       const TwoDiscLoss<double>& loss, std::string* reason_not_applicable) {
  GridOptimum o;
  o.terminal = loss.terminal;
  o.running = loss.running;
  o.loss = o.terminal + o.running;
  o.node = node;
  o.impact_time = node * grid.problem.step;
  o.normal = loss.n;
  o.striker_velocity = loss.w;
  o.control.assign(scene.steps, Vec2d(0, 0));
  for (int i = 0; i < node; ++i) {
    const double left = o.impact_time - (i + 0.5) * grid.problem.step;
    o.control[i] = grid.problem.mass * (loss.beta + left * loss.alpha);
  }
  const auto after = PathsAfterImpact(scene, sequence, o.impact_time, loss, &o.plane_time);
  if (!after) return Refuse(reason_not_applicable, "the second disc does not reach the plane");
  std::vector<PathPiece> pieces = PathsBeforeImpact(scene, o);
  pieces.insert(pieces.end(), after->begin(), after->end());
  if (!PathsAreClear(scene, pieces)) return Refuse(reason_not_applicable, "something else is struck");
  FillCertificate(scene, grid.problem, &o);
  return o;
}

GridOptimum Convert(GridOptimum o, const Units& from, const Units& to) {
  const UnitFactors by(from, to);
  for (double* loss : {&o.loss, &o.terminal, &o.running}) *loss *= by.loss;
  o.impact_time *= by.time;
  o.striker_velocity *= by.speed;
  for (Vec2d& force : o.control) force *= by.force;
  if (o.plane_time) *o.plane_time *= by.time;
  o.residual *= by.loss / by.force;
  return o;
}

// Calls `find` with the scene in natural units, and converts its result to the units of the scene.
template <typename Find>
std::optional<GridOptimum> FindInNaturalUnits(const Scene& scene, const Find& find) {
  const Scene natural = ToNaturalUnits(scene);
  const std::optional<GridOptimum> optimum = find(natural);
  return optimum ? std::optional(Convert(*optimum, natural.units, scene.units)) : std::nullopt;
}

}  // namespace

std::optional<GridOptimum> OptimizeWithImpactAt(const Scene& scene, TwoDiscSequence sequence, int node,
                                                std::string* reason_not_applicable) {
  if (!scene.units.natural) {
    return FindInNaturalUnits(scene, [&](const Scene& natural) {
      return OptimizeWithImpactAt(natural, sequence, node, reason_not_applicable);
    });
  }
  const std::optional<Grid> grid = MakeGrid(scene, sequence, reason_not_applicable);
  if (!grid) return std::nullopt;
  CHECK(node >= 2 && node < scene.steps) << "no such node for an impact: " << node;
  const auto loss = BestAtNode(*grid, node);
  if (!loss) return Refuse(reason_not_applicable, "no minimum with the impact on this node was found");
  return MakeOptimum(scene, sequence, *grid, node, *loss, reason_not_applicable);
}

std::optional<GridOptimum> FindGridOptimum(const Scene& scene, TwoDiscSequence sequence,
                                           std::string* reason_not_applicable) {
  if (!scene.units.natural) {
    return FindInNaturalUnits(
        scene, [&](const Scene& natural) { return FindGridOptimum(natural, sequence, reason_not_applicable); });
  }
  const std::optional<Grid> grid = MakeGrid(scene, sequence, reason_not_applicable);
  if (!grid) return std::nullopt;
  int best_node = 0;
  TwoDiscLoss<double> best = {};
  for (int node = 2; node < scene.steps; ++node) {
    const auto loss = BestAtNode(*grid, node);
    if (!loss || (best_node > 0 && loss->terminal + loss->running >= best.terminal + best.running)) continue;
    best_node = node;
    best = *loss;
  }
  if (best_node == 0) return Refuse(reason_not_applicable, "no minimum with the impact on a node was found");
  return MakeOptimum(scene, sequence, *grid, best_node, best, reason_not_applicable);
}

}  // namespace saltus
