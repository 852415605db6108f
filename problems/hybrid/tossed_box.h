#pragma once

#include "saltus/hybrid/hybrid_problem.h"
#include "saltus/hybrid/mechanical_system.h"
#include "saltus/hybrid/rigid_bodies.h"

namespace saltus {

// A box that is tossed at a fixed disc on the ground, [x y angle and their rates]; p = [restitution friction gravity_x
// gravity_y].
struct TossedBox : RigidBodies2D {
  TossedBox()
      : RigidBodies2D(
            {.bodies =
                 {{.name = "box",
                   .polygon = BoxPolygon(0.2, 0.12),
                   .mass = 0.8,
                   .position = {-1, 0.6},
                   .velocity = {1.9, 1.2},
                   .angle = 0.3,
                   .spin = -2.2},
                  {.name = "bump", .radius = 0.15, .position = {0.1, 0}, .joint = {.kind = RigidJoint2D::Kind::kWeld}}},
             .planes = {{}},
             .restitution = 0.4,
             .friction = 0.3}) {}
};

// How it is tossed, so that it is at the place and in the pose in which it is 0.52 s after a toss with (2, 1) m/s and
// -2 rad/s.
inline HybridProblem TossedBoxProblem() {
  const TossedBox box;
  HybridProblem problem{.system = MechanicalSystem(box).hybrid(),
                        .guess = {.initial = box.InitialState(), .parameters = box.Parameters(), .duration = 0.52},
                        .terms = {MakeTerminalCost(0, -0.21728958251712219, 1.0, 6),
                                  MakeTerminalCost(1, 0.20385532494146355, 1.0, 6),
                                  MakeTerminalCost(2, -0.37297578204869797, 1.0, 6)}};
  problem.free.initial = {3, 4, 5};
  return problem;
}

}  // namespace saltus
