#include <Eigen/Dense>
#include <algorithm>
#include <optional>

#include "exact/closed_forms.h"
#include "exact/flow.h"
#include "scene/units.h"

namespace saltus {
namespace {

using namespace exact_internal;  // NOLINT: the parts of the closed forms

// Returns all sequences of at most `hits` impacts.
std::vector<PlaneSequence> Sequences(int planes, int hits) {
  std::vector<PlaneSequence> sequences = {{}};
  for (size_t done = 0; done < sequences.size(); ++done) {
    if (static_cast<int>(sequences[done].size()) == hits) break;
    for (int plane = 0; plane < planes; ++plane) {
      PlaneSequence longer = sequences[done];
      longer.push_back(plane);
      sequences.push_back(longer);
    }
  }
  return sequences;
}

const TerminalTerm& Target(const Scene& scene) { return scene.objective.terminal[0]; }

// The distance from the target of the disc launched with `velocity` along `hits`, as a vector, with its derivative.
struct TargetDistance {
  Eigen::Vector2d error;
  Eigen::Matrix2d slope;  // by velocity
};
std::optional<TargetDistance> Launch(const Scene& scene, const PlaneSequence& hits, const Vec2d& velocity) {
  using Jet = ceres::Jet<double, 2>;
  const ContactLaw<Jet> law = {Jet(scene.contact.restitution), Jet(scene.contact.friction)};
  Motion<Jet> disc = Cast<Jet>({scene.bodies[0].position, velocity});
  for (int c = 0; c < 2; ++c) disc.velocity[c].v[c] = 1;
  const std::optional<Motion<Jet>> end = FlyAlong(scene, law, hits, disc, 0);
  if (!end) return std::nullopt;
  TargetDistance miss;
  for (int c = 0; c < 2; ++c) {
    miss.error[c] = end->position[c].a - Target(scene).target[c];
    miss.slope.row(c) = end->position[c].v.transpose();
  }
  return miss;
}

// Newton's method, with steps halved until the miss decreases. Returns false if no step decreases it.
bool Solve(const Scene& scene, const PlaneSequence& hits, Vec2d* velocity) {
  std::optional<TargetDistance> now = Launch(scene, hits, *velocity);
  if (!now) return false;
  for (int i = 0; i < 50; ++i) {
    const Eigen::Vector2d full = -now->slope.fullPivLu().solve(now->error);
    const bool last = full.norm() < 1e-10 * (1 + velocity->norm());
    double part = 1;
    std::optional<TargetDistance> next;
    for (; part > 1e-6; part *= 0.5) {
      next = Launch(scene, hits, *velocity + part * full);
      if (next && (last || next->error.norm() < now->error.norm())) break;
    }
    if (!(part > 1e-6)) return false;
    *velocity += part * full;
    now = next;
    if (last) return true;
  }
  return false;
}

// Returns the velocity of the straight line to the target, mirrored at the planes in reverse, and raised for gravity.
Vec2d StraightLaunch(const Scene& scene, const PlaneSequence& hits) {
  Vec2d image = Target(scene).target;
  for (auto hit = hits.rbegin(); hit != hits.rend(); ++hit) {
    image = Mirror(scene.planes[*hit], scene.bodies[0].radius, image);
  }
  return (image - scene.bodies[0].position) / scene.duration - 0.5 * scene.duration * InitialAcceleration(scene, 0);
}

// Adds the solution that Newton's method finds from `velocity`, if it is new and the disc does strike `hits`.
void Try(const Scene& scene, const PlaneSequence& hits, Vec2d velocity, std::vector<LaunchSolution>* solutions) {
  if (!Solve(scene, hits, &velocity)) return;
  for (const LaunchSolution& known : *solutions) {
    if ((known.velocity - velocity).norm() < 1e-8 * (1 + velocity.norm())) return;
  }
  Scene launched = scene;
  launched.bodies[0].velocity = velocity;
  const std::optional<DiscPath> path = FollowDisc(launched, nullptr);
  if (path && path->hits == hits) solutions->push_back({velocity, path->events});
}

const char* UnsupportedByLaunchSolutions(const Scene& scene) {
  if (scene.num_bodies() != 1 || scene.bodies[0].fixed) return "there must be one moving disc";
  if (scene.objective.effort != 0 && scene.num_controlled() > 0) return "effort must be 0";
  if (scene.objective.terminal.size() != 1) return "the objective must have one terminal term";
  if (Target(scene).component || Target(scene).quantity != TerminalTerm::Quantity::kPosition) {
    return "the objective must be the disc's squared distance to a point";
  }
  return nullptr;
}

}  // namespace

std::vector<LaunchSolution> FindLaunchSolutions(const Scene& scene, int max_hits, std::string* reason_not_applicable) {
  if (!scene.units.natural) {
    const Scene natural = ToNaturalUnits(scene);
    const UnitFactors by(natural.units, scene.units);
    std::vector<LaunchSolution> solutions = FindLaunchSolutions(natural, max_hits, reason_not_applicable);
    for (LaunchSolution& solution : solutions) {
      solution.velocity *= by.speed;
      for (ExactEvent& event : solution.events) event.time *= by.time;
    }
    return solutions;
  }
  constexpr int kLattice = 3;  // starts to either side, per direction
  std::vector<LaunchSolution> solutions;
  if (std::string wrong = ValidateForClosedForm(scene); !wrong.empty()) {
    Refuse(reason_not_applicable, wrong);
    return solutions;
  }
  if (const char* reason = UnsupportedByLaunchSolutions(scene)) {
    Refuse(reason_not_applicable, reason);
    return solutions;
  }
  for (const PlaneSequence& hits : Sequences(static_cast<int>(scene.planes.size()), max_hits)) {
    const Vec2d middle = StraightLaunch(scene, hits);
    const double spacing = (1 + middle.norm()) / kLattice;
    for (int i = -kLattice; i <= kLattice; ++i) {
      for (int j = -kLattice; j <= kLattice; ++j) Try(scene, hits, middle + spacing * Vec2d(i, j), &solutions);
    }
  }
  std::sort(solutions.begin(), solutions.end(), [](const LaunchSolution& a, const LaunchSolution& b) {
    return a.velocity.norm() < b.velocity.norm();
  });
  if (solutions.empty()) Refuse(reason_not_applicable, "no velocity of zero loss was found");
  return solutions;
}

}  // namespace saltus
