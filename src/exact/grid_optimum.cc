#include <glog/logging.h>

#include <algorithm>
#include <array>

#include "exact/two_disc_core.h"
#include "exact/two_disc_optimum.h"
#include "scene/units.h"

namespace saltus {
namespace {

using exact_internal::CollideOnce;
using exact_internal::ContactLaw;
using exact_internal::DiscPair;
using exact_internal::Fly;
using exact_internal::Motion;
using exact_internal::PairParameters;
using exact_internal::PathPiece;
using exact_internal::TwoDiscLoss;
using exact_internal::TwoDiscProblem;

// The grid of a scene, and the angle of impact from which Newton's method starts.
struct Grid {
  TwoDiscProblem problem;  // with step
  double angle = 0;
};

std::optional<Grid> MakeGrid(const Scene& scene, TwoDiscSequence sequence, std::string* why_not) {
  const auto problem = exact_internal::MakeTwoDiscProblem(scene, sequence, why_not);
  if (!problem) return std::nullopt;
  const auto optimum = FindTwoDiscOptimum(scene, sequence, why_not);
  if (!optimum) return std::nullopt;
  Grid grid = {*problem, optimum->angle};
  grid.problem.step = scene.dt();
  return grid;
}

// Returns the least loss with the impact on `node`; std::nullopt if Newton's method fails or the discs would separate.
std::optional<TwoDiscLoss<double>> BestAtNode(const Grid& grid, int node) {
  double s = node * grid.problem.step;
  double phi = grid.angle;
  if (!exact_internal::MinimizeTwoDisc(grid.problem, false, &s, &phi)) return std::nullopt;
  const auto loss = exact_internal::EvaluateTwoDisc(grid.problem, grid.problem.start, s, phi);
  if (!(loss.speed > 0)) return std::nullopt;
  return loss;
}

std::vector<PathPiece> PathsBeforeImpact(const Scene& scene, const GridOptimum& o) {
  std::vector<PathPiece> pieces;
  Motion<double> first = exact_internal::InitialMotion(scene, 0);
  Motion<double> second = exact_internal::InitialMotion(scene, 1);
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
  discs.second = exact_internal::Cast<Jet>({p2, second.velocity});
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
                                       const TwoDiscLoss<double>& loss, std::string* why_not) {
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
  const auto after = exact_internal::PathsAfterImpact(scene, sequence, o.impact_time, loss, &o.plane_time);
  if (!after) return exact_internal::Refuse(why_not, "the second disc does not reach the plane");
  std::vector<PathPiece> pieces = PathsBeforeImpact(scene, o);
  pieces.insert(pieces.end(), after->begin(), after->end());
  if (!exact_internal::PathsAreClear(scene, pieces)) return exact_internal::Refuse(why_not, "something else is struck");
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
  const Scene natural = InNaturalUnits(scene);
  const std::optional<GridOptimum> optimum = find(natural);
  return optimum ? std::optional(Convert(*optimum, natural.units, scene.units)) : std::nullopt;
}

}  // namespace

std::optional<GridOptimum> OptimizeWithImpactAt(const Scene& scene, TwoDiscSequence sequence, int node,
                                                std::string* why_not) {
  if (!scene.units.natural) {
    return FindInNaturalUnits(
        scene, [&](const Scene& natural) { return OptimizeWithImpactAt(natural, sequence, node, why_not); });
  }
  const std::optional<Grid> grid = MakeGrid(scene, sequence, why_not);
  if (!grid) return std::nullopt;
  CHECK(node >= 2 && node < scene.steps) << "no such node for an impact: " << node;
  const auto loss = BestAtNode(*grid, node);
  if (!loss) return exact_internal::Refuse(why_not, "no minimum with the impact on this node was found");
  return MakeOptimum(scene, sequence, *grid, node, *loss, why_not);
}

std::optional<GridOptimum> FindGridOptimum(const Scene& scene, TwoDiscSequence sequence, std::string* why_not) {
  if (!scene.units.natural) {
    return FindInNaturalUnits(scene, [&](const Scene& natural) { return FindGridOptimum(natural, sequence, why_not); });
  }
  const std::optional<Grid> grid = MakeGrid(scene, sequence, why_not);
  if (!grid) return std::nullopt;
  int best_node = 0;
  TwoDiscLoss<double> best = {};
  for (int node = 2; node < scene.steps; ++node) {
    const auto loss = BestAtNode(*grid, node);
    if (!loss || (best_node > 0 && loss->terminal + loss->running >= best.terminal + best.running)) continue;
    best_node = node;
    best = *loss;
  }
  if (best_node == 0) return exact_internal::Refuse(why_not, "no minimum with the impact on a node was found");
  return MakeOptimum(scene, sequence, *grid, best_node, best, why_not);
}

}  // namespace saltus
