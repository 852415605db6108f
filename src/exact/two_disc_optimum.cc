#include "exact/two_disc_optimum.h"

#include <cmath>
#include <numbers>

#include "exact/two_disc_core.h"
#include "scene/units.h"

namespace saltus {
namespace {

using exact_internal::EvaluateTwoDisc;
using exact_internal::Path;
using exact_internal::PathPiece;
using exact_internal::Polynomial;
using exact_internal::TwoDiscLoss;
using exact_internal::TwoDiscProblem;
using exact_internal::TwoDiscState;

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
  const auto after = exact_internal::PathsAfterImpact(scene, sequence, s, loss, &o.plane_time);
  if (!after) return std::nullopt;
  std::vector<PathPiece> pieces = {PathsBeforeImpact(problem, s, o.control_start, o.control_slope)};
  pieces.insert(pieces.end(), after->begin(), after->end());
  if (!exact_internal::PathsAreClear(scene, pieces)) return std::nullopt;
  const PathPiece& last = pieces.back();
  for (int c = 0; c < 2; ++c) o.target_final[c] = exact_internal::Evaluate(last.second[c], last.end - last.start);
  FillCostates(problem, &o);
  const Eigen::Matrix2d hessian = exact_internal::DifferentiateTwoDisc(problem, s, phi).hessian;
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

std::optional<TwoDiscOptimum> FindTwoDiscOptimum(const Scene& scene, TwoDiscSequence sequence, std::string* why_not) {
  if (!scene.units.natural) {
    const Scene natural = InNaturalUnits(scene);
    const std::optional<TwoDiscOptimum> optimum = FindTwoDiscOptimum(natural, sequence, why_not);
    return optimum ? std::optional(Convert(*optimum, natural.units, scene.units)) : std::nullopt;
  }
  constexpr int kTimes = 16;
  constexpr int kAngles = 12;
  const auto problem = exact_internal::MakeTwoDiscProblem(scene, sequence, why_not);
  if (!problem) return std::nullopt;
  const Vec2d way = problem->start.p2 - problem->start.p1;
  std::optional<TwoDiscOptimum> best;
  for (int i = 0; i < kTimes; ++i) {
    for (int j = 0; j < kAngles; ++j) {
      double s = problem->duration * (i + 0.5) / kTimes;
      double phi = std::atan2(way[1], way[0]) + std::numbers::pi * ((j + 0.5) / kAngles - 0.5);
      if (!exact_internal::MinimizeTwoDisc(*problem, true, &s, &phi)) continue;
      const std::optional<TwoDiscOptimum> candidate = CandidateAt(scene, sequence, *problem, s, phi);
      if (candidate && (!best || candidate->loss < best->loss)) best = candidate;
    }
  }
  if (!best) return exact_internal::Refuse(why_not, "no minimum with these collisions was found");
  return best;
}

}  // namespace saltus
