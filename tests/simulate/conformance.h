// Properties of every contact model, as checks that return a message, empty if the property holds. Exceptions come from
// a model's traits.
//
// Checks are functions, not assertions, so that conformance_test.cc can also show that they find seeded faults.
#pragma once

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <memory>
#include <string>
#include <vector>

#include "simulate/conformance_run.h"

namespace saltus::conformance {

// ---------------------------------------------------------------------------------------------------------------------
// Flight.

// A step without contact is the model's own affine map, and follows the exact arc to first order in the step.
inline std::string CheckFreeFlight(const Model& model) {
  Scene scene;
  scene.name = "flight";
  scene.duration = 0.5;
  scene.steps = 240;
  scene.gravity = {0.3, -9.8};
  scene.bodies = {{.name = "a", .radius = 0.1, .mass = 1.7, .position = {1, 2}, .velocity = {-0.4, 0.9}},
                  {.name = "b", .radius = 0.1, .mass = 0.6, .position = {50, 0}, .velocity = {2, -1}}};
  if (model.traits.push_gap > 10) scene.bodies.pop_back();  // it would feel the other
  scene.control = {{0}, {{1, -2}}};
  Run run(model, scene);
  if (!run.finite()) return "free flight is not finite";
  const double h = run.simulator().step();
  std::vector<double> x(run.simulator().state_size()), force(2 * scene.num_bodies());
  run.simulator().GetState(0, x);
  run.simulator().ExpandForce(InitialControl(scene, run.last()), 0, force);
  StepLinearization linearization;
  run.simulator().Linearize(x, force, false, &linearization);
  if (!linearization.islands.empty()) return "something touches in free flight";
  const StepLinearization::FreeFlight& f = linearization.free;
  for (int i = 0; i < scene.num_bodies(); ++i) {
    const Vec2d a = scene.gravity + (i == 0 ? Vec2d(scene.control.initial[0] / scene.bodies[0].mass) : Vec2d(0, 0));
    for (int k = 0; k < run.last(); ++k) {
      const Vec2d p = run.Position(k, i), v = run.Velocity(k, i);
      const Vec2d next_p = f.pp * p + f.pv * v + f.pa * a, next_v = f.vp * p + f.vv * v + f.va * a;
      // A velocity that is a difference of positions is rounded as they are, over the step.
      const double rounding = 4e-16 * (1 + p.norm());
      if ((run.Position(k + 1, i) - next_p).norm() > 8 * rounding) return Say("position of flight differs, step ", k);
      if ((run.Velocity(k + 1, i) - next_v).norm() > 16 * rounding / h) return Say("velocity differs, step ", k);
    }
    const double T = scene.duration;
    const Vec2d end = scene.bodies[i].position + T * scene.bodies[i].velocity + 0.5 * T * T * a;
    if ((run.Position(run.last(), i) - end).norm() > a.norm() * T * h) return "flight is not that of the force";
    if ((run.Velocity(run.last(), i) - scene.bodies[i].velocity - T * a).norm() > 1e-9) return "flight gains speed";
  }
  return "";
}

// Discs that are near each other and do not touch move as each does alone, bit by bit.
inline std::string CheckNeighbours(const Model& model) {
  const double gap = model.traits.push_gap + 5e-4;
  if (!(gap < 1)) return "";
  Scene both;
  both.name = "neighbours";
  both.duration = 0.5;
  both.steps = 240;
  both.gravity = {0.3, -9.8};
  both.bodies = {{.name = "a", .radius = 0.2, .mass = 1, .position = {0, 2}, .velocity = {-1, 0.1}},
                 {.name = "b", .radius = 0.3, .mass = 3, .position = {0.5 + gap, 2}, .velocity = {0.3, 0.2}}};
  for (int i = 0; i < 2; ++i) {
    Scene alone = both;
    alone.bodies = {both.bodies[i]};
    Run single(model, alone), pair(model, both);
    if (!pair.simulator().touches().empty()) return "discs that part are said to touch";
    if (single.Position(1, 0) != pair.Position(1, i) || single.Velocity(1, 0) != pair.Velocity(1, i)) {
      return "a neighbour that does not touch changes the step";
    }
  }
  return "";
}

// ---------------------------------------------------------------------------------------------------------------------
// Impacts.

inline std::string CheckMomentum(const Model& model) {
  for (const double friction : {0.0, 0.2}) {
    if (friction > 0 && !model.traits.friction) continue;
    Run run(model, TwoDiscs(0.8, friction, 0.2));
    if (run.simulator().touches().empty()) return "the discs do not meet";
    const double change = (run.Momentum(run.last()) - run.Momentum(0)).norm();
    if (!(change < 1e-9)) return Say("momentum changes by ", change, " kg m/s, friction ", friction);
  }
  return "";
}

// Speed at which the sides part, of that at which they closed, with so many times the steps of the scene.
inline double ReboundOf(const Model& model, Scene scene, int refine = 1) {
  scene.steps *= refine;
  Run run(model, scene);
  return run.GapSpeed(run.last()) / -run.GapSpeed(0);
}

// No model parts faster than the scene asks for, except as stated here.
inline std::string CheckRestitution(const Model& model) {
  for (const double restitution : {1.0, 0.8, 0.3}) {
    for (const Scene& scene : Impacts(restitution)) {
      const double ratio = ReboundOf(model, scene);
      const std::string found =
          Say("separates with ", ratio, " of the closing speed for restitution ", restitution, " in ", scene.name);
      switch (model.traits.rebound) {
        case Rebound::kElasticOnly:
          if (restitution == 1) break;
          if (!(ratio >= 0 && ratio <= 1)) return found;
          continue;
        case Rebound::kEmergent:
          if (model.traits.compliant) {
            // A force never gives back more than it took, but for what its integration adds: by symplectic Euler up to
            // 7e-4 of the speed at this step, and 2e-4 at a quarter of it.
            if (!(ratio >= -1e-9 && ratio < 1 + 1e-3)) return found;
            if (!(ReboundOf(model, scene, 4) < 1 + 2e-4)) return found + ", and more at a quarter of the step";
          } else {
            // An impulse with the restitution, and then that which takes a tenth of the overlap out within a step; the
            // overlap is at most what a step approaches.
            if (!(ratio >= restitution - 1e-9 && ratio <= restitution + 0.1)) return found;
          }
          continue;
        case Rebound::kPlastic:
          if (!(std::abs(ratio) < 0.01)) return found;
          continue;
        case Rebound::kRestitution:
          break;
      }
      if (!(std::abs(ratio - std::pow(restitution, model.traits.restitution_power)) < 1e-4)) return found;
    }
  }
  return "";
}

// The impulse points away from the other side: bodies that meet do not pass through each other.
inline std::string CheckSeparation(const Model& model) {
  for (const Scene& scene : Impacts(0.9)) {
    Run run(model, scene);
    const int last = run.last();
    if (!run.finite()) return Say(scene.name, " is not finite");
    const double change = Dot(run.Normal(0), Vec2d(run.Velocity(last, 0) - run.Velocity(0, 0)));
    if (!(change > 0.1)) return Say("disc a gains ", change, " m/s away from the other side in ", scene.name);
    if (!(run.GapSpeed(last) > -0.01)) return Say("the sides still close at the end of ", scene.name);
    if (Dot(run.Normal(0), run.Normal(last)) < 0) return Say("the discs have passed through each other");
  }
  return "";
}

// Rigid models overlap by no more than two steps' approach (one until they notice, one in which, for some, only the
// velocity turns), and for no longer than it takes to leave; compliant ones by no more than a spring gives way, and not
// in the end.
inline std::string CheckOverlap(const Model& model) {
  for (const Scene& scene : Impacts(0.9)) {
    Run run(model, scene);
    const double closing = -run.GapSpeed(0);
    const double mass = scene.num_bodies() > 1 ? 0.75 : scene.bodies[0].mass;
    const double bound = model.traits.compliant ? 1.5 * closing * std::sqrt(mass / scene.contact.stiffness) + 0.01
                                                : 2.01 * closing * run.simulator().step();
    int overlapping = 0;
    for (int k = 0; k <= run.last(); ++k) {
      const double gap = run.Gap(k);
      if (!(gap > -bound)) return Say("overlap of ", -gap, " m in ", scene.name);
      if (gap < -1e-9) ++overlapping;
    }
    if (!model.traits.compliant && overlapping > 4) return Say("overlap in ", overlapping, " states of ", scene.name);
    if (!(run.Gap(run.last()) > -1e-9) && model.traits.rebound != Rebound::kPlastic) return "overlap remains";
  }
  return "";
}

// A model that says so moves bodies apart that overlap, from whatever state.
inline std::string CheckProjection(const Model& model) {
  if (!model.traits.projects) return "";
  for (Scene scene : Impacts(0.5)) {
    for (Body& body : scene.bodies) body.velocity = {0, 0};
    const std::unique_ptr<Simulator> simulator = model.make(scene);
    const Vec2d n = scene.num_bodies() > 1 ? Vec2d(-0.6, -0.8) : scene.planes[0].normal;
    const double touching = scene.num_bodies() > 1 ? 0.5 : 0.2, overlap = 1e-4;
    std::vector<double> initial = InitialState(scene), x(simulator->state_size()), next(x.size());
    const Vec2d base = scene.num_bodies() > 1 ? scene.bodies[1].position : Vec2d(0, 0);
    const Vec2d p = base + (touching - overlap) * n;
    std::copy_n(p.data(), 2, initial.begin());
    simulator->ExpandInitial(initial, x);
    const std::vector<double> force(2 * scene.num_bodies());
    simulator->Step(x, force, next);
    x = next;
    const Vec2d other = scene.num_bodies() > 1 ? Vec2d(x[simulator->body_size()], x[simulator->body_size() + 1]) : base;
    const double left = touching - Dot(n, Vec2d(Vec2d(x[0], x[1]) - other));
    if (!(left < 0.01 * overlap)) return Say("an overlap of ", overlap, " m is ", left, " m a step later");
  }
  return "";
}

// Friction resists sliding, within Coulomb's bound, and does not reverse it.
inline std::string CheckFriction(const Model& model) {
  if (!model.traits.friction) return "";
  for (const double friction : {0.1, 0.3}) {
    const double sliding = 1.5;
    Run run(model, DiscOnPlane(0.9, friction, sliding));
    const Vec2d change = run.Velocity(run.last(), 0) - run.Velocity(0, 0), n = run.Normal(0);
    const double normal = Dot(n, change), tangential = -Dot(Perpendicular(n), change);
    const double sense = -Dot(Perpendicular(n), run.Velocity(0, 0)) > 0 ? 1 : -1;
    if (!(sense * tangential < 0)) return Say("friction pushes along, by ", sense * tangential, " m/s");
    if (!(std::abs(tangential) <= std::min(friction * normal * (1 + 1e-6), sliding))) {
      return Say("friction of ", tangential, " m/s exceeds ", friction, " times ", normal);
    }
  }
  return "";
}

inline std::string CheckFixedDiscs(const Model& model) {
  for (const double friction : {0.0, 0.2}) {
    if (friction > 0 && !model.traits.friction) continue;
    for (const int fixed : {0, 1}) {
      Scene scene = TwoDiscs(0.8, friction, 0.1);
      scene.gravity = {1, -3};
      scene.bodies[fixed].fixed = true;
      scene.bodies[fixed].velocity = {0, 0};
      Run run(model, scene);
      if (run.simulator().touches().empty()) return "the fixed disc is not met";
      for (int k = 0; k <= run.last(); ++k) {
        if (run.Position(k, fixed) != scene.bodies[fixed].position || run.Velocity(k, fixed) != Vec2d(0, 0)) {
          return Say("the fixed disc moves in step ", k);
        }
      }
      if (!(Dot(run.Normal(0), Vec2d(run.Velocity(run.last(), 0) - run.Velocity(0, 0))) > 0) && fixed == 1) {
        return "the fixed disc does not push";
      }
    }
  }
  return "";
}

// A disc that meets two others in the same step, the scene being symmetric about the x axis.
inline std::string CheckSeveralAtOnce(const Model& model) {
  Scene scene;
  scene.name = "break";
  scene.duration = 0.25;
  scene.steps = 120;
  scene.bodies = {{.name = "a", .radius = 0.2, .mass = 1, .position = {-0.5, 0}, .velocity = {3, 0}},
                  {.name = "b", .radius = 0.2, .mass = 1.5, .position = {0.2, 0.25}},
                  {.name = "c", .radius = 0.2, .mass = 1.5, .position = {0.2, -0.25}}};
  scene.contact = {.restitution = 0.6, .friction = 0, .stiffness = 1e4, .damping = 0};
  Run run(model, scene);
  const int last = run.last();
  if (!run.finite()) return "three discs at once are not finite";
  if (run.simulator().touches().size() < 2) return "the discs do not meet";
  const double change = (run.Momentum(last) - run.Momentum(0)).norm();
  if (!model.traits.averages && !(change < 1e-9)) return Say("momentum changes by ", change, " kg m/s");
  const Vec2d a = run.Velocity(last, 0), b = run.Velocity(last, 1), c = run.Velocity(last, 2);
  const auto sticks = [](const StepTouch& at) { return at.touch.mode == ContactMode::kStick; };
  if (std::any_of(run.simulator().touches().begin(), run.simulator().touches().end(), sticks)) {
    // Without any friction: what touches moves on as one.
    return (a - b).norm() < 1e-9 && (a - c).norm() < 1e-9 ? "" : "discs that stick move apart";
  }
  if (!(b[0] > 0.1 && b[1] > 0.1 && c[0] > 0.1 && c[1] < -0.1)) return "the discs are not pushed apart";
  if (model.traits.sequential) return "";
  if (!(std::abs(a[1]) < 1e-9 && std::abs(b[0] - c[0]) < 1e-9 && std::abs(b[1] + c[1]) < 1e-9)) {
    return "the result is not symmetric";
  }
  return "";
}

// ---------------------------------------------------------------------------------------------------------------------
// Symmetries.

// Largest difference of p and v at the end, disc i of `a` being disc map[i] of `b` and its vectors turned by `turn`.
inline double EndDifference(Run& a, Run& b, const std::vector<int>& map, const Eigen::Matrix2d& turn) {
  double largest = 0;
  for (int i = 0; i < static_cast<int>(map.size()); ++i) {
    largest = std::max(largest, (turn * a.Position(a.last(), i) - b.Position(b.last(), map[i])).norm());
    largest = std::max(largest, (turn * a.Velocity(a.last(), i) - b.Velocity(b.last(), map[i])).norm());
  }
  return largest;
}

inline Scene Turned(Scene scene, const Eigen::Matrix2d& turn) {
  scene.gravity = turn * scene.gravity;
  for (Body& body : scene.bodies) {
    body.position = turn * body.position;
    body.velocity = turn * body.velocity;
  }
  for (Plane& plane : scene.planes) {
    plane.point = turn * plane.point;
    plane.normal = turn * plane.normal;
  }
  for (Vec2d& force : scene.control.initial) force = turn * force;
  return scene;
}

inline Scene Reordered(const Scene& scene, const std::vector<int>& map) {
  Scene reordered = scene;
  for (int i = 0; i < scene.num_bodies(); ++i) reordered.bodies[map[i]] = scene.bodies[i];
  for (int& body : reordered.control.bodies) body = map[body];
  return reordered;
}

// Checks that the scene moves in the same way if turned, mirrored, or with its discs in another order.
inline std::string CheckSymmetries(const Model& model, const Scene& scene) {
  Run run(model, scene);
  if (run.simulator().touches().empty()) return "nothing touches";
  std::vector<int> same(scene.num_bodies()), reversed(scene.num_bodies());
  for (int i = 0; i < scene.num_bodies(); ++i) {
    same[i] = i;
    reversed[i] = scene.num_bodies() - 1 - i;
  }
  const double tolerance = 1e-7;
  Eigen::Matrix2d mirror, turn;
  mirror << -1, 0, 0, 1;
  turn << 0.6, -0.8, 0.8, 0.6;
  Run mirrored(model, Turned(scene, mirror)), turned(model, Turned(scene, turn)),
      reordered(model, Reordered(scene, reversed));
  if (const double by = EndDifference(run, mirrored, same, mirror); !(by < tolerance)) return Say("mirrored: ", by);
  if (const double by = EndDifference(run, turned, same, turn); !(by < tolerance)) return Say("turned: ", by);
  if (model.traits.sequential) return "";
  const double by = EndDifference(run, reordered, reversed, Eigen::Matrix2d::Identity());
  if (!(by < tolerance)) return Say("reordered: ", by);
  return "";
}

// Checks that the bits are the same twice, from the same simulator and from another.
inline std::string CheckDeterminism(const Model& model, const Scene& scene) {
  Run first(model, scene), second(model, scene);
  const std::unique_ptr<Simulator> again = model.make(scene);
  const std::vector<double> control = InitialControl(scene, again->num_steps());
  std::vector<double> a(again->state_size()), b(a.size()), c(a.size());
  for (int repetition = 0; repetition < 2; ++repetition) again->Rollout(InitialState(scene), control);
  first.simulator().GetState(first.last(), a);
  second.simulator().GetState(first.last(), b);
  again->GetState(first.last(), c);
  return a == b && a == c ? "" : "the same rollout gives other bits";
}

// Two groups of discs far apart move as each does alone, bit by bit.
inline std::string CheckGroupsApart(const Model& model) {
  if (model.traits.push_gap > 15) return "";
  const Scene near = TwoDiscs(0.8, 0, 0.1);
  Scene far = near;
  for (Body& body : far.bodies) {
    body.position += Vec2d(24, 0);  // not so far that the simulator moves the origin of the one by itself
    body.velocity *= 1.25;
    body.name += "2";
  }
  Scene both = near;
  both.bodies.insert(both.bodies.end(), far.bodies.begin(), far.bodies.end());
  Run one(model, near), other(model, far), all(model, both);
  for (int i = 0; i < 4; ++i) {
    Run& alone = i < 2 ? one : other;
    const int last = all.last();
    if (alone.Position(last, i % 2) != all.Position(last, i) || alone.Velocity(last, i % 2) != all.Velocity(last, i)) {
      return "discs far apart influence each other";
    }
  }
  return "";
}

}  // namespace saltus::conformance
